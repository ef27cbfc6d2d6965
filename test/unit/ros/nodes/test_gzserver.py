from types import SimpleNamespace

import pytest

from bullet_lab.errors import LabError
from bullet_lab.ros.nodes import gzserver as gazebo_server
from bullet_lab.ros.nodes.gzserver import bridge_parameters, parse_server_arguments
from bullet_lab.simulation.world.resources import package_share


def parameters(*words):
    return bridge_parameters(parse_server_arguments(words))


@pytest.fixture
def ros(monkeypatch):
    """Parameters on the master, and warnings."""

    ros = SimpleNamespace(parameters={}, warnings=[])
    monkeypatch.setattr(gazebo_server.rospy, "get_param", ros.parameters.get)
    monkeypatch.setattr(
        gazebo_server.rospy, "logwarn", lambda line, *values: ros.warnings.append(line % values)
    )
    return ros


def test_the_bridge_gets_the_arguments_of_gzserver(ros):
    ros.parameters["/gazebo/pub_clock_frequency"] = 250
    wanted = parameters("-u", "--seed", "7", "worlds/beacons.world")
    assert wanted.world == str(package_share() / "worlds" / "beacons.world")
    assert (wanted.paused, wanted.seed, wanted.clock_rate, wanted.rtf) == (True, 7, 250.0, 1.0)


def test_no_robot_comes_from_robot_description(ros):
    # It is spawn_model that spawns it.
    wanted = parameters()
    assert (wanted.robot, wanted.robot_description, wanted.clock_rate) == ("", "", 100.0)


def test_plugins_that_are_not_simulated_are_named(ros):
    parameters("-s", "libfog.so")
    assert ros.warnings == ["server plugin libfog.so is not simulated and skipped"]


def test_refusals(ros):
    with pytest.raises(LabError, match="world 'nix.world' is in none of"):
        parameters("nix.world")
    ros.parameters["/gazebo/pub_clock_frequency"] = "often"
    with pytest.raises(LabError, match="/gazebo/pub_clock_frequency is 'often': it must be"):
        parameters()
