"""The recorder, which runs any report of `bullet_lab.reports` in a node.

It subscribes to the report's topics, passes on the messages, refuses and counts those that cannot
be used, renews the figures while it runs, and ends when the report is complete.
"""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass
from functools import partial
from typing import Any, Callable, Iterable, Mapping, NamedTuple

import rospy
from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import Image, Imu, LaserScan, Range
from std_msgs.msg import Time

from bullet_lab.core.files import FileError
from bullet_lab.core.parameters import mapping, number, text
from bullet_lab.core.se2 import pose_from_above
from bullet_lab.docking.types import DockingState
from bullet_lab.errors import LabError
from bullet_lab.msg import DockActionFeedback, ImagePoints, MarkerDetectionArray, TouchedModels
from bullet_lab.reports import Figures, Reading, Report, Summary, save_results
from bullet_lab.reports.goal import GoalAnswer
from bullet_lab.ros.messages.gazebo_types import msg
from bullet_lab.ros.messages.images import pixels_of
from bullet_lab.ros.node.lock_step import END_OF_TIME, grant, join_when, subscriber, time_held_at
from bullet_lab.ros.node.node import NodeError, Refusals, holds_within, wait_until
from bullet_lab.ros.node.odometry import FrameGuard
from bullet_lab.ros.nodes.drive_squares import DriveSquaresParameters
from bullet_lab.ros.nodes.drive_to_goal import DriveToGoalParameters
from bullet_lab.ros.nodes.noisy_odom import NoisyOdomParameters
from bullet_lab.ros.nodes.show_sensors import last_states

# Wall seconds to wait for the last messages after the end was announced.
PATIENCE = 5.0
POLL_SECONDS = 0.02
# Wall seconds between two versions of the paths in RViz.
VIEW_PERIOD = 0.5
# Simulated time at which a goal is sent: between two ticks of the server.
GOAL_TIME = rospy.Time(0, 525_000_000)
# States of a goal that may still change.
UNDER_WAY = (
    GoalStatus.PENDING,
    GoalStatus.ACTIVE,
    GoalStatus.PREEMPTING,
    GoalStatus.RECALLING,
)
# Wall seconds for the server to accept the goal.
ACCEPTANCE = 30.0


@dataclass(frozen=True)
class RecordParameters:
    """Private parameters of every node that records."""

    out: str = text("results", "folder for the files")
    # The text of a launch file; if it is empty, the entry is the node's default.
    about: Mapping[str, Any] = mapping(
        "further entries of summary.json",
        NoisyOdomParameters,
        DriveSquaresParameters,
        DriveToGoalParameters,
    )
    # Without annotations, as these are parameters of the subclasses only.
    plot_period = math.inf
    until = ""


@dataclass(frozen=True)
class RenewedParameters(RecordParameters):
    """Private parameters of a node that renews its figures while it runs."""

    plot_period: float = number(10.0, "wall seconds between two versions of the figure", above=0.0)


@dataclass(frozen=True)
class TimedParameters(RenewedParameters):
    """Private parameters of a node that records up to a time."""

    until: str = text("", "topic (std_msgs/Time) that ends it; empty: until Ctrl-C")


class GoalRequest(NamedTuple):
    """A goal that is sent before the recording begins.

    Attributes:
        server: node that accepts it.
        is_connected: returns whether it can be sent.
        send: sends it.
        is_taken: returns whether the server has accepted or refused it.
    """

    server: str
    is_connected: Callable[[], bool]
    send: Callable[[], None]
    is_taken: Callable[[], bool]


class Recorder:
    """Records until the report is complete or ROS shuts down, then writes all files.

    `view` shows the paths in RViz, such as `bullet_lab.ros.record.plots.PathTopics`; `request` is a
    goal to send first.
    """

    def __init__(
        self,
        report: Report,
        parameters: RecordParameters,
        view: Any = None,
        request: GoalRequest | None = None,
    ):
        self._report = report
        self._view = view
        self._request = request
        self._lock = threading.Lock()
        self._refusals = Refusals()
        # Wall seconds of the first and the last message.
        self._first = math.inf
        self._last = 0.0
        # Of the topics whose paths the view shows.
        self._frames: dict[str, str] = {}
        self._failure: FileError | None = None
        self._finished = False
        report.about = parameters.about
        self._period = parameters.plot_period
        if parameters.until:
            rospy.Subscriber(parameters.until, Time, self._receive_end)
        self._subscribers: list[rospy.Subscriber] = []
        for topic, kind in report.topics.items():
            message_type, read = reader_of(kind)
            receive = partial(self._receive, topic, read)
            self._subscribers.append(subscriber(topic, message_type, receive))

    def run(self) -> None:
        """Record, and write all files.

        Raises FileError, or NodeError if the goal was not accepted or not reached.
        """
        if self._view is not None:
            threading.Thread(target=self._show, daemon=True).start()
        complete = False
        try:
            if self._request is None:
                join_when(self._is_connected, ", ".join(self._report.topics))
            else:
                self._send_goal(self._request)
            complete = self._wait()
            if complete:
                # The simulation would take processor time from the figures.
                grant(rospy.Time(0))
        finally:
            summary = self._finish(complete)
            if complete:
                grant(END_OF_TIME)
            failed, line = self._report.has_failed(summary), self._report.line(summary)
            if not failed:
                rospy.loginfo("%s", line)
        if failed:
            raise NodeError(line)

    def _send_goal(self, request: GoalRequest) -> None:
        wait_until(lambda: self._is_connected() and request.is_connected(), request.server)
        # In lock step, time stands until the server has the goal, and starts at its next tick.
        with time_held_at(GOAL_TIME):
            request.send()
            if not holds_within(request.is_taken, ACCEPTANCE) and not rospy.is_shutdown():
                line = f"{request.server} has not accepted the goal within {ACCEPTANCE:g} s"
                raise NodeError(line)

    def _is_connected(self) -> bool:
        return all(one.get_num_connections() > 0 for one in self._subscribers)

    def _wait(self) -> bool:
        """Wait for the end of the recording; return False if ROS shuts down first."""
        until, announced, drawn = None, 0.0, time.monotonic()
        while not rospy.is_shutdown():
            with self._lock:
                if self._failure is not None:
                    raise self._failure
                if self._report.is_complete():
                    return True
                known = self._report.until
            now = time.monotonic()
            if known != until:
                until, announced = known, now
            if until is not None and now - announced > PATIENCE:
                rospy.logwarn("no data after the announced end; the recording may be incomplete")
                return True
            if now - drawn >= self._period:
                self._renew()
                drawn = time.monotonic()
            time.sleep(POLL_SECONDS)
        return False

    def _finish(self, complete: bool) -> Summary:
        for one in self._subscribers:
            one.unregister()
        with self._lock:
            # A callback may still be waiting for the lock.
            self._finished = True
            self._report.finish(self._report.until if complete else None)
            summary, figures = self._contents(finished=complete)
        # The summary comes last: programs that wait for it find all files. But if the recording was
        # interrupted it comes first: the process may be killed soon.
        save_results(self._report, summary, figures, summary_first=not complete)
        return summary

    # Messages

    def _receive(self, topic: str, read: Callable[[Any], Reading], message: Any) -> None:
        with self._lock:
            if self._finished or self._failure is not None:
                return
            try:
                recorded = self._report.take(topic, read(message))
            except FileError as error:
                self._failure = error
            except LabError as error:
                self._refusals.refuse(topic, str(error))
            else:
                if recorded:
                    self._last = time.monotonic()
                    self._first = min(self._first, self._last)
                    if self._view is not None:
                        self._frames[topic] = message.header.frame_id

    def _receive_end(self, message: Time) -> None:
        with self._lock:
            self._report.until = message.data.to_nsec()

    def _show(self) -> None:
        while not rospy.is_shutdown():
            rospy.rostime.wallsleep(VIEW_PERIOD)
            with self._lock:
                self._view.show(self._report, self._frames)

    # Files

    def _renew(self) -> None:
        try:
            with self._lock:
                summary, figures = self._contents(finished=False)
            save_results(self._report, summary, figures)
        except (FileError, OSError) as error:
            rospy.logerr_throttle(10.0, f"cannot write: {error}")

    def _contents(self, finished: bool) -> tuple[Summary, Figures]:
        """Return the summary and the figures; those are rendered later, without the lock."""
        seconds, wall = self._report.seconds(), max(0.0, self._last - self._first)
        run = {
            "sim_time_s": seconds,
            "wall_time_s": wall,
            "real_time_factor": seconds / wall if wall > 0.0 else None,
            "refused_messages": self._refusals.total,
        }
        summary = self._report.summary(finished, run)
        return summary, self._report.figures(summary)


def reader_of(kind: str) -> tuple[type, Callable[[Any], Reading]]:
    """Return the class of a type of messages, and a function that reads those of one topic."""
    if kind == "nav_msgs/Odometry":
        return Odometry, partial(_odometry, FrameGuard())
    message_type, contents = READERS[kind]
    return message_type, lambda message: Reading(_stamp(message), *contents(message))


def _stamp(message: Any) -> int:
    if isinstance(message, GoalStatus):
        return 0
    return (message.data if isinstance(message, Time) else message.header.stamp).to_nsec()


def _odometry(guard: FrameGuard, message: Odometry) -> Reading:
    """Return the pose, and the covariance of x and y (m²); the frames must not change."""
    entries = message.pose.covariance
    covariance = ((entries[0], entries[1]), (entries[6], entries[7]))
    return Reading(_stamp(message), guard.check(message), covariance)


def _inertial(message: Imu) -> tuple:
    force, rate = message.linear_acceleration, message.angular_velocity
    return ((force.x, force.y, force.z, rate.x, rate.y, rate.z),)


def _contacts(message: msg.ContactsState) -> tuple:
    """Return points and sum of the forces in the last step, and the models that were touched."""
    states = last_states(message)
    points = sum(len(state.contact_positions) for state in states)
    forces = [state.total_wrench.force for state in states]
    sums = (sum(getattr(force, axis) for force in forces) for axis in "xyz")
    return (points, *sums), [state.collision2_name.split("::")[0] for state in message.states]


def _goal_status(message: GoalStatus) -> tuple:
    rejected = message.status in (GoalStatus.REJECTED, GoalStatus.RECALLED)
    reached, over = message.status == GoalStatus.SUCCEEDED, message.status not in UNDER_WAY
    return (), GoalAnswer(message.goal_id.id, message.text, rejected, reached, over)


def _places(things: Iterable[Any]) -> tuple:
    return (), [(place.x, place.y) for place in things]


# The class of each type of messages except odometry, and a function that returns the values and the
# detail of a reading.
READERS: dict[str, tuple[type, Callable[[Any], tuple]]] = {
    "sensor_msgs/Range": (Range, lambda m: ((m.range,),)),
    # Detail: the angle of the first ray and the step to the next, rad.
    "sensor_msgs/LaserScan": (LaserScan, lambda m: (m.ranges, (m.angle_min, m.angle_increment))),
    "sensor_msgs/Imu": (Imu, _inertial),
    "gazebo_msgs/ContactsState": (msg.ContactsState, _contacts),
    "geometry_msgs/PoseStamped": (
        PoseStamped,
        lambda m: (pose_from_above(m.pose.position, m.pose.orientation),),
    ),
    "actionlib_msgs/GoalStatus": (GoalStatus, _goal_status),
    "std_msgs/Time": (Time, lambda m: ()),
    # Detail: the number of touches of each model.
    "bullet_lab/TouchedModels": (TouchedModels, lambda m: ((), dict(zip(m.models, m.touches)))),
    # Detail: the picture, (h, w, 3) uint8, BGR.
    "sensor_msgs/Image": (Image, lambda m: ((), pixels_of(m, "bgr8"))),
    # Detail: the state of the docking.
    "bullet_lab/DockActionFeedback": (
        DockActionFeedback,
        lambda m: ((), DockingState(m.feedback.state).name.lower()),
    ),
    # Detail: x and y of each pose (m), and of each point (px).
    "nav_msgs/Path": (Path, lambda m: _places(stamped.pose.position for stamped in m.poses)),
    "bullet_lab/ImagePoints": (ImagePoints, lambda m: _places(m.points)),
    # Detail: the messages of the markers.
    "bullet_lab/MarkerDetectionArray": (MarkerDetectionArray, lambda m: ((), m.detections)),
}
