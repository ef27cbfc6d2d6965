"""Frames, by the newest pose of each."""

from math import pi

import pytest

from bullet_lab.core.pose import Pose
from bullet_lab.ros.view.frames import FrameTree


def test_poses_are_chained_up_and_down():
    tree = FrameTree()
    tree.put("odom", "world", Pose((1.0, 2.0, 0.0)))
    tree.put("base", "odom", Pose.from_rpy((3.0, 0.0, 0.0), (0.0, 0.0, pi / 2)))
    tree.put("beacon", "world", Pose((4.0, 5.0, 0.0)))
    assert tree.pose("base", "world").position == pytest.approx((4.0, 2.0, 0.0))
    assert tree.pose("beacon", "base").position == pytest.approx((3.0, 0.0, 0.0))
    assert tree.root("base") == "world"
    tree.put("base", "odom", Pose())
    assert tree.pose("base", "world").position == (1.0, 2.0, 0.0)


def test_frames_that_are_not_connected_have_no_pose():
    tree = FrameTree()
    tree.put("a", "b", Pose())
    assert tree.pose("a", "world") is None
    assert tree.pose("world", "world") == Pose()


def test_a_cycle_ends():
    tree = FrameTree()
    tree.put("a", "b", Pose())
    tree.put("b", "a", Pose())
    assert tree.pose("a", "c") is None


def test_the_largest_tree_comes_first():
    tree = FrameTree()
    tree.put("z", "small", Pose())
    for name in "abc":
        tree.put(name, "tall", Pose())
    assert tree.roots() == ["tall", "small"]
