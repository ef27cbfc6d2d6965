"""What is in the page's scene, in few messages: copies of one look, lines that grow, labels.

viser sends each property that changes as a message of its own; what moves together is therefore
one node with an array for all of it. Poses are in the scene's one frame, in m; colours RGBA or RGB
within [0, 1]. For one thread.
"""

from __future__ import annotations

from typing import Any, Callable, Dict, Hashable, List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.rendering.surfaces import surfaces_of
from bullet_lab.simulation.world.shapes import Box, Cylinder, Sphere

# Points of a piece of a line, which is sent once it is full.
PIECE = 256
LINE_PIXELS = 2.5
WHITE = (1.0, 1.0, 1.0, 1.0)
# Of one unit along each axis.
UNITS = {
    "box": Box((1.0, 1.0, 1.0)),
    "cylinder": Cylinder(0.5, 1.0),
    "sphere": Sphere(0.5),
}

Row = Tuple[Any, ...]


def rgb(colour: Sequence[float]) -> Tuple[int, int, int]:
    """Return the first three parts of a colour as viser wants them.

    >>> rgb((1.0, 0.5, 0.0, 1.0))
    (255, 128, 0)
    """
    red, green, blue = (round(255.0 * min(1.0, max(0.0, part))) for part in colour[:3])
    return red, green, blue


def wxyz(pose: Pose) -> Tuple[float, float, float, float]:
    """Return the orientation of a pose as viser wants it."""
    x, y, z, w = pose.quaternion
    return w, x, y, z


class Copies:
    """Copies of one thing, each by a key, in one node of the scene.

    Args:
        make: makes the node of the properties named, an array with a row for each copy.
        names: of the properties.
    """

    def __init__(self, make: Callable[[Dict[str, np.ndarray]], Any], names: Sequence[str]):
        self._make, self._names = make, names
        self._rows: Dict[Hashable, Row] = {}
        self._shown: Tuple[Hashable, ...] = ()
        self._changed = False
        self._node: Any = None

    def __contains__(self, key: Hashable) -> bool:
        return key in self._rows

    def put(self, key: Hashable, pose: Pose, *others: Any) -> None:
        """Put a copy where it is; `others` are the properties after position and orientation."""
        row = (pose.position, wxyz(pose), *others)
        if self._rows.get(key) != row:
            self._rows[key] = row
            self._changed = True

    def drop(self, key: Hashable) -> None:
        """Take a copy away, if it is there."""
        if self._rows.pop(key, None) is not None:
            self._changed = True

    def clear(self) -> None:
        """Take all copies away."""
        self._changed = self._changed or bool(self._rows)
        self._rows.clear()

    def flush(self) -> None:
        """Show what has changed."""
        if not self._changed:
            return
        self._changed = False
        if tuple(self._rows) == self._shown and self._node is not None:
            for name, values in self._arrays().items():
                setattr(self._node, name, values)
            return
        self._shown = tuple(self._rows)
        if self._rows:
            # Under the same name, it takes the place of the one before.
            self._node = self._make(self._arrays())
        elif self._node is not None:
            self._node.remove()
            self._node = None

    def _arrays(self) -> Dict[str, np.ndarray]:
        columns = zip(*self._rows.values())
        return {name: np.array(column) for name, column in zip(self._names, columns)}


def glb_copies(scene: Any, name: str, glb: bytes) -> Copies:
    """Return copies of what a binary glTF file shows."""

    def make(arrays: Dict[str, np.ndarray]) -> Any:
        return scene.add_batched_glb(name, glb, lod="off", **arrays)

    return Copies(make, ("batched_positions", "batched_wxyzs"))


class Solids:
    """Boxes, cylinders and balls of any size and colour."""

    def __init__(self, scene: Any, name: str):
        self._scene, self._name = scene, name
        self._copies: Dict[Tuple[str, bool], Copies] = {}

    def put(self, key: Hashable, kind: str, pose: Pose, size: Vector, colour: Row) -> None:
        """Put a solid, a word of UNITS, as large as `size` along its axes, in m."""
        see_through = colour[3] < 1.0
        for other, copies in self._copies.items():
            if other != (kind, see_through):
                copies.drop(key)
        which = (kind, see_through)
        if which not in self._copies:
            self._copies[which] = self._new(*which)
        opacity = (colour[3],) if see_through else ()
        self._copies[which].put(key, pose, size, rgb(colour), *opacity)

    def drop(self, key: Hashable) -> None:
        """Take a solid away, if it is there."""
        for copies in self._copies.values():
            copies.drop(key)

    def clear(self) -> None:
        """Take all of them away."""
        for copies in self._copies.values():
            copies.clear()

    def flush(self) -> None:
        """Show what has changed."""
        for copies in self._copies.values():
            copies.flush()

    def _new(self, kind: str, see_through: bool) -> Copies:
        corners = surfaces_of(UNITS[kind])[0].corners.reshape(-1, 3)
        faces = np.arange(len(corners)).reshape(-1, 3)
        name = f"{self._name}/{kind}{'_see_through' if see_through else ''}"

        def make(arrays: Dict[str, np.ndarray]) -> Any:
            arrays["batched_colors"] = arrays["batched_colors"].astype(np.uint8)
            return self._scene.add_batched_meshes_simple(name, corners, faces, lod="off", **arrays)

        names = ["batched_positions", "batched_wxyzs", "batched_scales", "batched_colors"]
        return Copies(make, names + ["batched_opacities"] * see_through)


class Polyline:
    """A line through points, of which what is new is sent as it grows."""

    def __init__(self, scene: Any, name: str, colour: Sequence[float]):
        self._scene, self._name, self._colour = scene, name, rgb(colour)
        self._nodes: List[Tuple[np.ndarray, Any]] = []

    def set(self, points: np.ndarray) -> None:
        """Lead the line through points, (n, 3) in m."""
        points = np.asarray(points, np.float32)
        starts = range(0, max(len(points) - 1, 0), PIECE)
        for number, start in enumerate(starts):
            self._set_piece(number, points[start : start + PIECE + 1])
        for _, node in self._nodes[len(starts) :]:
            node.remove()
        del self._nodes[len(starts) :]

    def _set_piece(self, number: int, points: np.ndarray) -> None:
        segments = np.stack((points[:-1], points[1:]), axis=1)
        if number < len(self._nodes):
            shown, node = self._nodes[number]
            if not np.array_equal(shown, points):
                node.points = segments
                self._nodes[number] = (points.copy(), node)
            return
        name = f"{self._name}/{number}"
        node = segments_node(self._scene, name, segments, self._colour)
        self._nodes.append((points.copy(), node))


def segments_node(scene: Any, name: str, segments: np.ndarray, colour: Sequence[int]) -> Any:
    """Return a node of segments (n, 2, 3) in m, of a colour within [0, 255]."""
    return scene.add_line_segments(
        name, segments, colour, thickness=LINE_PIXELS, thickness_units="screen"
    )


class Shown:
    """A node that is made when there is something to show, and taken away when there is not.

    Args:
        make: makes the node of the array.
        name: of the node's property that the array is set to afterwards.
    """

    def __init__(self, make: Callable[[np.ndarray], Any], name: str = "points"):
        self._make, self._name = make, name
        self._node: Any = None

    def set(self, values: np.ndarray) -> None:
        """Show an array, of any length."""
        if len(values) and self._node is not None:
            setattr(self._node, self._name, np.asarray(values, np.float32))
        elif len(values):
            self._node = self._make(np.asarray(values, np.float32))
        elif self._node is not None:
            self._node.remove()
            self._node = None


class Labels:
    """Texts in the scene, by keys."""

    def __init__(self, scene: Any, name: str):
        self._scene, self._name = scene, name
        self._nodes: Dict[Hashable, Tuple[str, Vector, Any]] = {}

    def put(self, key: Hashable, text: str, position: Vector) -> None:
        """Put a text at a place."""
        old_text, old_position, node = self._nodes.get(key, ("", None, None))
        if node is None:
            name = f"{self._name}/{len(self._nodes)}_{key}"
            node = self._scene.add_label(name, text, position=position, anchor="bottom-center")
        else:
            if text != old_text:
                node.text = text
            if position != old_position:
                node.position = position
        self._nodes[key] = (text, position, node)

    def drop(self, key: Hashable) -> None:
        """Take a text away, if it is there."""
        _, _, node = self._nodes.pop(key, (None, None, None))
        if node is not None:
            node.remove()

    def keep(self, keys: Sequence[Hashable]) -> None:
        """Take all texts away but these."""
        for key in set(self._nodes) - set(keys):
            self.drop(key)


def floor_point(
    origin: Sequence[float], direction: Sequence[float]
) -> Optional[Tuple[float, float]]:
    """Return where a ray meets the floor, x and y in m; None where it does not.

    >>> floor_point((0.0, 0.0, 2.0), (1.0, 0.0, -1.0))
    (2.0, 0.0)
    """
    if direction[2] >= 0.0 or origin[2] <= 0.0:
        return None
    share = -origin[2] / direction[2]
    return origin[0] + share * direction[0], origin[1] + share * direction[1]
