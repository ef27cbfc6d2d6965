import pytest

pytest.importorskip("rospy")

from bullet_lab.ros.bridge.running_world import tf_prefixes
from bullet_lab.ros.node.node import NodeError
from bullet_lab.simulation.world.description import Link, Model


def test_that_no_master_answers_is_said(monkeypatch):
    # Nobody listens there.
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:1")
    with pytest.raises(NodeError, match="no ROS master answers"):
        tf_prefixes(Model("robot", (Link("base"),)), "")
