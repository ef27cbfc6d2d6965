"""Makes a catkin workspace without a compiler: Python messages, links, and its setup files.

Usage: workspace.py WORKSPACE ROS PYTHON, as scripts/setup.sh does: ROS is /usr or
/opt/ros/noetic, and PYTHON runs the executables.

The packages are those in WORKSPACE/src. WORKSPACE/devel gets what `catkin_make` would leave there
for Python: rosrun, roslaunch, rostest and other workspaces find it. The messages are those that
genpy makes for catkin, too.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import genpy.generate_initpy
import genpy.generator

PYTHON_FOLDER = Path("lib/python3/dist-packages")
# Definitions whose Python package may not be there yet. Without an __init__.py, these messages give
# way to those of the package.
GENERATED = ("nav_msgs", "move_base_msgs")
HEADER = "std_msgs/Header header\n"
# An action is the messages that actionlib exchanges (http://wiki.ros.org/actionlib/DetailedDescription).
ACTION_MESSAGES = {
    "ActionGoal": HEADER + "actionlib_msgs/GoalID goal_id\n{0}Goal goal\n",
    "ActionResult": HEADER + "actionlib_msgs/GoalStatus status\n{0}Result result\n",
    "ActionFeedback": HEADER + "actionlib_msgs/GoalStatus status\n{0}Feedback feedback\n",
    "Action": "{0}ActionGoal action_goal\n{0}ActionResult action_result\n"
    "{0}ActionFeedback action_feedback\n",
}
# Of a package whose Python code is in another folder; that of its messages is in this one.
INIT = """import os
__path__.append({source!r})
with open(os.path.join({source!r}, "__init__.py")) as file:
    exec(file.read())
del os, file
"""
# Where packages have their executables.
PROGRAMS = ("scripts/*", "xacro*", "test/contract/*.py")
RELAY = """#!{python}
with open({file!r}) as program:
    text = program.read()
# Under another name, as in a worker process of multiprocessing, it only defines things.
exec(compile(text, {file!r}, "exec"), {{"__name__": __name__, "__file__": {file!r}}})
"""
SETUP = """# Enters this workspace, as the file of a catkin build does.
{begin}
export CMAKE_PREFIX_PATH={devel}${{CMAKE_PREFIX_PATH:+:$CMAKE_PREFIX_PATH}}
export ROS_PACKAGE_PATH={source}${{ROS_PACKAGE_PATH:+:$ROS_PACKAGE_PATH}}
export PYTHONPATH={devel}/{python}${{PYTHONPATH:+:$PYTHONPATH}}
export PATH={devel}/bin:$PATH
export ROS_MASTER_URI=${{ROS_MASTER_URI:-http://localhost:11311}}
"""
# What Debian's ros-environment sets, and nothing of other workspaces.
DEBIAN = """unset CMAKE_PREFIX_PATH ROS_PACKAGE_PATH
export ROS_DISTRO=Debian ROS_VERSION=1 ROS_PYTHON_VERSION=3 ROS_ETC_DIR=/etc/ros"""


def action_messages(file: Path, folder: Path) -> list[str]:
    """Write the messages of an action to a folder; return their files."""
    name = file.stem
    # A part may be empty.
    parts = re.split(r"^---$", file.read_text(), flags=re.MULTILINE)
    texts = dict(zip(("Goal", "Result", "Feedback"), parts))
    texts.update({part: text.format(name) for part, text in ACTION_MESSAGES.items()})
    folder.mkdir(parents=True, exist_ok=True)
    for part, text in texts.items():
        (folder / f"{name}{part}.msg").write_text(text)
    return [str(folder / f"{name}{part}.msg") for part in texts]


def generate(package: Path, name: str, python: Path, search: dict[str, list[str]]) -> None:
    """Generate the Python modules of a package's messages, services and actions.

    `search` has the folders of definitions by the names of the packages.
    """
    actions = Path(search[name][-1])
    messages = sorted(map(str, package.glob("msg/*.msg")))
    for file in sorted(package.glob("action/*.action")):
        # Debian's packages have the messages of their actions.
        if not (package / "msg" / f"{file.stem}Goal.msg").exists():
            messages += action_messages(file, actions)
    generators = (
        ("msg", messages, genpy.generator.MsgGenerator()),
        ("srv", sorted(map(str, package.glob("srv/*.srv"))), genpy.generator.SrvGenerator()),
    )
    for kind, files, generator in generators:
        folder = python / name / kind
        if files:
            folder.mkdir(parents=True)
            if generator.generate_messages(name, files, str(folder), search):
                raise SystemExit(f"genpy cannot read the definitions in {package / kind}")
            genpy.generate_initpy.write_modules(str(folder))


def link_python(package: Path, name: str, python: Path) -> None:
    """Make the package's own Python code importable beside its messages."""
    source = package / "src" / name
    folder = python / name
    if source.is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "__init__.py").write_text(INIT.format(source=str(source)))
    elif folder.is_dir():
        (folder / "__init__.py").touch()


def relay_programs(package: Path, name: str, devel: Path, python: Path) -> None:
    """Make executables where rosrun and roslaunch look first, and those in PATH."""
    folder = devel / "lib" / name
    folder.mkdir(parents=True)
    for file in (one for pattern in PROGRAMS for one in package.glob(pattern)):
        if file.is_file() and os.access(file, os.X_OK) and file.suffix != ".sh":
            write_relay(folder / file.name, file, python)
    if name == "xacro":
        write_relay(devel / "bin" / name, package / name, python)


def write_relay(relay: Path, file: Path, python: Path) -> None:
    """Write a program that runs a Python program by a Python."""
    relay.write_text(RELAY.format(python=python, file=str(file)))
    relay.chmod(0o755)


def write_setup(devel: Path, final: Path, source: Path, ros: Path) -> None:
    """Write the setup files for bash, sh and zsh, and the mark of a workspace."""
    begin = DEBIAN if ros == Path("/usr") else f". {shlex.quote(str(ros))}/setup.sh"
    quoted = {"devel": shlex.quote(str(final)), "source": shlex.quote(str(source))}
    text = SETUP.format(begin=begin, python=PYTHON_FOLDER, **quoted)
    for shell in ("bash", "sh", "zsh"):
        (devel / f"setup.{shell}").write_text(text)
    (devel / ".catkin").write_text(str(source))


def make(workspace: Path, ros: Path, python: Path) -> None:
    """Make the workspace anew; the old one stays until it is complete."""
    source, final = workspace / "src", workspace / "devel"
    devel = workspace / "devel.part"
    shutil.rmtree(devel, ignore_errors=True)
    (devel / "bin").mkdir(parents=True)
    packages = {
        file.parent: ElementTree.parse(file).findtext("name").strip()
        for file in sorted(source.glob("*/package.xml"))
    }
    search = {file.parent.name: [str(file)] for file in (ros / "share").glob("*/msg")}
    for package, name in packages.items():
        search[name] = [str(package / "msg"), str(workspace / "actions" / name)]
    for name in GENERATED:
        search[name].append(str(workspace / "actions" / name))
        generate(ros / "share" / name, name, devel / PYTHON_FOLDER, search)
    for package, name in packages.items():
        generate(package, name, devel / PYTHON_FOLDER, search)
        link_python(package, name, devel / PYTHON_FOLDER)
        relay_programs(package, name, devel, python)
    write_setup(devel, final, source, ros)
    # A job that runs meanwhile misses it for a moment only.
    old = workspace / "devel.old"
    shutil.rmtree(old, ignore_errors=True)
    if final.exists():
        final.rename(old)
    devel.rename(final)
    shutil.rmtree(old, ignore_errors=True)


if __name__ == "__main__":
    make(*map(Path, sys.argv[1:]))
