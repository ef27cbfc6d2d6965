"""Where frames are seen from each other, by the newest word on each: the tree that TF spans."""

from __future__ import annotations

from typing import Dict, Iterator, List, Optional, Tuple

from bullet_lab.core.pose import Pose

# Frames on the way to the root; more are a circle.
DEEPEST = 200


class FrameTree:
    """Frames, each with a parent and its pose there.

    >>> tree = FrameTree()
    >>> tree.put("base", "odom", Pose((1.0, 0.0, 0.0)))
    >>> tree.put("laser", "base", Pose((0.0, 0.0, 0.2)))
    >>> tree.pose("laser", "odom").position
    (1.0, 0.0, 0.2)
    >>> tree.pose("laser", "map") is None
    True
    """

    def __init__(self) -> None:
        self._parents: Dict[str, Tuple[str, Pose]] = {}
        self._from_root: Dict[str, Tuple[str, Pose]] = {}

    def put(self, frame: str, parent: str, pose: Pose) -> None:
        """Note where a frame is in its parent."""
        self._parents[frame] = (parent, pose)
        self._from_root.clear()

    def clear(self) -> None:
        """Forget all frames."""
        self._parents.clear()
        self._from_root.clear()

    def pose(self, frame: str, seen_from: str) -> Optional[Pose]:
        """Return the pose of a frame in another one; None where nothing connects them."""
        root, pose = self._in_root(frame)
        other_root, other = self._in_root(seen_from)
        if root != other_root:
            return None
        return pose if other is _HERE else other.inverse() * pose

    def root(self, frame: str) -> str:
        """Return the frame at the root of the one given; itself, where it has no parent."""
        return self._in_root(frame)[0]

    def frames(self) -> List[str]:
        """Return all frames that have a parent."""
        return list(self._parents)

    def roots(self) -> List[str]:
        """Return the roots of all trees, the one with most frames first."""
        found = [self.root(frame) for frame in self._parents]
        return sorted(set(found), key=lambda root: (-found.count(root), root))

    def _in_root(self, frame: str) -> Tuple[str, Pose]:
        known = self._from_root.get(frame)
        if known is None:
            known = self._from_root[frame] = self._climb(frame)
        return known

    def _climb(self, frame: str) -> Tuple[str, Pose]:
        root, pose = frame, _HERE
        for parent, above in self._above(frame):
            root, pose = parent, above if pose is _HERE else above * pose
        return root, pose

    def _above(self, frame: str) -> Iterator[Tuple[str, Pose]]:
        for _ in range(DEEPEST):
            if frame not in self._parents:
                return
            yield self._parents[frame]
            frame = self._parents[frame][0]


_HERE = Pose()
