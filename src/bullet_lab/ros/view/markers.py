"""Markers of visualization_msgs in the scene, among them the shapes of the world."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Callable, Sequence, Tuple

import numpy as np
from numpy import ndarray
from visualization_msgs.msg import Marker as MarkerMessage
from visualization_msgs.msg import MarkerArray

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.errors import LabError
from bullet_lab.ros.messages.conversions import look_of
from bullet_lab.ros.messages.gazebo_types import msg
from bullet_lab.ros.messages.poses import normalised_pose, vector_of
from bullet_lab.ros.nodes.show_sensors import contact_markers
from bullet_lab.ros.view.context import DisplayContext, reader_of
from bullet_lab.ros.view.displays import NO_POINTS, Display, finite, placed
from bullet_lab.ros.view.scene import SOLIDS, Solids, VisualCopies, rgb
from bullet_lab.simulation.world.description import WHITE, Colour, Mesh, Visual
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.shapes import Plane
from bullet_lab.simulation.world.xml import ReportOnce

LISTS = {MarkerMessage.CUBE_LIST: "box", MarkerMessage.SPHERE_LIST: "sphere"}
SHAPES = {
    MarkerMessage.CUBE: "box",
    MarkerMessage.SPHERE: "sphere",
    MarkerMessage.CYLINDER: "cylinder",
    **LISTS,
}
# Defaults of an arrow's head: length per length of the arrow, width per width of the shaft.
HEAD_LENGTH = 0.25
HEAD_WIDTH = 2.0
# m of an arrow for each N of a contact.
CONTACT_SCALE = 0.02
# Points are drawn at least this large, in m.
MIN_POINT_SIZE = 0.01

# Namespace and id.
Key = Tuple[str, int]


@dataclass(frozen=True)
class Marker:
    """A marker whose numbers are finite.

    Attributes:
        message: that it is from.
        frame: without a slash before it.
        points: shape (n, 3), m.
        colours: of the points, shape (n, 4), or the marker's own for all, (1, 4).
    """

    message: MarkerMessage
    frame: str
    key: Key
    pose: Pose
    scale: Vector
    colour: Colour
    points: ndarray
    colours: ndarray


def read_marker(message: MarkerMessage) -> Marker:
    """Return a marker from its message; raises LabError if a number is not finite."""
    colours = _rows([(one.r, one.g, one.b, one.a) for one in (message.color, *message.colors)], 4)
    points = _rows([(point.x, point.y, point.z) for point in message.points], 3)
    return Marker(
        message=message,
        frame=message.header.frame_id.lstrip("/"),
        key=(message.ns, message.id),
        pose=normalised_pose(message.pose),
        scale=vector_of(message.scale, "the scale"),
        colour=tuple(colours[0].tolist()),
        points=points,
        colours=colours[1:] if len(colours) == len(points) + 1 else colours[:1],
    )


def _rows(values: Sequence[tuple[float, ...]], columns: int) -> ndarray:
    return finite(np.array(values, float).reshape(-1, columns), "the marker")


def read_markers(message: MarkerArray) -> list[Marker]:
    """Return the markers of an array; raises LabError if a number is not finite."""
    return [read_marker(one) for one in message.markers]


class MarkersDisplay(Display):
    """Shows all markers of one topic, as visualization_msgs defines it."""

    # As in RViz, markers stay until they are deleted.
    stays = True
    every = True
    read = staticmethod(reader_of(MarkerArray, read_markers))

    def __init__(self, context: DisplayContext, topic: str):
        super().__init__(context, topic)
        self._markers: dict[Key, Marker] = {}
        self._frame_poses: dict[Key, Pose] = {}
        self._report = ReportOnce()
        self._solids = Solids(context.scene, f"{self.name}/solids")
        self._meshes = VisualCopies(context.scene, f"{self.name}/meshes", self._report)
        # Number of the solids of each marker that has any.
        self._numbers: dict[Key, int] = {}

    def tick(self) -> None:
        """Show new markers, and those that have moved with their frames."""
        touched: set[Key] = set()
        for markers in self._subscription.take():
            for marker in markers:
                self._take(marker)
                touched.add(marker.key)
        for key, marker in self._markers.items():
            moves = marker.message.frame_locked and marker.frame != self.context.fixed
            if key in touched or moves:
                self._show(key, marker)
        self._flush()

    def close(self) -> None:
        """Unsubscribe, and show nothing."""
        super().close()
        self._drop_all()
        self._flush()

    def is_hidden(self, marker: Marker) -> bool:
        """Return whether a marker is not shown."""
        return False

    def is_textured(self, marker: Marker) -> bool:
        """Return whether a solid has more than its colour."""
        return False

    def frames(self) -> set[str]:
        """Return the frames of the markers."""
        return {marker.frame for marker in self._markers.values()}

    def _take(self, marker: Marker) -> None:
        key, message = marker.key, marker.message
        if message.action == MarkerMessage.DELETEALL:
            self._drop_all()
        elif message.action == MarkerMessage.DELETE:
            self._drop(key)
        else:
            if key in self._markers and self._markers[key].message.type != message.type:
                self._drop(key)
            self._markers[key] = marker
            self._frame_poses.pop(key, None)

    def _drop(self, key: Key) -> None:
        self._markers.pop(key, None)
        self._frame_poses.pop(key, None)
        self._hide(key)

    def _drop_all(self) -> None:
        for shown in (self._markers, self._frame_poses, self._numbers):
            shown.clear()
        for shown in (self._solids, self._meshes, self.nodes):
            shown.clear()

    def _flush(self) -> None:
        self._solids.flush()
        self._meshes.flush()

    def _hide(self, key: Key) -> None:
        self._put_solids(key, ())
        self._meshes.drop(key)
        self.nodes.drop(self._node(key))

    def _node(self, key: Key) -> str:
        namespace, number = key
        # Removed nodes take along all below them: 'a/3' is no node below marker 3 of 'a'.
        return f"{self.name}/{namespace or '_'}/#{number}"

    def _show(self, key: Key, marker: Marker) -> None:
        if self.is_hidden(marker):
            self._hide(key)
            return
        message = marker.message
        if message.frame_locked or key not in self._frame_poses:
            self._frame_poses[key] = self.context.pose_of(marker.frame)
        pose = self._frame_poses[key] * marker.pose
        try:
            if message.type == MarkerMessage.MESH_RESOURCE or self.is_textured(marker):
                self._put_solids(key, ())
                look = (message.text, message.mesh_resource, message.mesh_use_embedded_materials)
                visual = _visual(message.type, marker.scale, marker.colour, *look)
                self._meshes.put((visual,), key, pose)
            elif message.type in SHAPES:
                self._meshes.drop(key)
                solids: list[tuple[Pose, Sequence[float]]] = [(pose, marker.colour)]
                if message.type in LISTS:
                    places = [pose * Pose(tuple(point)) for point in marker.points.tolist()]
                    colours = np.broadcast_to(marker.colours, (len(places), 4))
                    solids = list(zip(places, colours.tolist()))
                self._put_solids(key, solids)
            elif message.type in SHOW:
                SHOW[message.type](self, self._node(key), marker, pose)
        except LabError as error:
            self._report(f"{key[0]}: {error}")

    def _put_solids(self, key: Key, solids: Sequence[tuple[Pose, Sequence[float]]]) -> None:
        """Show solids of a marker, each with its pose and colour, in place of those before."""
        for number, (place, colour) in enumerate(solids):
            kind, scale = SHAPES[self._markers[key].message.type], self._markers[key].scale
            self._solids.put_solid((*key, number), kind, place, scale, colour)
        for number in range(len(solids), self._numbers.pop(key, 0)):
            self._solids.drop((*key, number))
        if solids:
            self._numbers[key] = len(solids)

    def _show_label(self, node: str, marker: Marker, pose: Pose) -> None:
        self.nodes.put_label(node, marker.message.text, pose.position)

    def _show_strip(self, node: str, marker: Marker, pose: Pose) -> None:
        self.nodes.put_line(node, placed(pose, marker.points), rgb(marker.colour))

    def _show_segments(self, node: str, marker: Marker, pose: Pose) -> None:
        ends = placed(pose, _whole(marker.points, 2)).reshape(-1, 2, 3)
        self.nodes.put_segments(node, ends, rgb(marker.colour))

    def _show_points(self, node: str, marker: Marker, pose: Pose) -> None:
        colours = np.round(255.0 * np.clip(marker.colours[:, :3], 0.0, 1.0)).astype(np.uint8)
        colours = colours[0] if len(colours) == 1 else colours
        look = {"point_size": max(marker.scale[0], MIN_POINT_SIZE)}
        self.nodes.put_points(node, look, points=placed(pose, marker.points), colors=colours)

    def _show_arrow(self, node: str, marker: Marker, pose: Pose) -> None:
        if len(marker.points) >= 2:
            ends = marker.points[:2]
            shaft, head, length = marker.scale
        else:
            ends = np.array(((0.0, 0.0, 0.0), (marker.scale[0], 0.0, 0.0)))
            shaft = marker.scale[1]
            head, length = HEAD_WIDTH * shaft, 0.0
        ends = placed(pose, ends)
        reach = float(np.linalg.norm(ends[1] - ends[0]))
        look = {
            "colors": rgb(marker.colour),
            "shaft_radius": 0.5 * shaft,
            "head_radius": 0.5 * head,
            "head_length": length or HEAD_LENGTH * reach,
        }
        points = ends[None] if reach > 0.0 else NO_POINTS
        self.nodes.put(node, self.context.scene.add_arrows, look, points=points)

    def _show_triangles(self, node: str, marker: Marker, pose: Pose) -> None:
        corners = placed(pose, _whole(marker.points, 3) * marker.scale)
        faces = np.arange(len(corners)).reshape(-1, 3)
        look = {"color": rgb(marker.colour), "side": "double", "flat_shading": True}
        make = self.context.scene.add_mesh_simple
        self.nodes.put(node, make, look, vertices=corners, faces=faces)


def _whole(points: ndarray, size: int) -> ndarray:
    """Return points less those at the end that make no whole group of a size."""
    return points[: len(points) // size * size]


@functools.lru_cache(maxsize=1024)
def _visual(
    kind: int, scale: Vector, colour: Colour, text: str, mesh: str, embedded: bool
) -> Visual:
    """Return the appearance of a solid or a mesh; raises ResourceError."""
    look = look_of(text)
    if kind == MarkerMessage.MESH_RESOURCE:
        path = ResourceFinder.anywhere().find(mesh)
        material = replace(look.material, covers=not embedded)
        colour = colour if colour[3] > 0.0 else WHITE
        return Visual(Mesh(Path(path), mesh, scale), colour=colour, material=material)
    shape = Plane(size=scale[:2]) if look.is_plane else SOLIDS[SHAPES[kind]](scale)
    return Visual(shape, colour=colour, material=look.material)


# How each other kind is shown.
SHOW: dict[int, Callable[[MarkersDisplay, str, Marker, Pose], None]] = {
    MarkerMessage.ARROW: MarkersDisplay._show_arrow,
    MarkerMessage.LINE_STRIP: MarkersDisplay._show_strip,
    MarkerMessage.LINE_LIST: MarkersDisplay._show_segments,
    MarkerMessage.POINTS: MarkersDisplay._show_points,
    MarkerMessage.TEXT_VIEW_FACING: MarkersDisplay._show_label,
    MarkerMessage.TRIANGLE_LIST: MarkersDisplay._show_triangles,
}


class WorldDisplay(MarkersDisplay):
    """Shows the shapes of the world, except models that are shown as robots."""

    stays = False

    def __init__(self, context: DisplayContext, topic: str):
        super().__init__(context, topic)
        self._robots: frozenset[str] = frozenset()

    def is_hidden(self, marker: Marker) -> bool:  # noqa: D102 - inherited
        return marker.key[0] in self._robots

    def is_textured(self, marker: Marker) -> bool:  # noqa: D102 - inherited
        return marker.message.type in SHAPES and bool(marker.message.text)

    def leave_out(self, robots: frozenset[str]) -> None:
        """Show all models but these."""
        changed = robots ^ self._robots
        self._robots = robots
        for key, marker in self._markers.items():
            if key[0] in changed:
                self._show(key, marker)

    def models(self) -> set[str]:
        """Return the names of all models, with those that are left out."""
        return {model for model, _ in self._markers}


class MarkerDisplay(MarkersDisplay):
    """Shows the markers of a topic of single ones."""

    read = staticmethod(reader_of(MarkerMessage, lambda message: [read_marker(message)]))


def read_contacts(message: Any) -> list[Marker]:
    """Return the markers of a bumper's contacts: points, normals and forces."""
    return [read_marker(one) for one in contact_markers(message, CONTACT_SCALE)]


class ContactsDisplay(MarkersDisplay):
    """Shows the contacts of a bumper."""

    stays = False
    read = staticmethod(reader_of(msg.ContactsState, read_contacts))
