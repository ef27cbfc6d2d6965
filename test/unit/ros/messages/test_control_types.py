"""A service client checks the md5 sum of a definition: these are ros_control's, for Noetic."""

import re

import pytest

pytest.importorskip("genmsg")

from test_gazebo_types import md5

SUMS = {
    "control_msgs": {"JointControllerState": "987ad85e4756f3aef7f1e5e7fe0595d1"},
    "controller_manager_msgs": {
        "ControllerState": "aeb6b261d97793ab74099a3740245272",
        "HardwareInterfaceResources": "f25b55cbf1d1f76e82e5ec9e83f76258",
        "ListControllerTypes": "c1d4cd11aefa9f97ba4aeb5b33987f4e",
        "ListControllers": "1341feb2e63fa791f855565d0da950d8",
        "LoadController": "647e5c54b8d6468952d8d31f1efe96c0",
        "ReloadControllerLibraries": "40e8c411fd1797d2e2c486018f846040",
        "SwitchController": "b29a7abc673b2c54c14b54e50f8d06a5",
        "UnloadController": "647e5c54b8d6468952d8d31f1efe96c0",
    },
}


@pytest.mark.parametrize(
    ("stand_in", "name"), [(stand_in, name) for stand_in in SUMS for name in SUMS[stand_in]]
)
def test_md5_sums_are_those_of_ros_control(package, stand_in, name):
    for folder in (package, package / "stand_ins" / stand_in):
        (path,) = folder.glob(f"[ms][sr][gv]/{name}.[ms][sr][gv]")
        assert md5(path, stand_in) == SUMS[stand_in][name]


@pytest.mark.parametrize("stand_in", SUMS)
def test_the_stand_in_builds_all_that_it_holds(package, stand_in):
    folder = package / "stand_ins" / stand_in
    listed = set(re.findall(r"(\w+\.(?:msg|srv))", (folder / "CMakeLists.txt").read_text()))
    assert listed == {path.name for path in folder.glob("[ms][sr][gv]/*")}
    assert {name.split(".")[0] for name in listed} == set(SUMS[stand_in])
    built = (package / "CMakeLists.txt").read_text()
    assert [name for name in listed if name not in built] == []
