"""Odometry that pauses, and where a camera sees the whole of a robot."""

import math
from itertools import product
from types import SimpleNamespace

import pytest

from bullet_lab.reports.robot import Robot, RobotReport
from bullet_lab.ros.node.node import NodeError
from bullet_lab.ros.record import try_robot
from bullet_lab.ros.record.try_robot import (
    CLEARANCE,
    FIELD_OF_VIEW,
    Trial,
    camera_pose,
    distance_to,
)


class Odometry:
    """Poses one after the other; None pauses."""

    def __init__(self, *poses):
        self.poses, self.patience = list(poses), []

    def newest(self, now, patience):
        self.patience.append(patience)
        pose = self.poses.pop(0)
        if pose is None:
            raise NodeError("no odometry on /odom")
        return pose


@pytest.fixture
def trial(tmp_path):
    made = Trial.__new__(Trial)
    made._report = RobotReport(tmp_path, Robot("cart", odometry="/odom"), {})
    made._rate, made._pauses = SimpleNamespace(now=None), False
    return made


def test_odometry_comes_again_after_a_pause(trial, monkeypatch):
    warnings = []
    monkeypatch.setattr(try_robot.rospy, "logwarn", lambda *words: warnings.append(words))
    first, last = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)
    trial._odometry = Odometry(first, None, None, last, None)
    assert [trial._newest_odometry() for _ in range(5)] == [first, None, None, last, None]
    # What pauses is waited for once.
    assert [patience > 0.0 for patience in trial._odometry.patience] == [
        True, True, False, False, True
    ]  # fmt: skip
    assert (len(warnings), trial._report.pauses) == (2, 2)


BOXES = [
    ((-0.1, -0.1, 0.0), (0.1, 0.1, 0.2)),
    ((2.0, -5.0, 0.1), (4.0, -4.5, 0.4)),
    ((-0.1, -0.1, 0.0), (0.1, 0.1, 3.0)),
]


@pytest.mark.parametrize("box", BOXES)
def test_every_corner_is_in_the_picture(box):
    eye = camera_pose(*box).inverse()
    for corner in product(*zip(*box)):
        x, y, z = (eye * type(eye)(corner)).position
        assert x > CLEARANCE * distance_to(*box)
        assert math.atan2(abs(y), x) < 0.5 * FIELD_OF_VIEW
        # The picture is three quarters as high as wide.
        assert abs(z) / x < 0.75 * math.tan(0.5 * FIELD_OF_VIEW)


def test_a_point_is_looked_at_from_somewhere():
    assert distance_to((1.0, 1.0, 1.0), (1.0, 1.0, 1.0)) > 0.1
