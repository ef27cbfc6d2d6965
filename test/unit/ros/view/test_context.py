"""Frames, by the newest pose of each."""

from math import pi

import pytest

from bullet_lab.core.pose import Pose
from bullet_lab.ros.view.context import FrameTree


def test_poses_are_chained_up_and_down():
    tree = FrameTree()
    tree.put("odom", "world", Pose((1.0, 2.0, 0.0)))
    tree.put("base", "odom", Pose())
    assert tree.pose("base", "world").position == (1.0, 2.0, 0.0)
    # It has moved.
    tree.put("base", "odom", Pose.from_rpy((3.0, 0.0, 0.0), (0.0, 0.0, pi / 2)))
    tree.put("beacon", "world", Pose((4.0, 5.0, 0.0)))
    assert tree.pose("base", "world").position == pytest.approx((4.0, 2.0, 0.0))
    assert tree.pose("beacon", "base").position == pytest.approx((3.0, 0.0, 0.0))
    assert tree.root("base") == "world"


def test_frames_that_are_not_connected_have_no_pose():
    tree = FrameTree()
    assert tree.pose("world", "world") == Pose()
    # A cycle ends, too.
    for child, parent in ("ab", "ba"):
        tree.put(child, parent, Pose())
        assert tree.pose("a", "world") is None


def test_the_largest_tree_comes_first():
    tree = FrameTree()
    for name, parent in {"z": "small", **dict.fromkeys("abc", "tall")}.items():
        tree.put(name, parent, Pose())
    assert tree.roots() == ["tall", "small"]
