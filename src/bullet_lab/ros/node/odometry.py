"""Checked odometry, queues of messages, and transforms between frames."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from typing import Any, Callable, Generic, TypeVar

import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry

from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import PlanarPose, pose_from_above
from bullet_lab.errors import LabError
from bullet_lab.ros.messages.poses import InputError, pose_of, twist_of
from bullet_lab.ros.node.lock_step import in_lock_step, subscriber
from bullet_lab.ros.node.node import NodeError, Refusals, check_running, tf_prefix

# m; larger than all coordinates on Earth in any grid. Squares of smaller numbers stay finite.
FARTHEST = 1e8
# Seconds of ROS time after which odometry is out of date.
STALE_SECONDS = 0.5
# Wall seconds to wait for odometry.
ODOMETRY_TIMEOUT = 5.0
# Messages in a MessageQueue.
MOST_WAITING = 1000
# Wall seconds that lock step waits for a message that is due.
LATEST = 10.0
# Wall seconds between two checks for a shutdown.
SHUTDOWN_CHECK_SECONDS = 0.2
_MILLISECOND = 1_000_000
# Wall seconds to wait for a missing transform.
PATIENCE = 2.0
# Likewise for the thread that drives, in lock step: simulated time does not advance meanwhile.
LOCK_STEP_PATIENCE = 5.0
# Wall seconds between two attempts.
POLL_SECONDS = 0.02

T = TypeVar("T")


class OdometryError(LabError):
    """There is no odometry yet, or a message has other frames or an earlier stamp than expected."""


def planar_pose(message: Odometry) -> PlanarPose:
    """Return x (m), y (m) and yaw (rad) of an odometry message.

    Raises:
        InputError: farther than `FARTHEST` from the origin, and as of `pose_of`.
    """
    position, turn = message.pose.pose.position, message.pose.pose.orientation
    pose_of(position, turn)
    if max(abs(position.x), abs(position.y)) > FARTHEST:
        place = f"({position.x:.3g}, {position.y:.3g}) m"
        raise InputError(f"position {place} exceeds {FARTHEST:.0e} m")
    return pose_from_above(position, turn)


def check_twist(message: Odometry) -> None:
    """Raise InputError if the twist or a covariance of odometry is not finite."""
    twist_of(message.twist.twist)
    if not all(map(math.isfinite, (*message.pose.covariance, *message.twist.covariance))):
        raise InputError("a covariance that is not finite")


class FrameGuard:
    """Reads the poses of odometry messages that have the frames of the first one."""

    def __init__(self):
        self._frames: tuple[str, str] | None = None

    def check(self, message: Odometry) -> PlanarPose:
        """Return the pose of a message as `planar_pose` does.

        Raises OdometryError also if its frames differ from those of the first message.
        """
        pose = planar_pose(message)
        frames = (message.header.frame_id, message.child_frame_id)
        if self._frames is None:
            self._frames = frames
        if frames != self._frames:
            raise OdometryError(
                "frames {} -> {} where {} -> {} came before".format(*frames, *self._frames)
            )
        return pose


def _wait_for(new: threading.Condition, holds: Callable[[], bool], seconds: float) -> bool:
    """Wait in wall time until something holds; return False if it does not within `seconds`.

    `new` is notified when it may hold. Raises ROSInterruptException at a shutdown.
    """
    deadline = time.monotonic() + seconds
    while not holds():
        check_running()
        if time.monotonic() >= deadline:
            return False
        new.wait(SHUTDOWN_CHECK_SECONDS)
    return True


class NewestOdometry:
    """The newest valid pose on an odometry topic.

    Args:
        topic: of the odometry.
        late: whether messages come when time leaves the step of their stamp, as those of the
            controllers of ros_control.
    """

    def __init__(self, topic: str, late: bool = False):
        self._topic, self._late = topic, late
        self._new = threading.Condition()
        self._pose: PlanarPose | None = None
        self._stamp = rospy.Time(0)
        self._period: rospy.Duration | None = None
        self._received = rospy.Time(0)
        self._subscriber = subscriber(topic, Odometry, self.take)

    def newest(self, now: rospy.Time, patience: float = ODOMETRY_TIMEOUT) -> PlanarPose:
        """Return the newest pose (m, m, rad), not older than `STALE_SECONDS`.

        In lock step, wait for all messages up to `now`. Raises NodeError if none comes for
        `patience` wall seconds.
        """
        with self._new:
            if not _wait_for(self._new, lambda: self._is_new(now), patience):
                raise NodeError(f"no odometry on {self._topic} for {patience:g} s")
            return self._pose

    def is_stale(self) -> bool:
        """Return whether the newest pose is out of date; in lock step it never is."""
        if in_lock_step():
            return False
        return rospy.Time.now() - self._received > rospy.Duration(STALE_SECONDS)

    def _is_new(self, now: rospy.Time) -> bool:
        if self._pose is None:
            return False
        if not in_lock_step():
            return not self.is_stale()
        if self._period is None:
            return True
        due = self._stamp + self._period
        return due >= now if self._late else due > now

    def take(self, message: Odometry) -> None:
        """Store the pose of a message; raises InputError if it is invalid."""
        pose = planar_pose(message)
        with self._new:
            if self._pose is not None and message.header.stamp > self._stamp:
                self._period = message.header.stamp - self._stamp
            self._pose, self._stamp = pose, message.header.stamp
            self._received = rospy.Time.now()
            self._new.notify_all()


class MessageQueue(Generic[T]):
    """The messages of one topic, in the order of their stamps.

    In lock step it is always open, and waits for the messages that are due.

    `read` converts a message, which has a header, or raises LabError to refuse it; `rate` are the
    messages of the bridge per simulated second.

    Attributes:
        trouble: the error of the last message; empty if it was not refused.
    """

    def __init__(self, topic: str, kind: type, read: Callable[[Any], T], rate: float):
        self.topic, self.trouble = topic, ""
        self._kind, self._read, self._rate = kind, read, rate
        self._new = threading.Condition()
        self._waiting: deque[tuple[int, T]] = deque(maxlen=MOST_WAITING)
        # ns
        self._newest = 0
        self._patience = LATEST
        self._refusals = Refusals()
        self._subscriber: rospy.Subscriber | None = None
        if in_lock_step():
            self.open()

    def open(self) -> bool:
        """Subscribe; return whether the queue was closed before."""
        if self._subscriber is not None:
            return False
        self.clear()
        self._subscriber = subscriber(self.topic, self._kind, self._receive)
        return True

    def close(self) -> None:
        """Unsubscribe."""
        if self._subscriber is not None and not in_lock_step():
            self._subscriber.unregister()
            self._subscriber = None

    def clear(self) -> None:
        """Remove all messages."""
        with self._new:
            self.trouble = ""
            self._waiting.clear()
            self._newest = 0
            self._patience = LATEST

    def is_connected(self) -> bool:
        """Return whether the topic has a publisher."""
        return self._subscriber is not None and self._subscriber.get_num_connections() > 0

    def take(self, now: rospy.Time) -> list[T]:
        """Remove and return the messages with stamps up to now."""
        taken = []
        with self._new:
            while self._waiting and self._waiting[0][0] <= now.to_nsec():
                taken.append(self._waiting.popleft()[1])
        return taken

    def wait(self, now: rospy.Time) -> None:
        """In lock step, wait in wall time for the messages that are due by now.

        After `LATEST` seconds without a message it does not wait until the next one arrives.
        """
        if not in_lock_step():
            return
        with self._new:
            if not _wait_for(self._new, lambda: self._next_due() > now.to_nsec(), self._patience):
                self._patience = 0.0

    def _next_due(self) -> int:
        """Return the stamp in ns of the message after the newest: the first step at k / rate."""
        number = math.floor(self._newest * self._rate * 1e-9 + 1e-6) + 1
        return math.ceil(1000.0 * number / self._rate - 1e-6) * _MILLISECOND

    def _receive(self, message: Any) -> None:
        stamp = message.header.stamp.to_nsec()
        with self._new:
            try:
                if stamp < self._newest:
                    raise InputError(f"out-of-order stamp {1e-9 * stamp:.9f} s")
                self._waiting.append((stamp, self._read(message)))
                self.trouble = ""
            except LabError as error:
                self.trouble = str(error)
                self._refusals.refuse(self.topic, self.trouble)
            self._newest = max(stamp, self._newest)
            self._patience = LATEST
            self._new.notify_all()


def framed(read: Callable[[Any], T]) -> Callable[[Any], tuple[str, T]]:
    """Return a function that reads the frame of a message, without its slash, and the content.

    It raises OdometryError if the message has no frame.
    """

    def read_framed(message: Any) -> tuple[str, T]:
        frame = message.header.frame_id.lstrip("/")
        if not frame:
            raise OdometryError("no frame_id")
        return frame, read(message)

    return read_framed


class FrameError(LabError):
    """There is no transform between two frames."""


class FrameFinder:
    """Transforms poses from one frame to another by the newest transforms of TF.

    With `wait`, it waits for a missing transform. The thread that drives uses `wait=False`, which
    waits only in lock step, where simulated time stands still meanwhile.
    """

    def __init__(self):
        # Imported late: the first job, squares, runs before tf2 is installed.
        from bullet_lab.ros.node.tf_buffer import CarefulBuffer

        self._buffer = CarefulBuffer()

    def clear(self) -> None:
        """Remove all transforms after a reset of time."""
        self._buffer.clear()

    def bring(self, pose: Pose, source: str, target: str, wait: bool = True) -> Pose:
        """Return a pose in another frame; leading slashes of frame names are ignored.

        Raises:
            FrameError: no transform between the two.
            InputError: an invalid frame name.
        """
        source, target = source.lstrip("/"), target.lstrip("/")
        if not source:
            raise InputError("it has no frame_id")
        if source == target:
            return pose
        return self.pose_in(target, source, wait) * pose

    def planar(self, message: PoseStamped, target: str, wait: bool = True) -> PlanarPose:
        """Return a message's pose in another frame as x (m), y (m) and yaw (rad).

        Raises InputError for an invalid pose, and the errors of `bring`.
        """
        pose = pose_of(message.pose.position, message.pose.orientation)
        return self.bring(pose, message.header.frame_id, target, wait).planar

    def pose_in(self, target: str, source: str, wait: bool = True) -> Pose:
        """Return the pose of the frame `source` in the frame `target`; errors as of `bring`."""
        if "\0" in source + target:
            raise InputError("a frame's name has a NUL")
        patience = PATIENCE if wait else LOCK_STEP_PATIENCE if in_lock_step() else 0.0
        deadline = time.monotonic() + patience
        while True:
            try:
                found = self._buffer.newest(target, source)
                return pose_of(found.translation, found.rotation)
            except LookupError as error:
                if time.monotonic() >= deadline or rospy.is_shutdown():
                    line = f"no transform from '{source}' to '{target}': {error}"
                    raise FrameError(line) from None
            time.sleep(POLL_SECONDS)


def own_frame(frame: str) -> str:
    """Return a frame name with this node's tf_prefix.

    As in the tf library, a name with a leading slash has no prefix. A name that has the prefix
    already is returned unchanged.
    """
    prefix = tf_prefix(rospy.get_name())
    if not frame or frame.startswith(("/", prefix)):
        return frame.lstrip("/")
    return prefix + frame
