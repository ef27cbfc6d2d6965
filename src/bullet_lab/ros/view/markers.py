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
from bullet_lab.ros.view.displays import Display, finite, placed
from bullet_lab.ros.view.frames import DisplayContext
from bullet_lab.ros.view.scene import Labels, Polyline, Solids, VisualCopies, rgb
from bullet_lab.ros.view.subscription import reader_of
from bullet_lab.simulation.world.description import WHITE, Colour, Geometry, Mesh, Visual
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.shapes import Box, Cylinder, Plane, Sphere
from bullet_lab.simulation.world.xml import ReportOnce

SOLIDS = {
    MarkerMessage.CUBE: "box",
    MarkerMessage.SPHERE: "sphere",
    MarkerMessage.CYLINDER: "cylinder",
}
LISTS = {MarkerMessage.CUBE_LIST: "box", MarkerMessage.SPHERE_LIST: "sphere"}
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
    """A marker as visualization_msgs has it.

    Attributes:
        points: shape (n, 3), m.
        colours: of the points, shape (n, 4).
        embedded: whether a mesh keeps its own materials.
        locked: whether it moves with its frame; otherwise it stays where it was received.
    """

    frame: str
    key: Key
    kind: int
    action: int
    pose: Pose
    scale: Vector
    colour: Colour
    points: ndarray
    colours: ndarray
    text: str
    mesh: str
    embedded: bool
    locked: bool


def read_marker(message: MarkerMessage) -> Marker:
    """Return a marker from its message; raises LabError if a number is not finite."""
    colours = [(one.r, one.g, one.b, one.a) for one in (message.color, *message.colors)]
    colours = _rows(colours, 4)
    return Marker(
        frame=message.header.frame_id.lstrip("/"),
        key=(message.ns, message.id),
        kind=message.type,
        action=message.action,
        pose=normalised_pose(message.pose),
        scale=vector_of(message.scale, "the scale"),
        colour=tuple(colours[0].tolist()),
        points=_rows([(point.x, point.y, point.z) for point in message.points], 3),
        colours=colours[1:],
        text=message.text,
        mesh=message.mesh_resource,
        embedded=message.mesh_use_embedded_materials,
        locked=bool(message.frame_locked),
    )


def _rows(values: Sequence[tuple[float, ...]], columns: int) -> ndarray:
    return finite(np.array(values, float).reshape(-1, columns), "the marker")


def read_markers(message: MarkerArray) -> list[Marker]:
    """Return the markers of an array; raises LabError if a number is not finite."""
    return [read_marker(one) for one in message.markers]


class MarkersDisplay(Display):
    """Shows all markers of one topic, as visualization_msgs defines it.

    Args:
        context: what displays share.
        topic: to subscribe to.
        read: makes markers from the bytes of a message.
    """

    # As in RViz, markers stay until they are deleted.
    stays = True

    def __init__(
        self,
        context: DisplayContext,
        topic: str,
        read: Callable[[bytes], list[Marker]] = reader_of(MarkerArray, read_markers),
    ):
        super().__init__(context, topic, read, every=True)
        self._markers: dict[Key, Marker] = {}
        self._frame_poses: dict[Key, Pose] = {}
        self._report = ReportOnce()
        self._solids = Solids(context.scene, f"{self.node}/solids")
        self._meshes = VisualCopies(context.scene, f"{self.node}/meshes", self._report)
        self._labels = Labels(context.scene, f"{self.node}/labels")
        self._nodes: dict[Key, Any] = {}
        # Number of the solids of each marker that is a list of them.
        self._listed: dict[Key, int] = {}

    def tick(self) -> None:
        """Show new markers, and those that have moved with their frames."""
        touched: set[Key] = set()
        for markers in self._subscription.take():
            for marker in markers:
                self._take(marker)
                touched.add(marker.key)
        for key, marker in self._markers.items():
            if key in touched or (marker.locked and marker.frame != self.context.fixed):
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
        key = marker.key
        if marker.action == MarkerMessage.DELETEALL:
            self._drop_all()
        elif marker.action == MarkerMessage.DELETE:
            self._drop(key)
        else:
            if key in self._markers and self._markers[key].kind != marker.kind:
                self._drop(key)
            self._markers[key] = marker
            self._frame_poses.pop(key, None)

    def _drop(self, key: Key) -> None:
        self._markers.pop(key, None)
        self._frame_poses.pop(key, None)
        self._hide(key)

    def _drop_all(self) -> None:
        for key in list(self._markers):
            self._drop(key)

    def _flush(self) -> None:
        self._solids.flush()
        self._meshes.flush()

    def _hide(self, key: Key) -> None:
        self._solids.drop(key)
        for number in range(self._listed.pop(key, 0)):
            self._solids.drop((*key, number))
        self._labels.drop(key)
        self._meshes.drop(key)
        if key in self._nodes:
            self._nodes.pop(key).remove()

    def _show(self, key: Key, marker: Marker) -> None:
        if self.is_hidden(marker):
            self._hide(key)
            return
        if marker.locked or key not in self._frame_poses:
            self._frame_poses[key] = self.context.pose_of(marker.frame)
        pose = self._frame_poses[key] * marker.pose
        try:
            if marker.kind in SOLIDS and not self.is_textured(marker):
                self._meshes.drop(key)
                self._solids.put_solid(key, SOLIDS[marker.kind], pose, marker.scale, marker.colour)
            elif marker.kind in SOLIDS or marker.kind == MarkerMessage.MESH_RESOURCE:
                self._solids.drop(key)
                look = (marker.scale, marker.colour, marker.text, marker.mesh, marker.embedded)
                self._meshes.put((_visual(marker.kind, *look),), key, pose)
            elif marker.kind in SHOW:
                SHOW[marker.kind](self, key, marker, pose)
        except LabError as error:
            self._report(f"{key[0]}: {error}")

    def _show_list(self, key: Key, marker: Marker, pose: Pose) -> None:
        self._hide(key)
        self._listed[key] = len(marker.points)
        has_colours = len(marker.colours) == len(marker.points)
        for number, point in enumerate(marker.points.tolist()):
            colour = tuple(marker.colours[number].tolist()) if has_colours else marker.colour
            place = pose * Pose(tuple(point))
            kind = LISTS[marker.kind]
            self._solids.put_solid((*key, number), kind, place, marker.scale, colour)

    def _show_label(self, key: Key, marker: Marker, pose: Pose) -> None:
        self._labels.put(key, marker.text, pose.position)

    def _show_strip(self, key: Key, marker: Marker, pose: Pose) -> None:
        if key not in self._nodes:
            self._nodes[key] = Polyline(self.context.scene, self._name(key), marker.colour)
        self._nodes[key].set(placed(pose, marker.points))

    def _show_segments(self, key: Key, marker: Marker, pose: Pose) -> None:
        ends = placed(pose, _whole(marker.points, 2)).reshape(-1, 2, 3)
        make = self.context.scene.add_line_segments
        self._replace(key, make, ends, rgb(marker.colour), thickness_units="screen")

    def _show_points(self, key: Key, marker: Marker, pose: Pose) -> None:
        points = placed(pose, marker.points)
        colours = np.array(rgb(marker.colour))
        if len(marker.colours) == len(points):
            colours = np.round(255.0 * np.clip(marker.colours[:, :3], 0.0, 1.0)).astype(np.uint8)
        size = max(marker.scale[0], MIN_POINT_SIZE)
        make = self.context.scene.add_point_cloud
        self._replace(key, make, points, colours, point_size=size, precision="float32")

    def _show_arrow(self, key: Key, marker: Marker, pose: Pose) -> None:
        if len(marker.points) >= 2:
            ends = marker.points[:2]
            shaft, head, length = marker.scale
        else:
            ends = np.array(((0.0, 0.0, 0.0), (marker.scale[0], 0.0, 0.0)))
            shaft = marker.scale[1]
            head, length = HEAD_WIDTH * shaft, 0.0
        ends = placed(pose, ends)
        reach = float(np.linalg.norm(ends[1] - ends[0]))
        self._replace(
            key,
            self.context.scene.add_arrows,
            ends[None] if reach > 0.0 else (),
            rgb(marker.colour),
            shaft_radius=0.5 * shaft,
            head_radius=0.5 * head,
            head_length=length or HEAD_LENGTH * reach,
        )

    def _show_triangles(self, key: Key, marker: Marker, pose: Pose) -> None:
        corners = placed(pose, _whole(marker.points, 3) * marker.scale)
        faces = np.arange(len(corners)).reshape(-1, 3)
        make = self.context.scene.add_mesh_simple
        colour = rgb(marker.colour)
        self._replace(key, make, corners, faces, color=colour, side="double", flat_shading=True)

    def _replace(
        self, key: Key, make: Callable[..., Any], points: Sequence, *others: Any, **options: Any
    ) -> None:
        """Make the node of a marker anew, or remove it if there are no points."""
        if len(points):
            self._nodes[key] = make(self._name(key), points, *others, **options)
        elif key in self._nodes:
            self._nodes.pop(key).remove()

    def _name(self, key: Key) -> str:
        namespace, number = key
        return f"{self.node}/{namespace or '_'}/{number}"


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
    shape = Plane(size=scale[:2]) if look.is_plane else SHAPES[kind](scale)
    return Visual(shape, colour=colour, material=look.material)


# The shape of a solid of a size.
SHAPES: dict[int, Callable[[Vector], Geometry]] = {
    MarkerMessage.CUBE: Box,
    MarkerMessage.SPHERE: lambda size: Sphere(0.5 * size[0]),
    MarkerMessage.CYLINDER: lambda size: Cylinder(0.5 * size[0], size[2]),
}
# How each other kind is shown.
SHOW: dict[int, Callable[[MarkersDisplay, Key, Marker, Pose], None]] = {
    MarkerMessage.ARROW: MarkersDisplay._show_arrow,
    MarkerMessage.LINE_STRIP: MarkersDisplay._show_strip,
    MarkerMessage.LINE_LIST: MarkersDisplay._show_segments,
    MarkerMessage.CUBE_LIST: MarkersDisplay._show_list,
    MarkerMessage.SPHERE_LIST: MarkersDisplay._show_list,
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
        return bool(marker.text)

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


def single_marker_display(context: DisplayContext, topic: str) -> MarkersDisplay:
    """Return a display of a topic of single markers."""
    read = reader_of(MarkerMessage, lambda message: [read_marker(message)])
    return MarkersDisplay(context, topic, read)


def contacts_display(context: DisplayContext, topic: str) -> MarkersDisplay:
    """Return a display of the contacts of a bumper: points, normals and forces."""

    def read(message: Any) -> list[Marker]:
        return [read_marker(one) for one in contact_markers(message, CONTACT_SCALE)]

    display = MarkersDisplay(context, topic, reader_of(msg.ContactsState, read))
    display.stays = False
    return display
