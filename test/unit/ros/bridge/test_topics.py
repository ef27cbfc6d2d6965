import threading
from types import SimpleNamespace

import pytest
import rospy
from geometry_msgs.msg import Twist
from shared import cases

from bullet_lab.ros.bridge import topics
from bullet_lab.ros.bridge.topics import Arrival, CommandCounter, DeviceTopics, Route
from bullet_lab.simulation.plugins import Input, PluginError
from bullet_lab.simulation.plugins.samples import PlanarCommand


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (PluginError("too fast"), "too fast"),
        (ZeroDivisionError("by zero"), "ZeroDivisionError: by zero"),
    ],
)
def test_a_command_that_one_plugin_cannot_take_reaches_the_others(monkeypatch, error, reason):
    told, taken, callbacks = [], [], []

    def subscriber(topic, kind, receive, **_):
        callbacks.append(receive)
        return SimpleNamespace(get_num_connections=lambda: 1)

    monkeypatch.setattr(rospy, "Subscriber", subscriber)
    monkeypatch.setattr(rospy, "logwarn", lambda line, *parts: told.append(line % parts))

    def fail(command):
        raise error

    topics = DeviceTopics(SimpleNamespace(do_now=lambda call: call()))
    inputs = [Input("/cmd_vel", PlanarCommand, handle) for handle in (fail, taken.append)]
    topics.connect([SimpleNamespace(outputs=(), inputs=inputs)], "robot")
    message = Twist()
    message.linear.x = 0.5
    message._connection_header = {"callerid": "/driver"}
    (receive,) = callbacks
    receive(message)
    assert [command.vx for command in taken] == [0.5]
    assert told == [f"/cmd_vel: refused: {reason} (1 so far)"]


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
    """A member that sends its commands by one connection, straight or by a relay.

    It does what the words of a story say, such as "join, sent 2, come, late".
    """

    def __init__(self, arrival):
        self.arrival = arrival
        self.route = ("/cmd_vel", "/bridge") if arrival == STRAIGHT else ("/wish", "/relay")
        self.waiting = Waiting()
        self.counter = CommandCounter(lambda *_: {arrival} if arrival else set(), self.waiting)
        self.number = self.connection = 0

    def does(self, story):
        for words in story.split(", "):
            word, *numbers = words.split()
            getattr(self, word)(*map(int, numbers))

    def report(self):
        return {Route("/a", *self.route): self.number}

    def join(self):
        led = set(self.route[:1] if self.arrival else ())
        assert self.counter.heard(self.report()) == led

    def sent(self, number):
        self.number = number

    def restarts(self):
        self.number, self.connection = 0, 1

    def come(self, count=1):
        for _ in range(count):
            self.counter.note(self.arrival, self.connection)

    def others(self):
        for arrival in (Arrival("/cmd_vel", "/b"), Arrival("/other", "/a")):
            self.counter.note(arrival)

    def all(self):
        """All has come, or is not waited for."""
        assert not self.counter.wait(self.report())

    def lacks(self):
        assert self.counter.wait(self.report())

    def late(self):
        """It waits for one that comes late, and all has come in the end."""
        self.waiting.late.append(self.come)
        self.all()
        assert not self.waiting.late


@cases("""
relayed, story:
  - [false, "join, sent 2, come, late, sent 4, come, late, sent 6, come, late"]
  - [true, "join, sent 2, come, late, sent 4, come, late, sent 6, come, late"]
  - [false, "join, sent 1, others, lacks"]
  # Lost commands are given up once.
  - [false, "join, sent 2, lacks, all, sent 3, come, all"]
  # A member that was started again counts anew.
  - - false
    - join, sent 5, come 5, all, restarts, join, sent 1, lacks, sent 2, come 2, all
  # What a relay has passed on before does not count.
  - [true, "sent 7, come 3, join, sent 8, lacks"]
  # The two late ones, of which the bridge knows nothing, are not taken for the next.
  - [true, "join, sent 1, come, all, come 2, sent 2, come, all, sent 3, late"]
""")
def test_what_was_sent_is_awaited(relayed, story):
    Sender(RELAYED if relayed else STRAIGHT).does(story)


def test_what_does_not_lead_to_the_bridge_is_not_awaited():
    sender = Sender(arrival=None)
    sender.does("join, sent 5, all")
    assert not sender.waiting.patience


def test_a_multiplexer_that_drops_commands_is_waited_for_once():
    sender = Sender(RELAYED)
    sender.does("join, sent 1, lacks")
    for number in range(2, 201):
        sender.does(f"sent {number}, all")
    assert sender.waiting.patience == [topics.PATIENCE]
    sender.does("join, sent 201, late")


def test_what_another_thread_notes_ends_the_waiting(monkeypatch):
    monkeypatch.setattr(topics, "PATIENCE", 60.0)
    counter = CommandCounter(lambda *_: {STRAIGHT})
    counter.heard({Route("/a", "/cmd_vel", "/bridge"): 0})
    late = threading.Thread(target=counter.note, args=(STRAIGHT,))
    late.start()
    assert not counter.wait({Route("/a", "/cmd_vel", "/bridge"): 1})
    late.join()
