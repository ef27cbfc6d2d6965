import threading
import time

import pytest

pytest.importorskip("rospy")

import rospy
from nav_msgs.msg import Odometry

from bullet_lab.ros.node import odometry
from bullet_lab.ros.node.odometry import MessageQueue


def odometry_at(seconds):
    message = Odometry()
    message.header.stamp = rospy.Time.from_sec(seconds)
    return message


def make_queue(rate=20.0, read=lambda message: message.header.stamp.to_sec()):
    return MessageQueue("odom", Odometry, read, rate)


def receive(queue, *stamps):
    for stamp in stamps:
        queue._receive(odometry_at(stamp))


def test_a_queue_gives_what_is_stamped_up_to_now():
    queue = make_queue()
    receive(queue, 0.05, 0.1, 0.15)
    assert queue.take(rospy.Time.from_sec(0.1)) == [0.05, 0.1]
    assert queue.take(rospy.Time.from_sec(0.1)) == []
    assert queue.take(rospy.Time.from_sec(1.0)) == [0.15]


def test_a_queue_refuses_what_goes_back_and_says_why(monkeypatch):
    monkeypatch.setattr(rospy, "logwarn", lambda *_: None)
    queue = make_queue()
    receive(queue, 0.1, 0.05)
    assert "out-of-order stamp 0.05" in queue.trouble
    assert queue.take(rospy.Time(1)) == [0.1]
    queue.clear()
    receive(queue, 0.05)
    assert (queue.trouble, queue.take(rospy.Time(1))) == ("", [0.05])


@pytest.mark.parametrize(
    ("rate", "stamps", "now", "due"),
    [
        (20.0, (), 0.0, False),
        (20.0, (), 0.05, True),
        (20.0, (0.05,), 0.05, False),
        (20.0, (0.05,), 0.1, True),
        # At 30 Hz the bridge's steps are 34, 67 and 100 ms.
        (30.0, (0.034,), 0.05, False),
        (30.0, (0.034,), 0.066, False),
        (30.0, (0.034,), 0.067, True),
        (30.0, (0.067,), 0.099, False),
        (30.0, (0.067,), 0.1, True),
        (5.0, (0.2,), 0.35, False),
    ],
)
def test_a_queue_waits_for_what_is_due(monkeypatch, rate, stamps, now, due):
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    monkeypatch.setattr(odometry, "LATEST", 0.05)
    queue = make_queue(rate)
    monkeypatch.setattr(odometry, "in_lock_step", lambda: True)
    queue.clear()
    receive(queue, *stamps)
    start = time.monotonic()
    queue.wait(rospy.Time.from_sec(now))
    assert (time.monotonic() - start >= 0.05) == due


def test_a_queue_goes_on_as_soon_as_it_is_there(monkeypatch):
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    queue = make_queue()
    monkeypatch.setattr(odometry, "in_lock_step", lambda: True)
    threading.Timer(0.05, receive, (queue, 0.05)).start()
    start = time.monotonic()
    queue.wait(rospy.Time.from_sec(0.05))
    assert time.monotonic() - start < 5.0
    assert queue.take(rospy.Time.from_sec(0.05)) == [0.05]


def test_what_never_comes_is_waited_for_once(monkeypatch):
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    monkeypatch.setattr(odometry, "LATEST", 0.1)
    queue = make_queue()
    monkeypatch.setattr(odometry, "in_lock_step", lambda: True)
    queue.clear()
    for expected in (True, False, False):
        start = time.monotonic()
        queue.wait(rospy.Time(1))
        assert (time.monotonic() - start >= 0.1) == expected


def test_out_of_lock_step_nothing_is_waited_for(monkeypatch):
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    start = time.monotonic()
    make_queue().wait(rospy.Time(1))
    assert time.monotonic() - start < odometry.LATEST
