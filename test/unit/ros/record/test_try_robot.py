"""Odometry that pauses, and clouds that come before all topics are connected."""

from types import SimpleNamespace

from sensor_msgs.msg import PointCloud2

from bullet_lab.reports.robot import Count, Robot, RobotReport
from bullet_lab.ros.node.node import NodeError
from bullet_lab.ros.record.try_robot import ENOUGH, Trial

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


def test_topics_of_large_messages_stay_connected_until_all_are(tmp_path):
    trial, ends = Trial.__new__(Trial), []
    trial._robot, trial._rate = Robot("cart"), None
    trial._report = RobotReport(tmp_path, trial._robot, {})
    trial._report.counts["points"] = Count("sensor_msgs/PointCloud2", 0.0)
    trial._subscribers = {"points": SimpleNamespace(unregister=lambda: ends.append("points"))}
    for _ in range(2 * ENOUGH):
        trial._receive("points", PointCloud2())
    assert not ends
    trial._rate = SimpleNamespace(now=None)
    trial._receive("points", PointCloud2())
    assert ends == ["points"]
