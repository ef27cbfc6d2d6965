"""Odometry that pauses."""

from types import SimpleNamespace

from bullet_lab.reports.robot import Robot, RobotReport
from bullet_lab.ros.node.node import NodeError
from bullet_lab.ros.record.try_robot import Trial

FIRST, LAST = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)


class Odometry:
    """Poses one after the other; None pauses."""

    def __init__(self):
        self.poses, self.has_waited = [FIRST, None, None, LAST, None], []

    def newest(self, now, patience):
        self.has_waited.append(patience > 0.0)
        pose = self.poses.pop(0)
        if pose is None:
            raise NodeError("no odometry on /odom")
        return pose


def test_odometry_comes_again_after_a_pause(tmp_path, logged):
    trial = Trial.__new__(Trial)
    trial._report = RobotReport(tmp_path, Robot("cart", odometry="/odom"), {})
    trial._rate, trial._pauses, trial._odometry = SimpleNamespace(now=None), False, Odometry()
    assert [trial._newest_odometry() for _ in range(5)] == [FIRST, None, None, LAST, None]
    # What pauses is waited for once.
    assert trial._odometry.has_waited == [True, True, False, False, True]
    assert (len(logged), trial._report.pauses) == (2, 2)
