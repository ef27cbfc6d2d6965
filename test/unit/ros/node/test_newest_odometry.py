"""The newest odometry in lock step."""

import pytest
import rospy
from message_fields import message
from nav_msgs.msg import Odometry

from bullet_lab.ros.node import odometry
from bullet_lab.ros.node.node import NodeError
from bullet_lab.ros.node.odometry import NewestOdometry


@pytest.fixture
def at_20_hz(monkeypatch):
    """A function that returns odometry of 1 s and 1.05 s, in lock step, from nobody."""
    monkeypatch.setattr(odometry, "subscriber", lambda *_: None)
    monkeypatch.setattr(odometry, "in_lock_step", lambda: True)
    monkeypatch.setattr(rospy.Time, "now", lambda: rospy.Time(0))

    def made(late=False):
        newest = NewestOdometry("odom", late)
        for nsecs in (0, 50_000_000):
            text = f"""
                header: {{stamp: {{secs: 1, nsecs: {nsecs}}}}}
                pose: {{pose: {{orientation: {{w: 1.0}}}}}}
            """
            newest.take(message(Odometry, text))
        return newest

    return made


def test_time_that_has_been_set_back_to_less_than_a_period_is_no_error(at_20_hz):
    assert at_20_hz().newest(rospy.Time(0.01)) == (0.0, 0.0, 0.0)


def test_the_message_of_this_step_is_waited_for_unless_it_comes_when_time_leaves_it(at_20_hz):
    assert at_20_hz(late=True).newest(rospy.Time(1, 100_000_000), 0.0)
    for late, nsecs in ((False, 100_000_000), (True, 101_000_000)):
        with pytest.raises(NodeError, match="no odometry on odom"):
            at_20_hz(late).newest(rospy.Time(1, nsecs), 0.0)


def test_without_patience_nobody_waits(at_20_hz, monkeypatch):
    monkeypatch.setattr(odometry, "in_lock_step", lambda: False)
    newest = NewestOdometry("odom")
    monkeypatch.setattr(newest._new, "wait", lambda _: pytest.fail("it waits"))
    with pytest.raises(NodeError, match="no odometry on odom"):
        newest.newest(None, 0.0)
