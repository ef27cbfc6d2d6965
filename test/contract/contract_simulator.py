"""The simulator on the ROS master: calls its services, lets time run, and records its topics."""

import concurrent.futures
import contextlib
import threading
import time
from io import BytesIO

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

ANSWER_SECONDS = 20.0
"""Timeout of a service call, in wall s."""

TOPICS_SECONDS = 3.0
"""Timeout for a topic to get a publisher or a subscriber, in wall s."""

SETTLE_SECONDS = 0.3
"""Wall seconds for messages to arrive."""

SLOWEST = 60.0
"""Wall seconds in which a simulated second must pass."""

HALF_STEP = 5e-4
"""In simulated s."""

_CALL_ERRORS = (
    *(rosservice.ROSServiceException, rospy.ServiceException, genpy.MessageException),
    *(ValueError, OSError),
)


class SimulatorError(LabError):
    """The simulator does not do what is asked of it."""


class CallError(LabError):
    """A service did not answer."""


class Gazebo:
    """Uses a simulator through the services of Gazebo and /clock.

    Attributes:
        master: the ROS master.
        time: of the last message on /clock, in s.
    """

    def __init__(self):
        self.master = rosgraph.Master(rospy.get_name())
        self.time = 0.0
        self._kinds = {}
        self._ticked = threading.Condition()
        self._clock = rospy.Subscriber("/clock", Clock, self._take_time, tcp_nodelay=True)

    def call(self, service, request):
        """Return the answer of a service, by default of /gazebo, to a dictionary.

        Raises CallError.
        """

        def filled(kind):
            message = kind()
            genpy.message.fill_message_args(message, [dict(request)])
            return message

        return self._answer(service, filled)

    def must(self, service, **request):
        """Return the answer of a service; raise SimulatorError unless it reports success."""
        try:
            answer = self._answer(service, lambda kind: kind(**request))
        except CallError as error:
            raise SimulatorError(str(error)) from error
        if not getattr(answer, "success", True):
            raise SimulatorError(f"{service}: {answer.status_message}")
        return answer

    def _answer(self, service, make):
        """Return the answer to a request that is made of its class."""
        name = ns_join("/gazebo", service)
        try:
            if name not in self._kinds:
                self._kinds[name] = rosservice.get_service_class_by_name(name)
            kind = self._kinds[name]
            request = make(kind._request_class)
            return _within(ANSWER_SECONDS, lambda: rospy.ServiceProxy(name, kind)(request))
        except concurrent.futures.TimeoutError as error:
            raise CallError(f"{name}: no answer in {ANSWER_SECONDS:g} s") from error
        except _CALL_ERRORS as error:
            raise CallError(f"{name}: {error}") from error

    def offered(self):
        """Return the names of all services."""
        return [name for name, _ in self.master.getSystemState()[2]]

    def answers(self):
        """Return whether the simulator answers."""
        with contextlib.suppress(CallError):
            self.call("get_world_properties", {})
            return True
        return False

    def sim_time(self):
        """Return simulated time in s."""
        return self.must("get_world_properties").sim_time

    def run_until(self, end, seconds):
        """Let time run, about so many seconds, until /clock has reached a time (s).

        Raises SimulatorError on a timeout.
        """
        patience = SLOWEST * max(seconds, 1.0)
        self.must("unpause_physics")
        with self._ticked:
            # It may have been later before a reset.
            self.time = min(self.time, end - seconds)
            if not self._ticked.wait_for(lambda: self.time >= end - HALF_STEP, patience):
                raise SimulatorError(f"/clock did not reach {end:.3f} s in {patience:g} s")
        self.must("pause_physics")

    def _take_time(self, message):
        with self._ticked:
            self.time = message.clock.to_sec()
            self._ticked.notify_all()


class Simulator(Gazebo):
    """The simulator as the contract uses it; simulated time passes only in `run`."""

    def __init__(self):
        super().__init__()
        self._recorder = Recorder()

    def services(self, names):
        """Return type and md5 sum of those of the services that exist."""
        found = {}
        for name in names:
            with contextlib.suppress(rosgraph.MasterException, *_CALL_ERRORS):
                uri = self.master.lookupService(name)
                header = rosservice.get_service_headers(name, uri)
                found[name] = header.get("type", ""), header.get("md5sum", "")
        return found

    def is_back_within(self, seconds):
        """Wait for a simulator that died to be started again; return whether it answers."""
        return wait_until(self.answers, seconds, 1.0)

    def listen(self, topics):
        """Subscribe to topics, and wait a while until each of them has a publisher."""
        self._recorder.listen(topics)
        wait_until(self._recorder.is_connected)

    def forget(self):
        """Unsubscribe from all topics."""
        self._recorder.close()

    def run(self, seconds, commands=()):
        """Send commands, let time run, and return what was seen in exactly these seconds.

        Each command has a topic, a `type` and a `message`.
        """
        publishers = [_publisher(entry) for entry in commands]
        evidence = Evidence(*self._topics())
        start = self.sim_time()
        self._recorder.begin()
        # Before time runs, so that commands act for all of it, even on a busy machine.
        for publisher, message in publishers:
            publisher.publish(message)
        if publishers:
            time.sleep(SETTLE_SECONDS)
        self.run_until(start + seconds, seconds)
        time.sleep(SETTLE_SECONDS)
        evidence.heard, evidence.frames = self._recorder.end()
        evidence.seconds = self.sim_time() - start
        for heard in evidence.heard.values():
            heard.cut(start + seconds)
        for publisher, _ in publishers:
            publisher.unregister()
        return evidence

    def stand(self, seconds):
        """Return what was seen in some wall seconds while time was paused."""
        evidence = Evidence(*self._topics())
        self._recorder.begin()
        time.sleep(seconds)
        evidence.heard, evidence.frames = self._recorder.end()
        return evidence

    def _topics(self):
        """Return the types of topics that other nodes publish, and of those they subscribe to."""
        types = dict(self.master.getTopicTypes())
        own = rospy.get_name()
        return [
            {name: types.get(name, "?") for name, nodes in topics if set(nodes) - {own}}
            for topics in self.master.getSystemState()[:2]
        ]


class Recorder:
    """Records the messages on topics."""

    def __init__(self):
        self._lock = threading.Lock()
        self._on = False
        self._heard, self._frames, self._subscribers = {}, set(), {}
        self._tf = rospy.Subscriber("/tf", TFMessage, self._take_frames)

    def listen(self, topics):
        """Subscribe to topics, besides the present ones."""
        for name in sorted(set(topics) - set(self._subscribers)):
            self._subscribers[name] = rospy.Subscriber(
                name, rospy.AnyMsg, self._take, callback_args=name, tcp_nodelay=True
            )

    def is_connected(self):
        """Return whether each topic has a publisher."""
        return all(entry.get_num_connections() for entry in self._subscribers.values())

    def begin(self):
        """Begin to record."""
        with self._lock:
            self._on, self._heard, self._frames = True, {}, set()

    def end(self):
        """Stop recording; return the messages by topic, and the pairs of frames on /tf."""
        with self._lock:
            self._on = False
            heard, frames = self._heard, self._frames
        for entry in heard.values():
            entry.kind = roslib.message.get_message_class(entry.type)
        return heard, frames

    def close(self):
        """Unsubscribe from all topics but /tf."""
        for subscriber in self._subscribers.values():
            subscriber.unregister()
        self._subscribers.clear()

    def _take(self, message, name):
        header = message._connection_header
        made = Heard(header["type"], header["md5sum"], header.get("latching") == "1")
        with self._lock:
            if self._on:
                self._heard.setdefault(name, made).buffers.append(_buffer(message))

    def _take_frames(self, message):
        pairs = {(entry.header.frame_id, entry.child_frame_id) for entry in message.transforms}
        with self._lock:
            if self._on:
                self._frames |= pairs


def _buffer(message):
    """Return a serialized message: rospy hands on typed ones for topics such as /clock."""
    if isinstance(message, rospy.AnyMsg):
        return message._buff
    stream = BytesIO()
    message.serialize(stream)
    return stream.getvalue()


def _publisher(entry):
    """Return the publisher of a command and its message; raise SimulatorError.

    Waits a while for a subscriber.
    """
    kind = roslib.message.get_message_class(entry["type"])
    if kind is None:
        raise SimulatorError(f"{entry['type']} is not installed here")
    message = kind()
    genpy.message.fill_message_args(message, [dict(entry.get("message") or {})])
    publisher = rospy.Publisher(entry["topic"], kind, queue_size=10)
    wait_until(publisher.get_num_connections)
    return publisher, message


def wait_until(condition, seconds=TOPICS_SECONDS, period=0.02):
    """Wait for a condition, at most for some wall seconds; return whether it holds."""
    until = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > until:
            return False
        time.sleep(period)
    return True


def _within(seconds, action):
    """Return the result of an action, which runs in a thread; raise TimeoutError."""
    future = concurrent.futures.Future()

    def act():
        try:
            future.set_result(action())
        except Exception as error:
            future.set_exception(error)

    # A pool would wait for the thread when Python ends.
    threading.Thread(target=act, daemon=True).start()
    return future.result(seconds)
