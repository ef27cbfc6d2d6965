"""Rooms import only from those below them, nothing in a circle, and only ros knows rospy."""

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[2] / "src" / "bullet_lab"
# From below; a module belongs to the longest name that it begins with.
ROOMS = (
    "",
    "core",
    "noise",
    "drive",
    "vision",
    "markers",
    "docking",
    "simulation.world",
    "simulation.physics",
    "simulation.rendering",
    "simulation.plugins",
    "simulation",
    "view",
    "reports",
    "studies",
    "jobs",
    "ros.messages",
    "ros.node",
    "ros.bridge",
    "ros.gazebo",
    "ros.nodes",
    "ros.view",
    "ros.record",
    "ros.launcher",
    "ros.verify",
)
# What is made by catkin.
PASSED_OVER = ("msg", "srv")
MOST_FILES = 30


def modules():
    for path in sorted(SOURCE.rglob("*.py")):
        parts = path.relative_to(SOURCE).with_suffix("").parts
        yield ".".join(part for part in parts if part != "__init__"), path


MODULES = dict(modules())


def imports(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def own(path):
    names = {name.partition("bullet_lab.")[2] for name in imports(path)}
    return {name for name in names if name in MODULES and name not in PASSED_OVER}


def room_of(module):
    inside = [room for room in ROOMS if module == room or module.startswith(f"{room}.")]
    return max(inside, key=len, default="")


@pytest.mark.parametrize("module", MODULES)
def test_a_room_imports_from_below(module):
    level = ROOMS.index(room_of(module))
    above = [name for name in own(MODULES[module]) if ROOMS.index(room_of(name)) > level]
    assert not above


def test_no_module_imports_itself_by_way_of_others():
    graph = {module: own(path) - {module} for module, path in MODULES.items()}
    while graph:
        leaves = {module for module, needed in graph.items() if not needed & set(graph)}
        assert leaves, f"in a circle: {sorted(graph)}"
        graph = {module: needed for module, needed in graph.items() if module not in leaves}


@pytest.mark.parametrize("module", [name for name in MODULES if room_of(name)[:3] != "ros"])
def test_only_ros_knows_rospy(module):
    roots = {name.partition(".")[0] for name in imports(MODULES[module])}
    assert not roots & {"rospy", "roslaunch", "rosgraph", "tf2_ros", "actionlib"}


def test_no_folder_is_crowded():
    for folder in {path.parent for path in MODULES.values()}:
        assert len(list(folder.glob("*.py"))) <= MOST_FILES
