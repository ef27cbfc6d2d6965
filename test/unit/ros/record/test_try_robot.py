"""Odometry that pauses."""

from types import SimpleNamespace

import pytest

from bullet_lab.reports.robot import Robot, RobotReport
from bullet_lab.ros.node.node import NodeError
from bullet_lab.ros.record import try_robot
from bullet_lab.ros.record.try_robot import Trial


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
