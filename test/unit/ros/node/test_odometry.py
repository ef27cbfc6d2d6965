"""Odometry in lock step, by its stamps and the newest, waited for on a clock of the test."""

import pytest
import rospy
from message_fields import message
from nav_msgs.msg import Odometry
from shared import cases, refuses

from bullet_lab.ros.node import odometry
from bullet_lab.ros.node.node import NodeError
from bullet_lab.ros.node.odometry import LATEST, MessageQueue, NewestOdometry


class Queue:
    """A queue of stamps in s, the time that it has waited, and what comes meanwhile."""

    def __init__(self, monkeypatch, clock, rate=20.0):
        self.late = []
        self.clock = clock
        self.queue = MessageQueue("odom", Odometry, lambda m: m.header.stamp.to_sec(), rate)
        monkeypatch.setattr(odometry, "time", clock)
        monkeypatch.setattr(self.queue._new, "wait", self.pass_time)
        monkeypatch.setattr(odometry, "in_lock_step", lambda: True)

    def pass_time(self, seconds):
        self.clock.sleep(seconds)
        self.receive(*self.late)

    def receive(self, *stamps):
        for stamp in stamps:
            message = Odometry()
            message.header.stamp = rospy.Time.from_sec(stamp)
            self.queue._receive(message)

    def waited(self, now):
        """Wait, and return whether that was for as long as it does."""
        before = self.clock.now
        self.queue.wait(rospy.Time.from_sec(now))
        return self.clock.now - before >= LATEST

    def take(self, now):
        return self.queue.take(rospy.Time.from_sec(now))


@pytest.fixture
def queue(monkeypatch, clock):
    return Queue(monkeypatch, clock)


def test_a_queue_gives_what_is_stamped_up_to_now(queue):
    queue.receive(0.05, 0.1, 0.15)
    assert [queue.take(now) for now in (0.1, 0.1, 1.0)] == [[0.05, 0.1], [], [0.15]]


def test_a_queue_refuses_what_goes_back_and_says_why(queue):
    queue.receive(0.1, 0.05)
    assert "out-of-order stamp 0.05" in queue.queue.trouble
    assert queue.take(1.0) == [0.1]
    queue.queue.clear()
    queue.receive(0.05)
    assert (queue.queue.trouble, queue.take(1.0)) == ("", [0.05])


@cases("""
rate, stamps, now, due:
  # The rate (Hz), the stamps that came (s), what time it is (s), and whether it waits.
  - [20.0, [], 0.0, false]
  - [20.0, [], 0.05, true]
  - [20.0, [0.05], 0.05, false]
  - [20.0, [0.05], 0.1, true]
  # At 30 Hz the bridge's steps are 34, 67 and 100 ms.
  - [30.0, [], 0.033, false]
  - [30.0, [0.034], 0.066, false]
  - [30.0, [0.034], 0.067, true]
  - [30.0, [0.067], 0.099, false]
  - [30.0, [0.067], 0.1, true]
  - [5.0, [0.2], 0.35, false]
""")
def test_a_queue_waits_for_what_is_due(monkeypatch, clock, rate, stamps, now, due):
    queue = Queue(monkeypatch, clock, rate)
    queue.receive(*stamps)
    assert queue.waited(now) == due


def test_a_queue_goes_on_as_soon_as_it_is_there(queue):
    queue.late = [0.05]
    assert not queue.waited(0.05)
    assert queue.take(0.05) == [0.05]


def test_what_never_comes_is_waited_for_once(queue):
    assert [queue.waited(1.0) for _ in range(3)] == [True, False, False]
    queue.receive(0.5)
    assert queue.waited(1.0)


def test_out_of_lock_step_nothing_is_waited_for(queue, monkeypatch):
    monkeypatch.setattr(odometry, "in_lock_step", lambda: False)
    assert not queue.waited(1.0)


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
        with refuses("no odometry on odom", NodeError):
            at_20_hz(late).newest(rospy.Time(1, nsecs), 0.0)


def test_without_patience_nobody_waits(at_20_hz, monkeypatch):
    monkeypatch.setattr(odometry, "in_lock_step", lambda: False)
    newest = NewestOdometry("odom")
    monkeypatch.setattr(newest._new, "wait", lambda _: pytest.fail("it waits"))
    with refuses("no odometry on odom", NodeError):
        newest.newest(None, 0.0)
