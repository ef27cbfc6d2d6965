"""The simulator that answers on the master: called, listened to, and let run for a while."""

from __future__ import annotations

import contextlib
import threading
import time
from io import BytesIO
from typing import Any, Callable, Dict, Iterable, List, Mapping, Optional, Tuple

import genpy
import rosgraph
import roslib.message
import rospy
import rosservice
from rosgraph_msgs.msg import Clock
from tf2_msgs.msg import TFMessage

from bullet_lab.errors import LabError
from bullet_lab.ros.contract.evidence import Evidence, Heard

CALLER = "/gazebo_contract"
# Wall seconds: for a service's answer, for topics that come up, for messages on their way, and
# for one simulated second of a simulator that is busy.
ANSWER_SECONDS = 20.0
TOPICS_SECONDS = 3.0
SETTLE_SECONDS = 0.3
SLOWEST = 20.0
LOOK_SECONDS = 0.02


class SimulatorError(LabError):
    """The simulator does not do what the contract needs to be checked at all."""


class CallError(LabError):
    """A service did not answer."""


class Simulator:
    """Speaks with a simulator by what every Gazebo offers; time runs only in `run`."""

    def __init__(self):
        self._master = rosgraph.Master(CALLER)
        self._lock = threading.Lock()
        self._now = 0.0
        self._services: Dict[str, Tuple[str, str]] = {}
        self._recorder = Recorder()
        self._clock = rospy.Subscriber("/clock", Clock, self._take_time)

    def call(self, service: str, request: Mapping[str, Any]) -> Any:
        """Return what a service answers; raises CallError."""
        name = service if service.startswith("/") else f"/gazebo/{service}"
        type_name, _ = self.service(name)
        kind = roslib.message.get_service_class(type_name)
        if kind is None:
            raise CallError(f"{name}: {type_name} is not installed here")
        message = kind._request_class()
        try:
            genpy.message.fill_message_args(message, [dict(request)])
            return _within(ANSWER_SECONDS, lambda: rospy.ServiceProxy(name, kind)(message))
        except (rospy.ServiceException, genpy.MessageException, ValueError) as error:
            raise CallError(f"{name}: {error}") from error

    def service(self, name: str) -> Tuple[str, str]:
        """Return the type and the md5 sum of a service; raises CallError without it."""
        if name not in self._services:
            try:
                uri = self._master.lookupService(name)
                header = rosservice.get_service_headers(name, uri)
                self._services[name] = (header["type"], header["md5sum"])
            except (rosgraph.MasterException, rosservice.ROSServiceException, KeyError) as error:
                raise CallError(f"there is no service {name}") from error
            except (OSError, rosservice.ROSServiceIOException) as error:
                raise CallError(f"{name} does not answer: {error}") from error
        return self._services[name]

    def offered(self) -> List[str]:
        """Return the names of all services."""
        return [name for name, _ in self._master.getSystemState()[2]]

    def must(self, service: str, request: Mapping[str, Any]) -> Any:
        """Return what a service answers, which has to say that it succeeded."""
        try:
            answer = self.call(service, request)
        except CallError as error:
            raise SimulatorError(str(error)) from error
        if not getattr(answer, "success", True):
            raise SimulatorError(f"{service}: {answer.status_message}")
        return answer

    def listen(self, topics: Iterable[str]) -> None:
        """Listen to topics from now on, and wait for those of them that somebody publishes."""
        self._recorder.listen(topics)
        until = time.monotonic() + TOPICS_SECONDS
        while self._recorder.lonely() and time.monotonic() < until:
            time.sleep(LOOK_SECONDS)

    def forget(self) -> None:
        """Listen to nothing any more."""
        self._recorder.close()
        self._services.clear()

    def run(self, seconds: float, commands: Iterable[Mapping[str, Any]] = ()) -> Evidence:
        """Send commands, let time run, and return what was seen in just so many seconds.

        Each command has a topic, a `type` and a `message`.
        """
        speakers = [_speaker(entry) for entry in commands]
        evidence = Evidence(*self._topics())
        start = self.now()
        self._recorder.begin()
        # While time stands, so that they act for all of the time however busy the machine is.
        for publisher, message in speakers:
            publisher.publish(message)
        if speakers:
            time.sleep(SETTLE_SECONDS)
        self.must("unpause_physics", {})
        self._wait(start, seconds)
        self.must("pause_physics", {})
        time.sleep(SETTLE_SECONDS)
        evidence.heard, evidence.frames = self._recorder.end()
        evidence.seconds = self.now() - start
        for heard in evidence.heard.values():
            heard.cut(start + seconds)
        for publisher, _ in speakers:
            publisher.unregister()
        return evidence

    def stand(self, seconds: float) -> Evidence:
        """Return what was seen in some wall seconds while time stood still."""
        evidence = Evidence(*self._topics())
        self._recorder.begin()
        time.sleep(seconds)
        evidence.heard, evidence.frames = self._recorder.end()
        return evidence

    def services(self, names: Iterable[str]) -> Dict[str, Tuple[str, str]]:
        """Return type and md5 sum of those services that there are."""
        found: Dict[str, Tuple[str, str]] = {}
        for name in names:
            with contextlib.suppress(CallError):
                found[name] = self.service(name)
        return found

    def now(self) -> float:
        """Return simulated time, in s."""
        return self.must("get_world_properties", {}).sim_time

    def _topics(self) -> Tuple[Dict[str, str], Dict[str, str]]:
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
        """Wait until so much time has passed; raises SimulatorError where it does not."""
        until = time.monotonic() + SLOWEST * max(seconds, 1.0)
        with self._lock:
            self._now = start
        while time.monotonic() < until:
            with self._lock:
                if self._now - start >= seconds:
                    return
            time.sleep(0.002)
        raise SimulatorError(f"{seconds:g} s of /clock did not pass in {SLOWEST * seconds:g} s")


class Recorder:
    """Keeps what comes on topics, as it comes."""

    def __init__(self):
        self._lock = threading.Lock()
        self._on = False
        self._heard: Dict[str, Heard] = {}
        self._frames: set = set()
        self._subscribers: Dict[str, rospy.Subscriber] = {}
        self._tf = rospy.Subscriber("/tf", TFMessage, self._take_frames)

    def listen(self, topics: Iterable[str]) -> None:
        """Listen to topics, beside those that it listens to."""
        for name in sorted(set(topics) - set(self._subscribers)):
            self._subscribers[name] = rospy.Subscriber(
                name, rospy.AnyMsg, self._take, callback_args=name, tcp_nodelay=True
            )

    def lonely(self) -> List[str]:
        """Return the topics that nobody publishes."""
        subscribers = self._subscribers.items()
        return [name for name, entry in subscribers if not entry.get_num_connections()]

    def begin(self) -> None:
        """Keep what comes from now on."""
        with self._lock:
            self._on, self._heard, self._frames = True, {}, set()

    def end(self) -> Tuple[Dict[str, Heard], set]:
        """Return what has come, and keep nothing more."""
        with self._lock:
            self._on = False
            heard, frames = self._heard, self._frames
        for entry in heard.values():
            entry.kind = roslib.message.get_message_class(entry.type)
        return heard, frames

    def close(self) -> None:
        """Listen no longer, but to /tf."""
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
    """Return a message as it came; one that this node hears as a typed one, too, is typed."""
    if isinstance(message, rospy.AnyMsg):
        return message._buff
    stream = BytesIO()
    message.serialize(stream)
    return stream.getvalue()


def _speaker(entry: Mapping[str, Any]) -> Tuple[rospy.Publisher, Any]:
    """Return a publisher that somebody hears, if anybody does, and its message."""
    kind = roslib.message.get_message_class(entry["type"])
    if kind is None:
        raise SimulatorError(f"{entry['type']} is not installed here")
    message = kind()
    genpy.message.fill_message_args(message, [dict(entry.get("message") or {})])
    publisher = rospy.Publisher(entry["topic"], kind, queue_size=10)
    until = time.monotonic() + TOPICS_SECONDS
    while not publisher.get_num_connections() and time.monotonic() < until:
        time.sleep(LOOK_SECONDS)
    return publisher, message


def _within(seconds: float, action: Callable[[], Any]) -> Any:
    """Return what an action returns; raises ServiceException where that takes too long."""
    found: List[Any] = []
    failed: List[Optional[BaseException]] = []

    def act() -> None:
        try:
            found.append(action())
        except Exception as error:
            failed.append(error)

    thread = threading.Thread(target=act, daemon=True)
    thread.start()
    thread.join(seconds)
    if failed and failed[0] is not None:
        raise failed[0]
    if not found:
        raise rospy.ServiceException(f"no answer in {seconds:g} s")
    return found[0]
