"""Bags with paths, as tests of studies read them."""

import math

import pytest


def write_bag(file, *topics):
    """Write a bag.

    Args:
        file: to write.
        topics: of each its name, the class of its messages, stamps (s) and poses, shape (n, 3).
    """
    rosbag = pytest.importorskip("rosbag")
    rospy = pytest.importorskip("rospy")
    with rosbag.Bag(str(file), "w") as bag:
        for topic, kind, stamps, poses in topics:
            for stamp, (x, y, yaw) in zip(stamps, poses):
                message = kind()
                message.header.stamp = rospy.Time.from_sec(float(stamp))
                place, turn = _place_and_turn(message)
                place.x, place.y = x, y
                turn.z, turn.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
                bag.write(topic, message, message.header.stamp)


def _place_and_turn(message):
    if hasattr(message, "transform"):
        return message.transform.translation, message.transform.rotation
    pose = getattr(message.pose, "pose", message.pose)
    return pose.position, pose.orientation
