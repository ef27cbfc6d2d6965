"""Functions for all nodes: start and end, parameters, refused messages."""

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
from typing import Any, Callable, Iterator, TypeVar, get_type_hints

import rosgraph
import rospy
import rospy.impl.simtime

from bullet_lab.core.files import FileError
from bullet_lab.core.parameters import ParameterError, read_parameters
from bullet_lab.entry import JOB, trim_memory
from bullet_lab.errors import LabError

STATUS_CANNOT_GO_ON = 1
STATUS_BAD_PARAMETER = 2
# Wall seconds between two checks of the master.
MASTER_CHECK_SECONDS = 2.0
# Wall seconds within which rospy has registered a node.
LONGEST_REGISTRATION = 10.0
# Wall seconds between two garbage collections.
GARBAGE_SECONDS = 10.0
LOCK_STEP = "lock_step"
# Parameter with the prefix of a robot's frames, which the tf library searches for.
TF_PREFIX = "tf_prefix"
# Wall seconds of waiting before it is reported.
REPORT_WAIT_SECONDS = 3.0
# Wall seconds between two looks for signals.
SIGNAL_CHECK_SECONDS = 0.5
# Wall seconds for which the main thread waits for the shutdown by a signal.
LONGEST_END = 10.0
_ROSOUT_PARAMETER = "/rosout_disable_topics_generation"

MASTER_ERRORS = (rosgraph.MasterException, OSError, HTTPException, xmlrpc.client.Error)
"""Exceptions of calls of the master or of other nodes: an error response, or no response."""

T = TypeVar("T")


class NodeError(LabError):
    """A node cannot start or continue."""


def run_node(
    name: str, body: Callable[[], None], before: Callable[[], None] = lambda: None
) -> None:
    """Run a node and exit: status 0 at a clean end or Ctrl-C, 2 on a bad parameter, else 1.

    As part of a job, the status is 128 + n after a signal n, and 1 if another node has ended it.

    Args:
        name: the node's name.
        body: the node's work; a LabError ends the node with its message on standard error.
        before: called before the node registers with the master.
    """
    # Lines appear at once in a file or a pipe as well.
    sys.stdout.reconfigure(line_buffering=True)
    master_is_gone = threading.Event()
    signals = Signals()
    try:
        if not rosgraph.is_master_online():
            raise NodeError(f"no ROS master answers at {rosgraph.get_master_uri()}")
        before()
        threading.excepthook = functools.partial(_report_error, threading.excepthook)
        rospy.init_node(name, disable_signals=True)
        library = logging.getLogger("bullet_lab")
        library.addHandler(_RosLog(logging.WARNING))
        library.propagate = False
        threading.Thread(target=_watch_master, args=(master_is_gone,), daemon=True).start()
        threading.Thread(target=_collect_garbage, daemon=True).start()
        body()
    except rospy.ROSInterruptException:
        # Ctrl-C, or another node ended this one: a clean end.
        pass
    except Exception as error:
        if is_ending() and not isinstance(error, (ParameterError, FileError)):
            # Another thread has closed the topics that the main thread uses.
            logging.getLogger("rospy").info("%s was ended", name, exc_info=True)
        elif isinstance(error, (LabError, rospy.ROSInitException)):
            is_parameter = isinstance(error, ParameterError)
            _end(name, error, STATUS_BAD_PARAMETER if is_parameter else STATUS_CANNOT_GO_ON)
        elif isinstance(error, MASTER_ERRORS) and not rosgraph.is_master_online():
            _end(name, "the ROS master is gone", STATUS_CANNOT_GO_ON)
        else:
            raise
    finally:
        signals.wait()
        _leave_master()
    if master_is_gone.is_set():
        _end(name, "the ROS master is gone", STATUS_CANNOT_GO_ON)
    if is_ending() and JOB in os.environ:
        sys.exit(128 + signals.number if signals.number else STATUS_CANNOT_GO_ON)


def is_ending() -> bool:
    """Return whether the shutdown of the node has been requested."""
    return rospy.core.is_shutdown_requested()


def _report_error(report: Callable[[Any], Any], error: threading.ExceptHookArgs) -> None:
    """Report an error that has ended a thread; while the node ends, only in rospy's log.

    A thread of rospy and the shutdown may close a connection at the same time, which fails.
    """
    if is_ending():
        said = error.exc_type, error.exc_value, error.exc_traceback
        logging.getLogger("rospy").info("%s was ended", error.thread, exc_info=said)
    else:
        report(error)


def _set_shutdown_flag(_reason: str) -> None:
    """Let `rospy.is_shutdown` return true before rospy closes the topics, not afterwards.

    To close topics, rospy takes a lock. The main thread holds it while it tries to register a
    topic with a master that is gone, until `rospy.is_shutdown` returns true.
    """
    rospy.core._shutdown_flag = True


def _leave_master() -> None:
    """Unsubscribe from the parameter that rospy subscribes to when a node logs.

    rospy does not, and the master would list the node for ever.
    """
    if rospy.get_node_uri() is None:
        return
    with contextlib.suppress(*MASTER_ERRORS):
        rosgraph.Master(rospy.get_name()).unsubscribeParam(rospy.get_node_uri(), _ROSOUT_PARAMETER)


class Signals(threading.Thread):
    """Ends the node at the first SIGINT or SIGTERM.

    rospy's own handlers interrupt the main thread, and wait for ever if it holds a certain lock,
    as during a call of the master.

    Attributes:
        number: of that signal, 0 before.
    """

    def __init__(self):
        super().__init__(name="signals", daemon=True)
        self._received: queue.SimpleQueue[int] = queue.SimpleQueue()
        self.number = 0
        for number in (signal.SIGINT, signal.SIGTERM):
            # A shell's background job ignores SIGINT.
            if signal.getsignal(number) != signal.SIG_IGN:
                # A handler may take no lock: the interrupted thread may hold it.
                signal.signal(number, lambda number, _: self._received.put(number))
        rospy.core.add_preshutdown_hook(_set_shutdown_flag)
        self.start()

    def run(self) -> None:  # noqa: D102 - inherited
        self.number = self._received.get()
        rospy.signal_shutdown(f"signal-{self.number}")

    def wait(self) -> None:
        """Wait for the shutdown if a signal has started it."""
        if self.number:
            self.join(LONGEST_END)


def _watch_master(is_gone: threading.Event) -> None:
    """End the node when the master is gone, which rospy itself does not notice.

    A new master in its place does not know this node's topics: the node ends, too.
    """
    # rospy registers the node in another thread.
    holds_within(_is_known_to_master, LONGEST_REGISTRATION)
    misses = 0
    while not rospy.is_shutdown():
        time.sleep(MASTER_CHECK_SECONDS)
        misses = 0 if _is_known_to_master() else misses + 1
        # A busy machine may cause a single miss.
        if misses >= 2 and not rospy.is_shutdown():
            is_gone.set()
            rospy.signal_shutdown("the ROS master is gone")


def _is_known_to_master() -> bool:
    name = rospy.get_name()
    with contextlib.suppress(*MASTER_ERRORS):
        return rosgraph.Master(name).lookupNode(name) == rospy.get_node_uri()
    return False


def _collect_garbage() -> None:
    """Free the closed connections of rospy from time to time.

    Their objects refer to each other: buffers and file descriptors stay until Python collects all
    garbage, which it does less and less often as the number of objects grows.
    """
    # Imported modules are never garbage: they need no check.
    gc.freeze()
    while not rospy.is_shutdown():
        time.sleep(GARBAGE_SECONDS)
        gc.collect()
        trim_memory()


def node(body: Callable[[Any], None]) -> Callable[[], None]:
    """Make the main function of a node from its work, which takes the node's parameters.

    The node has the function's name, and the type of its argument `parameters` declares them.
    """

    @functools.wraps(body)
    def program() -> None:
        kind = get_type_hints(body)["parameters"]
        run_node(body.__name__, lambda: body(private_parameters(kind)))

    return program


def private_parameters(kind: type[T]) -> T:
    """Read the node's parameters from the master; raises ParameterError.

    ~lock_step is a parameter of every node, see `bullet_lab.ros.node.lock_step`.
    """
    given = rospy.get_param("~", {})
    names = set(given if isinstance(given, dict) else {}) - {LOCK_STEP}
    return read_parameters(kind, rospy.get_param, dict.fromkeys(names))


def search_parameter(name: str, namespace: str) -> str:
    """Return a parameter as text, searched for from a namespace upwards; empty if there is none.

    Raises NodeError if no master answers.
    """
    # The search begins in the namespace of the caller's name.
    caller = f"/{namespace.strip('/')}/node".replace("//", "/")
    if not rosgraph.names.is_legal_name(caller):
        return ""
    master = rosgraph.Master(caller)
    try:
        found = master.searchParam(name)
        return str(master.getParam(found)) if found else ""
    except rosgraph.MasterException:
        # The parameter was deleted in between.
        return ""
    except MASTER_ERRORS as error:
        raise NodeError(f"no ROS master answers: {error}") from error


def tf_prefix(namespace: str) -> str:
    """Return the tf_prefix of a namespace with a slash at its end; empty without one."""
    prefix = search_parameter(TF_PREFIX, namespace).strip("/")
    return prefix and f"{prefix}/"


def ignore_clock() -> None:
    """Unsubscribe this node from /clock, to which rospy subscribes in every node."""
    own = getattr(rospy.impl.simtime, "_clock_sub", None)
    if own is not None:
        own.unregister()


def spin() -> None:
    """Wait until ROS shuts down, which `rospy.spin` notices up to half a second later."""
    ended = threading.Event()
    rospy.on_shutdown(ended.set)
    # Python's handlers run in this thread, which a signal that another thread gets does not wake.
    while not ended.wait(SIGNAL_CHECK_SECONDS):
        pass


def check_running() -> None:
    """Raise ROSInterruptException if ROS shuts down."""
    if rospy.is_shutdown():
        raise rospy.ROSInterruptException("shutdown")


def holds_within(condition: Callable[[], Any], seconds: float) -> bool:
    """Wait in wall time, and return whether a condition holds within `seconds`.

    If ROS shuts down first, return False.
    """
    deadline = time.monotonic() + seconds
    while not condition():
        if rospy.is_shutdown() or time.monotonic() >= deadline:
            return False
        time.sleep(0.01)
    return True


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Wait in wall time until a condition holds; log `what` after `REPORT_WAIT_SECONDS`.

    Raises ROSInterruptException if ROS shuts down first.
    """
    if not holds_within(condition, REPORT_WAIT_SECONDS):
        rospy.loginfo("waiting for %s", what)
        if not holds_within(condition, math.inf):
            raise rospy.ROSInterruptException("shutdown")


class Refusals:
    """Counts refused messages and logs them, once a second at most."""

    def __init__(self):
        self.counts: Counter = Counter()
        self._last_report = -math.inf

    @contextlib.contextmanager
    def on(self, topic: str) -> Iterator[None]:
        """Refuse a message on a topic if a LabError is raised within the context."""
        try:
            yield
        except LabError as error:
            self.refuse(topic, str(error))

    def refuse(self, topic: str, reason: str) -> None:
        """Count a refused message on a topic, and log the reason."""
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
    """Passes the library's log records on to rospy; tracebacks go to the node's log file only."""

    def emit(self, record: logging.LogRecord) -> None:
        log = rospy.logerr if record.levelno >= logging.ERROR else rospy.logwarn
        log("%s", record.getMessage())
        if record.exc_info:
            logging.getLogger("rospy").info("Traceback", exc_info=record.exc_info)
