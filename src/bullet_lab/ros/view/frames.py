"""Frames: the tree that TF spans, the scene's fixed frame, and the axes and names of all frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any, Tuple
from urllib.parse import quote

from geometry_msgs.msg import Pose as PoseMessage
from tf2_msgs.msg import TFMessage

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.poses import normalised_pose
from bullet_lab.ros.view.scene import Copies, Nodes
from bullet_lab.ros.view.subscription import Subscription, reader_of

# Frames between a frame and its root; more are a cycle.
MAX_DEPTH = 200
# Sizes in m of the axes of a frame.
AXES = {"axes_length": 0.2, "axes_radius": 0.006}

Placed = Tuple[str, Pose]
"""A frame, and a pose in it."""


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


def read_transforms(message: TFMessage) -> list[tuple[str, str, Pose]]:
    """Return frame, parent, and pose of each transform; raises InputError if one is not finite."""
    found = []
    for one in message.transforms:
        pose = normalised_pose(PoseMessage(one.transform.translation, one.transform.rotation))
        frame, parent = one.child_frame_id, one.header.frame_id
        found.append((frame.lstrip("/"), parent.lstrip("/"), pose))
    return found


class FramesDisplay:
    """Reads TF into the context's tree, and shows the axes and names of all frames."""

    def __init__(self, context: DisplayContext):
        self._context = context
        read = reader_of(TFMessage, read_transforms)
        self._subscriptions = [Subscription(t, read, every=True) for t in ("/tf_static", "/tf")]
        self._axes = Copies(partial(context.scene.add_batched_axes, "/frames/axes", **AXES))
        self._names = Nodes(context.scene)

    def read(self) -> None:
        """Read the new transforms."""
        for subscription in self._subscriptions:
            for transforms in subscription.take():
                for frame, parent, pose in transforms:
                    self._context.frames.put(frame, parent, pose)

    def show(self, axes: bool, names: bool) -> None:
        """Show or hide the axes and the names of all frames."""
        if not axes:
            self._axes.clear()
        if not names:
            self._names.clear()
        for frame in self._context.frames.frames() if axes or names else ():
            pose = self._context.pose_of(frame)
            if axes:
                self._axes.put(frame, pose)
            if names:
                # Nodes below a node would move with it.
                name = f"/frames/names/{quote(frame, safe='')}"
                self._names.put_label(name, frame, pose.position)
        self._axes.flush()

    def close(self) -> None:
        """Unsubscribe, and show nothing."""
        for subscription in self._subscriptions:
            subscription.close()
        self.show(axes=False, names=False)
        self._context.frames.clear()
