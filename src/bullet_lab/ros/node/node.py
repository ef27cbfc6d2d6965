"""What all nodes share: start, parameters, refusals on topics, the end."""

from __future__ import annotations

import contextlib
import functools
import gc
import logging
import math
import os
import queue
import signal
import sys
import threading
import time
import xmlrpc.client
from collections import Counter
from http.client import HTTPException
from typing import Any, Callable, Type, TypeVar, get_type_hints

import rosgraph
import rospy
import rospy.impl.simtime

from bullet_lab.core.files import FileError
from bullet_lab.core.parameters import ParameterError, read_parameters
from bullet_lab.entry import JOB, trim_memory
from bullet_lab.errors import LabError

STATUS_CANNOT_GO_ON = 1
STATUS_BAD_PARAMETER = 2
MASTER_CHECK_SECONDS = 2.0
LONGEST_REGISTRATION = 10.0
GARBAGE_SECONDS = 10.0
LOCK_STEP = "lock_step"
# The parameter that keeps the frames of several robots apart, as the tf library finds it.
TF_PREFIX = "tf_prefix"
REPORT_WAIT_SECONDS = 3.0
# Wall seconds that the main thread waits for the thread that ends the node.
LONGEST_END = 10.0
_ROSOUT_PARAMETER = "/rosout_disable_topics_generation"

MASTER_ERRORS = (rosgraph.MasterException, OSError, HTTPException, xmlrpc.client.Error)
"""What calls of the master, or of other nodes, raise: it is refused, or there is no answer."""

T = TypeVar("T")


class NodeError(LabError):
    """A node cannot start or go on."""


def run_node(
    name: str, body: Callable[[], None], before: Callable[[], None] = lambda: None
) -> None:
    """Run a node and exit: status 0 at a clean end or Ctrl-C, 2 on a bad parameter, else 1.

    As part of a job it is 128 + n after a signal n, and 1 where another node has ended it.

    Args:
        name: the node's name.
        body: the node's work; LabError from it ends the node with that one line.
        before: is run before the node registers with the master.
    """
    # What a node says is of use while it runs, in a file or a pipe as well.
    sys.stdout.reconfigure(line_buffering=True)
    master_is_gone = threading.Event()
    signals = Signals()
    try:
        if not rosgraph.is_master_online():
            raise NodeError(f"no ROS master answers at {rosgraph.get_master_uri()}")
        before()
        rospy.init_node(name, disable_signals=True)
        library = logging.getLogger("bullet_lab")
        library.addHandler(_RosLog(logging.WARNING))
        library.propagate = False
        threading.Thread(target=_watch_master, args=(master_is_gone,), daemon=True).start()
        threading.Thread(target=_collect_garbage, daemon=True).start()
        # Raised by Ctrl-C, or where another node asked this one to end: a clean end.
        with contextlib.suppress(rospy.ROSInterruptException):
            body()
    except ParameterError as error:
        _end(name, error, STATUS_BAD_PARAMETER)
    except FileError as error:
        _end(name, error, STATUS_CANNOT_GO_ON)
    except Exception as error:
        if not is_ending():
            if not isinstance(error, (LabError, rospy.ROSInitException)):
                raise
            _end(name, error, STATUS_CANNOT_GO_ON)
        # Whoever ends a node does so beside the main thread, which finds topics closed.
        logging.getLogger("rospy").info("%s was ended", name, exc_info=True)
    finally:
        signals.wait()
        _leave_master()
    if master_is_gone.is_set():
        _end(name, "the ROS master is gone", STATUS_CANNOT_GO_ON)
    if is_ending() and JOB in os.environ:
        sys.exit(128 + signals.number if signals.number else STATUS_CANNOT_GO_ON)


def is_ending() -> bool:
    """Return whether the node is about to end, its topics closed or not."""
    return rospy.core.is_shutdown_requested()


def _wait_no_longer(_reason: str) -> None:
    """Have all see that the node ends before rospy closes its topics, not after it.

    It takes a lock for that which the main thread holds while it tries to register a topic with
    a master that is gone, until the node ends.
    """
    rospy.core._shutdown_flag = True


def _leave_master() -> None:
    """Unsubscribe from the parameter that rospy subscribes to where a node logs, and never leaves.

    A master would know the node for ever, as one that still runs.
    """
    if rospy.get_node_uri() is None:
        return
    # A master that is gone has nothing to forget.
    with contextlib.suppress(*MASTER_ERRORS):
        rosgraph.Master(rospy.get_name()).unsubscribeParam(rospy.get_node_uri(), _ROSOUT_PARAMETER)


class Signals(threading.Thread):
    """Ends the node at the first SIGINT or SIGTERM.

    rospy's own handlers do it in the main thread, wherever that is, and wait for ever for a lock
    that it holds, as where it asks the master something.

    Attributes:
        number: of that signal, 0 before.
    """

    def __init__(self):
        super().__init__(name="signals", daemon=True)
        self._come: queue.SimpleQueue[int] = queue.SimpleQueue()
        self.number = 0
        for number in (signal.SIGINT, signal.SIGTERM):
            # A shell's background job is not to be interrupted.
            if signal.getsignal(number) != signal.SIG_IGN:
                # A handler may do no more: what it interrupts may hold any lock.
                signal.signal(number, lambda number, _: self._come.put(number))
        rospy.core.add_preshutdown_hook(_wait_no_longer)
        self.start()

    def run(self) -> None:  # noqa: D102 - inherited
        self.number = self._come.get()
        rospy.signal_shutdown(f"signal-{self.number}")

    def wait(self) -> None:
        """Wait until the node has ended, if it is being ended by a signal."""
        if self.number:
            self.join(LONGEST_END)


def _watch_master(is_gone: threading.Event) -> None:
    """End the node when the master is gone, which rospy itself never notices.

    So it is where another one has taken its place, which knows nothing of this node's topics.
    """
    # rospy registers in a thread of its own.
    end = time.monotonic() + LONGEST_REGISTRATION
    while not _is_known_to_master() and time.monotonic() < end and not rospy.is_shutdown():
        time.sleep(0.1)
    misses = 0
    while not rospy.is_shutdown():
        time.sleep(MASTER_CHECK_SECONDS)
        misses = 0 if _is_known_to_master() else misses + 1
        # One miss may be a busy machine.
        if misses >= 2 and not rospy.is_shutdown():
            is_gone.set()
            rospy.signal_shutdown("the ROS master is gone")


def _is_known_to_master() -> bool:
    name = rospy.get_name()
    with contextlib.suppress(*MASTER_ERRORS):
        return rosgraph.Master(name).lookupNode(name) == rospy.get_node_uri()
    return False


def _collect_garbage() -> None:
    """Free what rospy leaves where a subscriber or a topic goes, every now and then.

    Its connections and pollers hold themselves: images and descriptors stay until all objects are
    looked through, which Python does less and less often as they get more.
    """
    # What was imported stays, and need not be looked through each time.
    gc.freeze()
    while not rospy.is_shutdown():
        time.sleep(GARBAGE_SECONDS)
        gc.collect()
        trim_memory()


def node(body: Callable[[Any], None]) -> Callable[[], None]:
    """Make a program of a node's work, whose name is the node's, and which takes its parameters.

    Their dataclass is what `parameters` is annotated with.
    """

    @functools.wraps(body)
    def program() -> None:
        kind = get_type_hints(body)["parameters"]
        run_node(body.__name__, lambda: body(private_parameters(kind)))

    return program


def private_parameters(kind: Type[T]) -> T:
    """Read the node's parameters from the master; raises ParameterError.

    ~lock_step is a parameter of every node, see `bullet_lab.ros.node.lock_step`.
    """
    given = rospy.get_param("~", {})
    names = set(given if isinstance(given, dict) else {}) - {LOCK_STEP}
    return read_parameters(kind, rospy.get_param, dict.fromkeys(names))


def search_parameter(name: str, namespace: str) -> str:
    """Return what a parameter says in a namespace, or in the nearest around it; empty without one.

    Raises NodeError where no master answers.
    """
    # The search begins in the namespace of whoever asks.
    asking = f"/{namespace.strip('/')}/node".replace("//", "/")
    if not rosgraph.names.is_legal_name(asking):
        return ""
    master = rosgraph.Master(asking)
    try:
        found = master.searchParam(name)
        return str(master.getParam(found)) if found else ""
    except rosgraph.MasterException:
        # It is gone meanwhile.
        return ""
    except MASTER_ERRORS as error:
        raise NodeError(f"no ROS master answers: {error}") from error


def ignore_clock() -> None:
    """Spare this node the messages on /clock, all of which rospy takes whoever asks the time."""
    own = getattr(rospy.impl.simtime, "_clock_sub", None)
    if own is not None:
        own.unregister()


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Wait in wall time until a condition holds, and say after a while what is waited for.

    Raises ROSInterruptException if ROS shuts down first.
    """
    report = time.monotonic() + REPORT_WAIT_SECONDS
    while not condition():
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException("shutdown")
        if time.monotonic() > report:
            report = math.inf
            rospy.loginfo("waiting for %s", what)
        time.sleep(0.01)


class Refusals:
    """Counts refused messages and reports them, once a second at most."""

    def __init__(self):
        self.counts: Counter = Counter()
        self._last_report = -math.inf

    def refuse(self, topic: str, reason: str) -> None:
        """Count one refused message on a topic and say why."""
        self.counts[topic] += 1
        now = time.monotonic()
        if now - self._last_report >= 1.0:
            self._last_report = now
            rospy.logwarn("%s: refused: %s (%d so far)", topic, reason, self.counts[topic])

    @property
    def total(self) -> int:
        """Number of messages refused so far, on all topics."""
        return sum(self.counts.values())


def _end(name: str, error: object, status: int) -> None:
    line = f"{name}: {error}"
    rospy.signal_shutdown(line)
    print(line, file=sys.stderr, flush=True)
    sys.exit(status)


class _RosLog(logging.Handler):
    """Hands what the library logs to ROS."""

    def emit(self, record: logging.LogRecord) -> None:
        log = rospy.logerr if record.levelno >= logging.ERROR else rospy.logwarn
        log("%s", record.getMessage())
