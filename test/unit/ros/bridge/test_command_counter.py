import threading

import pytest

from bullet_lab.ros.bridge import topics
from bullet_lab.ros.bridge.topics import Arrival, CommandCounter, Route

STRAIGHT = Arrival("/cmd_vel", "/a")
RELAYED = Arrival("/cmd_vel", "/relay")


@pytest.fixture(autouse=True)
def _no_settling(monkeypatch):
    monkeypatch.setattr(topics, "SETTLE_SECONDS", 0.0)


class Waiting(threading.Condition):
    """Waiting that takes no time: what comes `late` comes then, in turn, and else nothing does."""

    def __init__(self):
        super().__init__()
        self.late = []
        self.patience = []

    def wait_for(self, predicate, timeout=None):
        if not predicate():
            self.patience.append(timeout)
        while not predicate():
            if not self.late:
                return False
            self.late.pop(0)()
        return True


class Sender:
    """A member that sends its commands by one connection, straight or by a relay."""

    def __init__(self, arrival=STRAIGHT, member="/a"):
        self.arrival = arrival
        self.waiting = Waiting()
        self.counter = CommandCounter(lambda *_: {arrival} if arrival else set(), self.waiting)
        self.member = member
        self.sent = 0

    def report(self):
        straight = self.arrival == STRAIGHT
        topic, receiver = ("/cmd_vel", "/bridge") if straight else ("/wish", "/relay")
        return {Route(self.member, topic, receiver): self.sent}

    def join(self):
        return self.counter.heard(self.report())

    def wait(self):
        """Return whether all has come."""
        return not self.counter.wait(self.report())

    def waits_for_a_late_one(self):
        """Return whether it waited, and all came in the end."""
        self.waiting.late.append(self.arrive)
        return self.wait() and not self.waiting.late

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
        assert sender.waits_for_a_late_one()


def test_commands_of_others_do_not_count():
    sender = Sender()
    sender.join()
    sender.sent = 1
    sender.counter.note(Arrival("/cmd_vel", "/b"))
    sender.counter.note(Arrival("/other", "/a"))
    assert not sender.wait()


def test_what_does_not_lead_to_the_bridge_is_not_awaited():
    sender = Sender(arrival=None)
    assert sender.join() == set()
    sender.sent = 5
    assert sender.wait()
    assert not sender.waiting.patience


def test_lost_commands_are_given_up_once():
    sender = Sender()
    sender.join()
    sender.sent = 2
    assert not sender.wait()
    assert sender.wait()
    sender.sent = 3
    sender.arrive()
    assert sender.wait()


def test_a_member_that_was_started_again_counts_anew():
    sender = Sender()
    sender.join()
    sender.sent = 5
    sender.arrive(5, "first")
    assert sender.wait()
    sender.sent = 0
    sender.join()
    sender.sent = 1
    assert not sender.wait()
    sender.sent = 2
    sender.arrive(2, "second")
    assert sender.wait()


def test_what_a_relay_has_passed_on_before_does_not_count():
    sender = Sender(RELAYED)
    sender.sent = 7
    sender.arrive(3)
    assert sender.join() == {"/wish"}
    sender.sent = 8
    assert not sender.wait()


def test_a_multiplexer_that_drops_commands_is_waited_for_once():
    sender = Sender(RELAYED)
    sender.join()
    for number in range(1, 201):
        sender.sent = number
        assert sender.wait() == (number > 1)
    assert sender.waiting.patience == [topics.PATIENCE]
    sender.join()
    sender.sent += 1
    assert sender.waits_for_a_late_one()


def test_what_comes_after_it_was_given_up_is_not_taken_for_the_next():
    sender = Sender(RELAYED)
    sender.join()
    sender.sent = 1
    sender.arrive()
    assert sender.wait()
    # Two late ones, of which the bridge knows nothing.
    sender.arrive(2)
    sender.sent = 2
    sender.arrive()
    assert sender.wait()
    sender.sent = 3
    assert sender.waits_for_a_late_one()


def test_what_another_thread_notes_ends_the_waiting(monkeypatch):
    monkeypatch.setattr(topics, "PATIENCE", 60.0)
    counter = CommandCounter(lambda *_: {STRAIGHT})
    counter.heard({Route("/a", "/cmd_vel", "/bridge"): 0})
    late = threading.Thread(target=counter.note, args=(STRAIGHT,))
    late.start()
    assert not counter.wait({Route("/a", "/cmd_vel", "/bridge"): 1})
    late.join()
