"""What displays share: subscriptions, the tree that TF spans, and the scene with its fixed frame.

Messages stay bytes; only those that are shown are deserialised.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any, Callable, Tuple

import genpy
import rospy

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.ros.node.node import Refusals

# Messages that are kept until they are read, if each of them counts.
MAX_WAITING = 2000
# More than a large image has, so that old images do not pile up in the socket.
BUFFER_BYTES = 2**24
# Frames between a frame and its root; more are a cycle.
MAX_DEPTH = 200

# A frame, and a pose in it.
Placed = Tuple[str, Pose]


class MessageError(LabError):
    """A message does not match its type, or has numbers that are not finite."""


class Subscription:
    """The messages of one topic since the last read.

    Args:
        topic: to subscribe to.
        read: makes an object from the bytes of a message, or raises LabError to refuse it.
        every: whether each message counts, not only the newest one.
        large: whether a message may be larger than rospy's default buffer.
    """

    def __init__(
        self,
        topic: str,
        read: Callable[[bytes], Any],
        every: bool = False,
        large: bool = False,
    ):
        self.topic = topic
        self._read = read
        self._waiting: deque[bytes] = deque(maxlen=MAX_WAITING if every else 1)
        self._refusals = Refusals()
        self._subscriber = rospy.Subscriber(
            topic,
            rospy.AnyMsg,
            lambda message: self._waiting.append(message._buff),
            queue_size=None if every else 1,
            # rospy allocates this much memory for each reception.
            buff_size=BUFFER_BYTES if large else rospy.topics.DEFAULT_BUFF_SIZE,
            tcp_nodelay=True,
        )

    def take(self) -> list[Any]:
        """Return the new messages as `read` makes them, in their order."""
        found = []
        while self._waiting:
            with self._refusals.on(self.topic):
                found.append(self._read(self._waiting.popleft()))
        return found

    def newest(self) -> Any:
        """Return the newest message as `read` makes it; None if there is no new one."""
        return (self.take() or [None])[-1]

    def close(self) -> None:
        """Unsubscribe."""
        self._subscriber.unregister()


def reader_of(
    message_type: type, convert: Callable[[Any], Any] | None = None
) -> Callable[[bytes], Any]:
    """Return a function from the bytes of a message to the message, or to what `convert` returns.

    The function raises MessageError if the bytes do not match the type.
    """

    def read(data: bytes) -> Any:
        try:
            message = message_type().deserialize(data)
        except genpy.DeserializationError as error:
            raise MessageError(f"the bytes do not match {message_type._type}: {error}") from error
        return message if convert is None else convert(message)

    return read


class FrameTree:
    """Frames, each with a parent and its newest pose there.

    >>> tree = FrameTree()
    >>> tree.put("base", "odom", Pose((1.0, 0.0, 0.0)))
    >>> tree.put("laser", "base", Pose((0.0, 0.0, 0.2)))
    >>> tree.pose("laser", "odom").position
    (1.0, 0.0, 0.2)
    >>> tree.pose("laser", "map") is None
    True
    """

    def __init__(self) -> None:
        self._parents: dict[str, Placed] = {}
        self._from_root: dict[str, Placed] = {}

    def put(self, frame: str, parent: str, pose: Pose) -> None:
        """Set the pose of a frame in its parent."""
        self._parents[frame] = (parent, pose)
        self._from_root.clear()

    def clear(self) -> None:
        """Remove all frames."""
        self._parents.clear()
        self._from_root.clear()

    def pose(self, frame: str, seen_from: str) -> Pose | None:
        """Return the pose of a frame in another one; None if TF does not connect them."""
        root, pose = self._in_root(frame)
        other_root, other = self._in_root(seen_from)
        if root != other_root:
            return None
        return pose if other is _IDENTITY else other.inverse() * pose

    def root(self, frame: str) -> str:
        """Return the root of a frame's tree; the frame itself if it has no parent."""
        return self._in_root(frame)[0]

    def frames(self) -> list[str]:
        """Return all frames that have a parent."""
        return list(self._parents)

    def roots(self) -> list[str]:
        """Return the roots of all trees, that of the largest tree first."""
        found = [self.root(frame) for frame in self._parents]
        return sorted(set(found), key=lambda root: (-found.count(root), root))

    def _in_root(self, frame: str) -> Placed:
        if frame not in self._from_root:
            self._from_root[frame] = self._climb(frame)
        return self._from_root[frame]

    def _climb(self, frame: str) -> Placed:
        pose = _IDENTITY
        for _ in range(MAX_DEPTH):
            if frame not in self._parents:
                break
            frame, above = self._parents[frame]
            pose = above if pose is _IDENTITY else above * pose
        return frame, pose


_IDENTITY = Pose()


@dataclass
class DisplayContext:
    """What displays share.

    Attributes:
        scene: viser's.
        frames: the TF tree.
        fixed: frame that the scene is in.
        assumed: roots of TF that are not connected with it, and that are taken to equal it.
    """

    scene: Any
    frames: FrameTree = field(default_factory=FrameTree)
    fixed: str = "world"
    assumed: set[str] = field(default_factory=set)

    def pose_of(self, frame: str) -> Pose:
        """Return the pose of a frame in the scene."""
        frame = frame.lstrip("/")
        pose = self.frames.pose(frame, self.fixed)
        if pose is None:
            root = self.frames.root(frame)
            self.assumed.add(root)
            pose = self.frames.pose(frame, root) or Pose()
        return pose
