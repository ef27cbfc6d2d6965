import threading
import time

import pytest

from bullet_lab.ros.bridge import timing
from bullet_lab.ros.bridge.timing import Arrival, CommandCounter, Sent

STRAIGHT = Arrival("/cmd_vel", "/a")
RELAYED = Arrival("/cmd_vel", "/relay")


@pytest.fixture(autouse=True)
def _patience(monkeypatch):
    monkeypatch.setattr(timing, "PATIENCE", 0.3)
    monkeypatch.setattr(timing, "FIRST_PATIENCE", 0.1)
    monkeypatch.setattr(timing, "SETTLE_SECONDS", 0.0)


class Sender:
    """A member that sends its commands by one connection, straight or by a relay."""

    def __init__(self, arrival=STRAIGHT, member="/a"):
        self.arrival = arrival
        self.counter = CommandCounter(lambda *_: {arrival} if arrival else set())
        self.member = member
        self.sent = 0

    def report(self):
        straight = self.arrival == STRAIGHT
        topic, receiver = ("/cmd_vel", "/bridge") if straight else ("/wish", "/relay")
        return [Sent(topic, receiver, self.sent)]

    def join(self):
        return self.counter.heard(self.member, self.report())

    def wait(self):
        """Return whether all has come, and the seconds that took."""
        start = time.monotonic()
        return not self.counter.wait(self.member, self.report()), time.monotonic() - start

    def arrive(self, count=1, connection=None):
        for _ in range(count):
            self.counter.note(self.arrival, connection)


@pytest.mark.parametrize("arrival", [STRAIGHT, RELAYED])
def test_what_was_sent_is_awaited(arrival):
    sender = Sender(arrival)
    sender.join()
    for number in range(1, 4):
        sender.sent = 2 * number
        sender.arrive()
        threading.Timer(0.05, sender.arrive).start()
        come, seconds = sender.wait()
        assert come and seconds >= 0.04


def test_commands_of_others_do_not_count():
    sender = Sender()
    sender.join()
    sender.sent = 1
    sender.counter.note(Arrival("/cmd_vel", "/b"))
    sender.counter.note(Arrival("/other", "/a"))
    assert not sender.wait()[0]


def test_what_does_not_lead_to_the_bridge_is_not_awaited():
    sender = Sender(arrival=None)
    assert sender.join() == set()
    sender.sent = 5
    assert sender.wait() == (True, pytest.approx(0.0, abs=0.05))


def test_lost_commands_are_given_up_once():
    sender = Sender()
    sender.join()
    sender.sent = 2
    assert not sender.wait()[0]
    assert sender.wait()[0]
    sender.sent = 3
    sender.arrive()
    assert sender.wait()[0]


def test_a_member_that_was_started_again_counts_anew():
    sender = Sender()
    sender.join()
    sender.sent = 5
    sender.arrive(5, "first")
    assert sender.wait()[0]
    sender.sent = 0
    sender.join()
    sender.sent = 1
    assert not sender.wait()[0]
    sender.sent = 2
    sender.arrive(2, "second")
    assert sender.wait()[0]


def test_what_a_relay_has_passed_on_before_does_not_count():
    sender = Sender(RELAYED)
    sender.sent = 7
    sender.arrive(3)
    assert sender.join() == {"/wish"}
    sender.sent = 8
    assert not sender.wait()[0]


def test_a_multiplexer_that_drops_commands_is_waited_for_once():
    sender = Sender(RELAYED)
    sender.join()
    total = 0.0
    for number in range(1, 201):
        sender.sent = number
        come, seconds = sender.wait()
        assert come == (number > 1)
        total += seconds
    assert total < 0.2


def test_a_multiplexer_that_passes_commands_on_again_is_waited_for_again():
    sender = Sender(RELAYED)
    sender.join()
    sender.sent = 1
    assert not sender.wait()[0]
    for _ in range(timing.STREAK):
        sender.sent += 1
        sender.arrive()
        assert sender.wait()[0]
    sender.sent += 1
    threading.Timer(0.05, sender.arrive).start()
    come, seconds = sender.wait()
    assert come and seconds >= 0.04


def test_one_that_drops_now_and_then_is_trusted_less_and_less():
    sender = Sender(RELAYED)
    sender.join()
    losses = 0
    for number in range(1, 1001):
        sender.sent = number
        if number % 25:
            sender.arrive()
        losses += not sender.wait()[0]
    assert 1 <= losses <= 3


def test_what_comes_after_it_was_given_up_is_not_taken_for_the_next():
    sender = Sender(RELAYED)
    sender.join()
    sender.sent = 1
    sender.arrive()
    assert sender.wait()[0]
    # Two late ones, of which the bridge knows nothing.
    sender.arrive(2)
    sender.sent = 2
    sender.arrive()
    assert sender.wait()[0]
    sender.sent = 3
    threading.Timer(0.05, sender.arrive).start()
    come, seconds = sender.wait()
    assert come and seconds >= 0.04
