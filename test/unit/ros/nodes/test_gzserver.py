import pytest
import yaml
from roslaunch.config import ROSLaunchConfig
from roslaunch.xmlloader import XmlLoader
from shared import PACKAGE, cases, refuses

from bullet_lab.core.parameters import ArgumentsError
from bullet_lab.ros.nodes.gzserver import bridge_parameters, find_world, parse_server_arguments
from bullet_lab.simulation.world.resources import package_share


def parse(line):
    found = parse_server_arguments(line.split(" "))
    return [found.world, found.paused, found.seed, found.plugins]


@cases("""
line, found:
  # Lines, and their world, whether it is paused, the seed and the plugins that are not known.
  # Those of empty_world.launch.
  "-u    --verbose -e ode  worlds/empty.world": [worlds/empty.world, true, 0, []]
  "   -e ode  /a/b.world": [/a/b.world, false, 0, []]
  "": [worlds/empty.world, false, 0, []]
  # What has no meaning here is ignored.
  -r --record_path /tmp/x -q --minimal_comms --lockstep -e bullet -o default my.world:
    [my.world, false, 0, []]
  --seed 7 -s libgazebo_ros_api_plugin.so -s /lib/libgazebo_ros_paths_plugin.so -s w.so a:
    [a, false, 7, [w.so]]
""")
def test_arguments(line, found):
    assert parse(line) == found


@cases("""
line, reason:
  -p state.log: --play is not simulated
  --iters 100 a.world: --iters is not simulated
  --seed x: "argument --seed: invalid int value: 'x'"
  a.world b.world: "unrecognized arguments: b.world"
  --nix: "unrecognized arguments: --nix"
""")
def test_refusals(line, reason):
    with refuses(reason, ArgumentsError):
        parse(line)


def test_worlds_are_looked_up_as_in_gazebo(tmp_path, monkeypatch, logged):
    name, path = "worlds/empty.world", f"{tmp_path}/first::{tmp_path}/second"
    monkeypatch.setenv("GAZEBO_RESOURCE_PATH", path)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert find_world(name) == str(package_share() / name)
    for folder in ("second", "first", "here"):
        world = tmp_path / folder / name
        world.parent.mkdir(parents=True)
        world.write_text("<sdf/>")
        assert find_world(name) == str(world)
        assert find_world(str(world)) == str(world)
    for lost in ("nix.world", "/opt/gazebo_ros/worlds/empty_world.world"):
        assert find_world(lost) == str(package_share() / name)
        line = logged.pop()
        assert line.startswith(f"no world file '{lost}' (looked up in {tmp_path}/here, ")
        assert line.endswith("; the world is empty, as in Gazebo")


@cases("name: [package://p/w.world, model://m/w.world]")
def test_worlds_that_need_no_search(name):
    assert find_world(name) == name


@cases("""
text:
  - "true"
  - "false"
  - "0.1"
  - "1"
""")
def test_use_sim_time_has_the_type_of_its_value(text):
    """As in gazebo_ros's own launch file: use_sim_time:=0.1 is no mistake there."""
    launch = PACKAGE / "stand_ins/gazebo_ros/launch/empty_world.launch"
    config, arguments = ROSLaunchConfig(), [f"use_sim_time:={text}", "use_clock_frequency:=1"]
    XmlLoader().load(str(launch), config, argv=arguments, verbose=False)
    assert repr(config.params["/use_sim_time"].value) == repr(yaml.safe_load(text))
    assert config.params["/gazebo/pub_clock_frequency"].value == 100


def parameters(*words):
    return bridge_parameters(parse_server_arguments(words))


@pytest.fixture
def ros(monkeypatch):
    """Parameters on the master."""
    given = {}
    monkeypatch.setattr("rospy.get_param", given.get)
    return given


def test_the_bridge_gets_the_arguments_of_gzserver(ros, logged):
    # It is spawn_model that spawns the robot of robot_description.
    assert (parameters().robot_description, parameters().clock_rate) == ("", 100.0)
    ros["/gazebo/pub_clock_frequency"] = 250
    wanted = parameters("-u", "--seed", "7", "-s", "libfog.so", "worlds/beacons.world")
    assert wanted.world == str(package_share() / "worlds" / "beacons.world")
    assert (wanted.paused, wanted.seed, wanted.clock_rate, wanted.rtf) == (True, 7, 250.0, 1.0)
    assert logged == ["server plugin libfog.so is not simulated and skipped"]


def test_parameters_that_are_refused(ros):
    with refuses("--seed is -3: it must be a whole number from 0"):
        parameters("--seed", "-3")
    ros["/gazebo/pub_clock_frequency"] = "often"
    with refuses("/gazebo/pub_clock_frequency is 'often': it must be"):
        parameters()
