"""Rooms import only from those below them, nothing in a circle, and only ros knows rospy."""

import ast

import pytest
from shared import PACKAGE

SOURCE = PACKAGE / "src" / "bullet_lab"
# From below; a module belongs to the longest name that it begins with.
ROOMS = (
    "",
    "core",
    "noise",
    "drive",
    "navigation",
    "vision",
    "markers",
    "docking",
    "simulation.world",
    "simulation.physics",
    "simulation.rendering",
    "simulation.plugins",
    "simulation",
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
    "ros.grade",
)
ROS = {"rospy", "roslaunch", "rosgraph", "tf2_ros", "actionlib"}


def imported(path):
    """Yield what a file imports by its full name, with the names that it takes from a module."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.fixture(scope="module")
def imports():
    """What each module of the package imports."""
    found = {}
    for path in SOURCE.rglob("*.py"):
        folder = path.parent if path.stem == "__init__" else path.with_suffix("")
        module = ".".join(folder.relative_to(SOURCE).parts)
        found[module] = set(imported(path))
    return found


@pytest.fixture(scope="module")
def own(imports):
    """Which other modules of the package each module imports."""
    names = {
        module: {name.partition("bullet_lab.")[2] for name in every}
        for module, every in imports.items()
    }
    return {module: some & set(imports) - {module} for module, some in names.items()}


def room_of(module):
    inside = [room for room in ROOMS if module == room or module.startswith(f"{room}.")]
    return max(inside, key=len, default="")


def level(module):
    return ROOMS.index(room_of(module))


def test_a_room_imports_from_below(own):
    above = [(m, name) for m, names in own.items() for name in names if level(name) > level(m)]
    assert not above


def test_no_module_imports_itself_by_way_of_others(own):
    graph = own
    while graph:
        leaves = {module for module, needed in graph.items() if not needed & set(graph)}
        assert leaves, f"in a circle: {sorted(graph)}"
        graph = {module: graph[module] for module in graph.keys() - leaves}


def test_only_ros_knows_rospy(imports):
    roots = {m: {name.partition(".")[0] for name in names} for m, names in imports.items()}
    assert not [m for m in roots if room_of(m)[:3] != "ros" and roots[m] & ROS]
