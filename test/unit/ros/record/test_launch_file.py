"""What roslaunch prints is read."""

from types import SimpleNamespace

import pytest

from bullet_lab.ros.record import launch_file
from bullet_lab.ros.record.launch_file import (
    Launched,
    assignments,
    debian_package,
    failures_in,
    reason_in,
)


def test_arguments_of_a_launch_file():
    assert assignments("") == []
    assert assignments("a:=1 b=2") == ["a:=1", "b:=2"]
    assert assignments("world:='a b=c'") == ["world:=a b=c"]


def test_why_a_launch_file_has_ended():
    log = "logging to x\n\x1b[31mResource not found: lidar\nROS path [0]=/x\x1b[0m\nThe traceback\n"
    assert reason_in(log) == "Resource not found: lidar"
    assert reason_in("start\nRLException: while processing a.launch:\nno b\nd") == (
        "RLException: while processing a.launch: no b"
    )
    assert reason_in("Error:\n") == "Error:"
    assert reason_in("done\n") == "done"
    assert reason_in("") == "no output"


LOG = """started roslaunch server http://here:1/
\x1b[31mERROR: cannot launch node of type [map_server/map_server]: map_server
ROS path [0]=/usr/share\x1b[0m
ERROR: cannot launch node of type [nodelet/nodelet]: nodelet
ERROR: cannot launch node of type [nodelet/nodelet]: nodelet
ERROR: cannot launch node of type [mine/run.py]: Cannot locate node of type [run.py] in package
process[spawn-2]: started with pid [7]
[spawn-2] process has finished cleanly
\x1b[31m[gripper-4] process has died [pid 10, exit code -11, cmd /x/gripper __name:=gripper].
log file: /tmp/gripper-4*.log\x1b[0m
"""


def test_nodes_that_could_not_start_or_died():
    packages = {"nodelet": "libnodeletlib-tools"}
    assert failures_in(LOG, lambda package: packages.get(package, "")) == [
        "map_server/map_server: there is no ROS package 'map_server'; "
        "Debian has none that is known",
        "nodelet/nodelet: there is no ROS package 'nodelet'; Debian has it: libnodeletlib-tools "
        "(2 times)",
        "mine/run.py: Cannot locate node of type [run.py] in package",
        "gripper-4 has died (exit code -11)",
    ]
    assert failures_in("", str) == []


APT = """Package: tf
Description: text-based MUD client

Package: tf-tools
Description: Set of utilities to operate with the Robot OS tf lib

Package: tf2-tools
Homepage: https://wiki.ros.org/geometry2
"""


@pytest.mark.parametrize(
    ("package", "found"), [("tf", "tf-tools"), ("tf2_ros", "tf2-tools"), ("amcl", "")]
)
def test_the_debian_package_of_a_ros_package(monkeypatch, tmp_path, package, found):
    def run(command, **_):
        shown = [part for part in APT.split("\n\n") if part.split()[1] in command]
        return SimpleNamespace(stdout="\n\n".join(shown).encode())

    monkeypatch.setattr(launch_file.subprocess, "run", run)
    monkeypatch.setattr(launch_file, "INSTALLED", tmp_path)
    debian_package.cache_clear()
    assert debian_package(package) == found
    debian_package.cache_clear()
    # What is installed already does not help.
    (tmp_path / f"{found}:amd64.list").touch()
    assert debian_package(package) == ""
    debian_package.cache_clear()


def test_a_machine_without_apt(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    debian_package.cache_clear()
    assert debian_package("amcl") == ""
    debian_package.cache_clear()


def test_no_launch_file():
    launched = Launched("", "")
    launched.check()
    assert launched.failures() == []
    launched.close()
