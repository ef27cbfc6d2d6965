"""How a node ends, and what it does beside its work."""

import gc
import threading
import weakref
from types import SimpleNamespace

import pytest
from shared import cases, python

from bullet_lab.ros.node import node

OWN, OTHER = "http://here:1", "http://there:2"
# Its main thread holds a lock that the end of the node needs, until the node ends, as rospy does
# while it registers with a master that is gone.
PROGRAM = """
import os, signal, threading, time
import rospy
from bullet_lab.ros.node.node import Signals
lock = threading.Lock()
signals = Signals()
rospy.core.add_preshutdown_hook(lambda _: lock.acquire())
with lock:
    os.kill(os.getpid(), signal.{name})
    while not rospy.is_shutdown():
        time.sleep(0.01)
signals.wait()
print(rospy.is_shutdown())
"""

# The kernel may give a signal to any thread; Python's handler runs in the main thread.
SPINNING = """
import signal, threading, time
from bullet_lab.ros.node.node import Signals, spin
def kill():
    time.sleep(0.5)
    signal.pthread_kill(threading.get_ident(), signal.SIGTERM)
    time.sleep(1000)
signals = Signals()
threading.Thread(target=kill, daemon=True).start()
spin()
print(signals.number)
"""

# The connection to the master breaks in the middle of a call, before the watch notices.
LOST = """
from bullet_lab.ros.node import node
online = iter((True, False))
node.rosgraph.is_master_online = lambda: next(online)
node.rospy.init_node = lambda *words, **options: None
node._watch_master = node._leave_master = lambda *_: None
def body():
    raise ConnectionResetError(104, "Connection reset by peer")
node.run_node("thing", body)
"""


def test_a_call_that_the_end_of_the_master_breaks_is_one_line():
    assert python(LOST) == (1, "", "thing: the ROS master is gone\n")


def test_a_signal_that_another_thread_gets_ends_a_node_that_only_listens():
    assert python(SPINNING) == (0, "15\n", "")


@pytest.mark.parametrize("name", [pytest.param("SIGINT", marks=pytest.mark.long), "SIGTERM"])
def test_a_signal_ends_a_node_whose_main_thread_is_busy(name):
    assert python(PROGRAM.format(name=name)) == (0, "True\n", "")


@cases("ending: [false, true]")
def test_an_error_in_a_thread_is_reported_unless_the_node_ends(monkeypatch, caplog, ending):
    reported = []
    monkeypatch.setattr(node, "is_ending", lambda: ending)
    monkeypatch.setattr(
        threading, "excepthook", lambda error: node._report_error(reported.append, error)
    )
    with caplog.at_level("INFO", logger="rospy"):
        thread = threading.Thread(target=lambda: [].close(), name="/odom")
        thread.start()
        thread.join()
    assert len(reported) == (not ending)
    assert ("AttributeError" in caplog.text) == ending


class Thing:
    def __init__(self):
        self.myself = self


def test_what_holds_itself_is_freed_however_seldom_python_looks(monkeypatch):
    things = []
    clock = SimpleNamespace(sleep=lambda _: things.append(weakref.ref(Thing())))
    monkeypatch.setattr(node, "time", clock)
    monkeypatch.setattr(node.rospy, "is_shutdown", lambda: len(things) > 1)
    gc.disable()
    try:
        node._collect_garbage()
    finally:
        gc.enable()
        gc.unfreeze()
    assert [thing() for thing in things] == [None, None]


class FakeMaster:
    """A master that answers one thing after the other, and the last one again and again."""

    def __init__(self, *answers):
        self.answers = list(answers)

    def lookupNode(self, name):  # noqa: N802 (as rosgraph has it)
        answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if answer is None:
            raise OSError
        return answer


@pytest.mark.parametrize("end", [None, OTHER])
def test_a_node_ends_when_its_master_is_gone_or_another_one_but_not_for_a_single_miss(
    monkeypatch, end
):
    master, reasons = FakeMaster(OWN, OWN, end, OWN, end, end), []
    monkeypatch.setattr(node, "MASTER_CHECK_SECONDS", 0.001)
    monkeypatch.setattr(node.rosgraph, "Master", lambda _: master)
    monkeypatch.setattr(node.rospy, "get_node_uri", lambda: OWN)
    monkeypatch.setattr(node.rospy, "is_shutdown", lambda: bool(reasons))
    monkeypatch.setattr(node.rospy, "signal_shutdown", reasons.append)
    gone = threading.Event()
    node._watch_master(gone)
    assert gone.is_set()
    assert reasons == ["the ROS master is gone"]
    assert master.answers == [end]
