import math
from types import SimpleNamespace

import pytest
from shared import refuses

from bullet_lab.core.pose import Pose
from bullet_lab.ros.bridge.running_world import RunningWorld, TouchCounter, tf_prefixes
from bullet_lab.ros.node.node import NodeError
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Link, Model


def test_that_no_master_answers_is_said(monkeypatch):
    # Nobody listens there.
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:1")
    with refuses("no ROS master answers", NodeError):
        tf_prefixes(Model("robot", (Link("base"),)), "")


def test_models_are_followed_as_they_are_added_and_removed():
    models, calls = {"a": "model a"}, []
    world = RunningWorld(SimpleNamespace(simulation=SimpleNamespace(models=models)), None)

    def begin(model):
        calls.append(model)
        return lambda: calls.append(f"end of {model}")

    world.follow(begin)
    models["b"] = "model b"
    for name in ("b", "b"):
        world.notify(name)
    del models["a"]
    for name in ("a", ""):
        world.notify(name)
    assert calls == ["model a", "model b", "end of model a"]


def test_touches_are_counted_anew_each_time_and_the_floor_is_none():
    messages = []
    publisher = SimpleNamespace(has_connections=lambda: True, publish=messages.append)
    with Simulation.of("package://bullet_lab/worlds/docking.world") as simulation:
        robot = simulation.spawn("package://bullet_lab/urdf/camera_robot.urdf")
        topics = SimpleNamespace(publisher=lambda *_: publisher, release=list)
        TouchCounter(RunningWorld(SimpleNamespace(simulation=simulation), topics))
        simulation.run_for(0.5)
        assert messages[-1].models == []
        assert len(messages) == 5
        for times in (1, 2):
            # Into the left wall, pushing against it for a second, and away from it.
            robot.place(Pose.from_rpy((3.0, 0.25, 0.0), (0.0, 0.0, math.pi / 2)))
            robot.command("cmd_vel", PlanarCommand(0.2))
            simulation.run_for(1.3)
            assert messages[-1].models == ["docking_station"]
            assert times <= messages[-1].touches[0] <= 4 * times
            robot.place(Pose((3.0, 0.0, 0.0)))
            simulation.run_for(0.2)
        assert messages[-1].header.stamp.to_sec() == pytest.approx(3.5)
        publisher.has_connections = lambda: False
        messages.clear()
        simulation.run_for(0.2)
        assert not messages
