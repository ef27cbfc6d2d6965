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
    models = {"a": "model a"}
    world = RunningWorld(SimpleNamespace(simulation=SimpleNamespace(models=models)), None)
    begun, ended = [], []
    world.follow(begun.append, ended.append)
    assert begun == ["model a"]
    models["b"] = "model b"
    world.notify("b")
    world.notify("b")
    assert (begun, ended) == (["model a", "model b"], [])
    del models["a"]
    world.notify("a")
    world.notify("")
    assert (begun, ended) == (["model a", "model b"], ["a"])
