import os
from pathlib import Path

import pytest
from roslaunch.config import ROSLaunchConfig
from roslaunch.xmlloader import XmlLoader

from bullet_lab.core.parameters import ArgumentsError
from bullet_lab.ros.nodes.gzserver import find_world, parse_server_arguments
from bullet_lab.simulation.world.resources import package_share


def parse(line):
    found = parse_server_arguments(line.split(" "))
    return found.world, found.paused, found.seed, found.plugins


def test_the_arguments_of_empty_world_launch():
    paused = ("worlds/empty.world", True, 0, [])
    assert parse("-u    --verbose -e ode  worlds/empty.world") == paused
    assert parse("   -e ode  /a/b.world") == ("/a/b.world", False, 0, [])


def test_no_arguments():
    assert parse("") == ("worlds/empty.world", False, 0, [])


def test_what_has_no_meaning_here_is_passed_over():
    line = "-r --record_path /tmp/x -q --minimal_comms --lockstep -e bullet -o default my.world"
    assert parse(line) == ("my.world", False, 0, [])


def test_seed_and_plugins():
    line = "--seed 7 -s libgazebo_ros_api_plugin.so -s /lib/libgazebo_ros_paths_plugin.so -s w.so a"
    assert parse(line) == ("a", False, 7, ["w.so"])


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("-p state.log", "--play is not simulated"),
        ("--iters 100 a.world", "--iters is not simulated"),
        ("--seed -3", "--seed -3 is negative"),
        ("--seed x", "argument --seed: invalid int value: 'x'"),
        ("a.world b.world", "unrecognized arguments: b.world"),
        ("--nix", "unrecognized arguments: --nix"),
    ],
)
def test_refusals(line, reason):
    with pytest.raises(ArgumentsError, match=reason):
        parse(line)


def test_worlds_are_looked_up_as_in_gazebo(tmp_path, monkeypatch):
    here, first, second = (tmp_path / name for name in ("here", "first", "second"))
    for folder in (here, first, second):
        (folder / "worlds").mkdir(parents=True)
    monkeypatch.setenv("GAZEBO_RESOURCE_PATH", os.pathsep.join(map(str, (first, "", second))))
    own = package_share() / "worlds" / "empty.world"
    monkeypatch.chdir(here)
    assert find_world("worlds/empty.world") == str(own)
    for folder in (second, first, here):
        (folder / "worlds" / "empty.world").write_text("<sdf/>")
        assert find_world("worlds/empty.world") == str(folder / "worlds" / "empty.world")
    with pytest.raises(ArgumentsError, match="'nix.world' is in none of .*first.*second"):
        find_world("nix.world")


@pytest.mark.parametrize("name", ["/nix/a.world", "package://p/w.world", "model://m/w.world"])
def test_worlds_that_need_no_search(name):
    assert find_world(name) == name


@pytest.mark.parametrize(
    ("text", "value"), [("true", True), ("false", False), ("0.1", 0.1), ("1", 1)]
)
def test_use_sim_time_has_the_type_of_its_value(text, value):
    """As in gazebo_ros's own launch file: use_sim_time:=0.1 is no mistake there."""
    launch = Path(__file__).parents[4] / "stand_ins/gazebo_ros/launch/empty_world.launch"
    config, arguments = ROSLaunchConfig(), [f"use_sim_time:={text}", "use_clock_frequency:=1"]
    XmlLoader().load(str(launch), config, argv=arguments, verbose=False)
    assert config.params["/use_sim_time"].value == value
    assert type(config.params["/use_sim_time"].value) is type(value)
    assert config.params["/gazebo/pub_clock_frequency"].value == 100
