"""The simulator on the ROS master: calls its services, lets time run, and records its topics."""

from __future__ import annotations

import concurrent.futures
import contextlib
import threading
import time
from io import BytesIO
from typing import Any, Callable, Dict, Iterable, List, Mapping, Tuple

import genpy
import rosgraph
import roslib.message
import rospy
import rosservice
from contract_judges import Evidence, Heard
from rosgraph.names import ns_join
from rosgraph_msgs.msg import Clock
from tf2_msgs.msg import TFMessage

from bullet_lab.errors import LabError

CALLER = "/gazebo_contract"
ANSWER_SECONDS = 20.0
"""Timeout of a service call, in wall s."""

TOPICS_SECONDS = 3.0
"""Timeout for a topic to get a publisher or a subscriber, in wall s."""

SETTLE_SECONDS = 0.3
"""Wall seconds for messages to arrive."""

SLOWEST = 20.0
"""Wall seconds in which a simulated second must pass."""

_CALL_ERRORS = (
    *(rosservice.ROSServiceException, rospy.ServiceException, genpy.MessageException),
    *(ValueError, OSError),
)
_POLL_SECONDS = 0.02
_CLOCK_POLL_SECONDS = 0.002


class SimulatorError(LabError):
    """The simulator does not do what is necessary to check the contract."""


class CallError(LabError):
    """A service did not answer."""


class Simulator:
    """Uses a simulator through the interface of Gazebo; simulated time passes only in `run`."""

    def __init__(self):
        self._master = rosgraph.Master(CALLER)
        self._lock = threading.Lock()
        self._now = 0.0
        self._recorder = Recorder()
        self._clock = rospy.Subscriber("/clock", Clock, self._take_time)

    def call(self, service: str, request: Mapping[str, Any]) -> Any:
        """Return the answer of a service, by default of /gazebo; raise CallError."""
        name = ns_join("/gazebo", service)
        try:
            kind = rosservice.get_service_class_by_name(name)
            message = kind._request_class()
            genpy.message.fill_message_args(message, [dict(request)])
            return _within(ANSWER_SECONDS, lambda: rospy.ServiceProxy(name, kind)(message))
        except concurrent.futures.TimeoutError as error:
            raise CallError(f"{name}: no answer in {ANSWER_SECONDS:g} s") from error
        except _CALL_ERRORS as error:
            raise CallError(f"{name}: {error}") from error

    def services(self, names: Iterable[str]) -> Dict[str, Tuple[str, str]]:
        """Return type and md5 sum of those of the services that exist."""
        found: Dict[str, Tuple[str, str]] = {}
        for name in names:
            with contextlib.suppress(rosgraph.MasterException, *_CALL_ERRORS):
                uri = self._master.lookupService(name)
                header = rosservice.get_service_headers(name, uri)
                found[name] = header.get("type", ""), header.get("md5sum", "")
        return found

    def offered(self) -> List[str]:
        """Return the names of all services."""
        return [name for name, _ in self._master.getSystemState()[2]]

    def answers(self) -> bool:
        """Return whether the simulator answers."""
        try:
            self.call("get_world_properties", {})
            return True
        except CallError:
            return False

    def is_back_within(self, seconds: float) -> bool:
        """Wait for a simulator that died to be started again; return whether it answers."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            if self.answers():
                return True
            time.sleep(1.0)
        return False

    def must(self, service: str, **request: Any) -> Any:
        """Return the answer of a service; raise SimulatorError unless it reports success."""
        try:
            answer = self.call(service, request)
        except CallError as error:
            raise SimulatorError(str(error)) from error
        if not getattr(answer, "success", True):
            raise SimulatorError(f"{service}: {answer.status_message}")
        return answer

    def listen(self, topics: Iterable[str]) -> None:
        """Subscribe to topics, and wait a while until each of them has a publisher."""
        self._recorder.listen(topics)
        _wait_until(self._recorder.is_connected)

    def forget(self) -> None:
        """Unsubscribe from all topics."""
        self._recorder.close()

    def run(self, seconds: float, commands: Iterable[Mapping[str, Any]] = ()) -> Evidence:
        """Send commands, let time run, and return what was seen in exactly these seconds.

        Each command has a topic, a `type` and a `message`.
        """
        publishers = [_publisher(entry) for entry in commands]
        evidence = Evidence(*self._topics())
        start = self._sim_time()
        self._recorder.begin()
        # Before time runs, so that commands act for all of it, even on a busy machine.
        for publisher, message in publishers:
            publisher.publish(message)
        if publishers:
            time.sleep(SETTLE_SECONDS)
        self.must("unpause_physics")
        self._wait(start, seconds)
        self.must("pause_physics")
        time.sleep(SETTLE_SECONDS)
        evidence.heard, evidence.frames = self._recorder.end()
        evidence.seconds = self._sim_time() - start
        for heard in evidence.heard.values():
            heard.cut(start + seconds)
        for publisher, _ in publishers:
            publisher.unregister()
        return evidence

    def stand(self, seconds: float) -> Evidence:
        """Return what was seen in some wall seconds while time was paused."""
        evidence = Evidence(*self._topics())
        self._recorder.begin()
        time.sleep(seconds)
        evidence.heard, evidence.frames = self._recorder.end()
        return evidence

    def _sim_time(self) -> float:
        return self.must("get_world_properties").sim_time

    def _topics(self) -> Tuple[Dict[str, str], Dict[str, str]]:
        """Return the types of topics that other nodes publish, and of those they subscribe to."""
        published, subscribed, _ = self._master.getSystemState()
        types = dict(self._master.getTopicTypes())
        own = rospy.get_name()
        return tuple(  # type: ignore[return-value]
            {name: types.get(name, "?") for name, nodes in topics if set(nodes) - {own}}
            for topics in (published, subscribed)
        )

    def _take_time(self, message: Clock) -> None:
        with self._lock:
            self._now = message.clock.to_sec()

    def _wait(self, start: float, seconds: float) -> None:
        """Wait until /clock has advanced by some seconds; raise SimulatorError on a timeout."""
        until = time.monotonic() + SLOWEST * max(seconds, 1.0)
        with self._lock:
            self._now = start
        while time.monotonic() < until:
            with self._lock:
                if self._now - start >= seconds:
                    return
            time.sleep(_CLOCK_POLL_SECONDS)
        raise SimulatorError(f"{seconds:g} s of /clock did not pass in {SLOWEST * seconds:g} s")


class Recorder:
    """Records the messages on topics."""

    def __init__(self):
        self._lock = threading.Lock()
        self._on = False
        self._heard: Dict[str, Heard] = {}
        self._frames: set = set()
        self._subscribers: Dict[str, rospy.Subscriber] = {}
        self._tf = rospy.Subscriber("/tf", TFMessage, self._take_frames)

    def listen(self, topics: Iterable[str]) -> None:
        """Subscribe to topics, besides the present ones."""
        for name in sorted(set(topics) - set(self._subscribers)):
            self._subscribers[name] = rospy.Subscriber(
                name, rospy.AnyMsg, self._take, callback_args=name, tcp_nodelay=True
            )

    def is_connected(self) -> bool:
        """Return whether each topic has a publisher."""
        return all(entry.get_num_connections() for entry in self._subscribers.values())

    def begin(self) -> None:
        """Begin to record."""
        with self._lock:
            self._on, self._heard, self._frames = True, {}, set()

    def end(self) -> Tuple[Dict[str, Heard], set]:
        """Stop recording; return the messages by topic, and the pairs of frames on /tf."""
        with self._lock:
            self._on = False
            heard, frames = self._heard, self._frames
        for entry in heard.values():
            entry.kind = roslib.message.get_message_class(entry.type)
        return heard, frames

    def close(self) -> None:
        """Unsubscribe from all topics but /tf."""
        for subscriber in self._subscribers.values():
            subscriber.unregister()
        self._subscribers.clear()

    def _take(self, message: Any, name: str) -> None:
        header = message._connection_header
        with self._lock:
            if self._on:
                latching = header.get("latching") == "1"
                heard = self._heard.setdefault(
                    name, Heard(header.get("type", ""), header.get("md5sum", ""), latching)
                )
                heard.buffers.append(_buffer(message))

    def _take_frames(self, message: TFMessage) -> None:
        with self._lock:
            if self._on:
                self._frames |= {
                    (entry.header.frame_id, entry.child_frame_id) for entry in message.transforms
                }


def _buffer(message: Any) -> bytes:
    """Return a serialized message: rospy hands on typed ones for topics such as /clock."""
    if isinstance(message, rospy.AnyMsg):
        return message._buff
    stream = BytesIO()
    message.serialize(stream)
    return stream.getvalue()


def _publisher(entry: Mapping[str, Any]) -> Tuple[rospy.Publisher, Any]:
    """Return the publisher of a command and its message; raise SimulatorError.

    Waits a while for a subscriber.
    """
    kind = roslib.message.get_message_class(entry["type"])
    if kind is None:
        raise SimulatorError(f"{entry['type']} is not installed here")
    message = kind()
    genpy.message.fill_message_args(message, [dict(entry.get("message") or {})])
    publisher = rospy.Publisher(entry["topic"], kind, queue_size=10)
    _wait_until(publisher.get_num_connections)
    return publisher, message


def _wait_until(condition: Callable[[], Any]) -> None:
    until = time.monotonic() + TOPICS_SECONDS
    while not condition() and time.monotonic() < until:
        time.sleep(_POLL_SECONDS)


def _within(seconds: float, action: Callable[[], Any]) -> Any:
    """Return the result of an action, which runs in a thread; raise TimeoutError."""
    future: concurrent.futures.Future = concurrent.futures.Future()

    def act() -> None:
        try:
            future.set_result(action())
        except Exception as error:
            future.set_exception(error)

    # A pool would wait for the thread when Python ends.
    threading.Thread(target=act, daemon=True).start()
    return future.result(seconds)
