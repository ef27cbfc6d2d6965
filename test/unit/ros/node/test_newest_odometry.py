"""The newest odometry in lock step."""

import pytest
import rospy
from message_fields import message
from nav_msgs.msg import Odometry

from bullet_lab.ros.node import odometry
from bullet_lab.ros.node.node import NodeError
from bullet_lab.ros.node.odometry import NewestOdometry


def test_time_that_has_been_set_back_to_less_than_a_period_is_no_error(monkeypatch):
    monkeypatch.setattr(odometry, "subscriber", lambda *_: None)
    monkeypatch.setattr(odometry, "in_lock_step", lambda: True)
    monkeypatch.setattr(rospy.Time, "now", lambda: rospy.Time(0))
    newest = NewestOdometry("odom")
    for nsecs in (0, 50_000_000):
        text = f"""
            header: {{stamp: {{secs: 1, nsecs: {nsecs}}}}}
            pose: {{pose: {{orientation: {{w: 1.0}}}}}}
        """
        newest.take(message(Odometry, text))
    assert newest.newest(rospy.Time(0.01)) == (0.0, 0.0, 0.0)


def test_without_patience_nobody_waits(monkeypatch):
    monkeypatch.setattr(odometry, "subscriber", lambda *_: None)
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    newest = NewestOdometry("odom")
    monkeypatch.setattr(newest._new, "wait", lambda _: pytest.fail("it waits"))
    with pytest.raises(NodeError, match="no odometry on odom"):
        newest.newest(None, 0.0)
