from types import SimpleNamespace

import pytest

from bullet_lab.ros.bridge.running_world import RunningWorld, tf_prefixes
from bullet_lab.ros.node.node import NodeError
from bullet_lab.simulation.world.description import Link, Model


def test_that_no_master_answers_is_said(monkeypatch):
    # Nobody listens there.
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:1")
    with pytest.raises(NodeError, match="no ROS master answers"):
        tf_prefixes(Model("robot", (Link("base"),)), "")


def test_models_are_followed_as_they_are_added_and_removed():
    models, calls = {"a": "model a"}, []
    world = RunningWorld(SimpleNamespace(simulation=SimpleNamespace(models=models)), None)
    world.follow(calls.append, lambda name: calls.append(f"end of {name}"))
    models["b"] = "model b"
    for name in ("b", "b"):
        world.notify(name)
    del models["a"]
    for name in ("a", ""):
        world.notify(name)
    assert calls == ["model a", "model b", "end of a"]
