"""Markers in the scene: those of visualization_msgs, the world's shapes among them."""

from __future__ import annotations

import functools
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any, Callable, Dict, FrozenSet, List, Optional, Set, Tuple

import numpy as np
from visualization_msgs.msg import Marker as Kinds
from visualization_msgs.msg import MarkerArray

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.errors import LabError
from bullet_lab.ros.gazebo.client import WORLD
from bullet_lab.ros.messages.gazebo_types import msg
from bullet_lab.ros.messages.world import look_of
from bullet_lab.ros.nodes.show_sensors import contact_markers
from bullet_lab.ros.view import raw
from bullet_lab.ros.view.displays import Stage, placed
from bullet_lab.ros.view.feeds import Feed, reader_of
from bullet_lab.simulation.world.description import WHITE, Colour, Geometry, Mesh, Visual
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.shapes import Box, Cylinder, Plane, Sphere
from bullet_lab.simulation.world.xml import ReportOnce
from bullet_lab.view.looks import glb_of
from bullet_lab.view.scene import Copies, Labels, Polyline, Solids, glb_copies, rgb

SOLIDS = {Kinds.CUBE: "box", Kinds.SPHERE: "sphere", Kinds.CYLINDER: "cylinder"}
LISTS = {Kinds.CUBE_LIST: "box", Kinds.SPHERE_LIST: "sphere"}
# Of an arrow that says nothing of it, shares of its length; and m for each N of a contact.
HEAD_LENGTH, HEAD_WIDTH, CONTACT_SCALE = 0.25, 2.0, 0.02

# Of a marker, what says how it looks.
LOOK = ("kind", "scale", "colour", "text", "mesh", "own_looks")

Key = Tuple[str, int]


class MarkersDisplay:
    """All markers of one topic, kept as visualization_msgs says.

    Args:
        stage: to show them on.
        topic: to listen to.
        read: makes markers of the bytes of a message.
    """

    # As in RViz: whoever has drawn them says when they are to go.
    stays = True

    def __init__(
        self,
        stage: Stage,
        topic: str,
        read: Callable[[bytes], List[raw.Marker]] = raw.read_markers,
    ):
        self._stage, self._node = stage, f"/topics{topic}"
        self._feed = Feed(topic, read, every=True)
        self._markers: Dict[Key, raw.Marker] = {}
        self._places: Dict[Key, Pose] = {}
        self._report = ReportOnce()
        self._solids = Solids(stage.scene, f"{self._node}/solids")
        self._labels = Labels(stage.scene, f"{self._node}/labels")
        self._meshes: Dict[Visual, Copies] = {}
        self._nodes: Dict[Key, Any] = {}
        self._lines: Dict[Key, Polyline] = {}
        # Number of the solids of each marker that is a list of them.
        self._listed: Dict[Key, int] = {}

    def tick(self) -> None:
        """Show what has come, and what has moved with its frame."""
        touched: Set[Key] = set()
        for markers in self._feed.take():
            for marker in markers:
                touched |= self._take(marker)
        for key, marker in self._markers.items():
            if marker.locked and marker.frame != self._stage.fixed:
                touched.add(key)
        for key in touched:
            if key in self._markers:
                self._show(key, self._markers[key])
        for copies in (self._solids, *self._meshes.values()):
            copies.flush()

    def close(self) -> None:
        """Listen no longer, and show nothing."""
        self._feed.close()
        for key in list(self._markers):
            self._drop(key)
        for copies in (self._solids, *self._meshes.values()):
            copies.flush()

    def is_hidden(self, marker: raw.Marker) -> bool:
        """Return whether a marker is not to be shown."""
        return False

    def has_look(self, marker: raw.Marker) -> bool:
        """Return whether a solid looks like more than its colour."""
        return False

    def frames(self) -> Set[str]:
        """Return the frames that markers are in."""
        return {marker.frame for marker in self._markers.values()}

    def _take(self, marker: raw.Marker) -> Set[Key]:
        key = (marker.space, marker.number)
        if marker.action == Kinds.DELETEALL:
            for other in list(self._markers):
                self._drop(other)
            return set()
        if marker.action == Kinds.DELETE:
            self._drop(key)
            return set()
        before = self._markers.get(key)
        if before is not None and before.kind != marker.kind:
            self._drop(key)
        self._markers[key] = marker
        self._places.pop(key, None)
        return {key}

    def _drop(self, key: Key) -> None:
        self._markers.pop(key, None)
        self._places.pop(key, None)
        self._hide(key)

    def _hide(self, key: Key) -> None:
        self._solids.drop(key)
        for number in range(self._listed.pop(key, 0)):
            self._solids.drop((*key, number))
        self._labels.drop(key)
        for copies in self._meshes.values():
            copies.drop(key)
        if key in self._nodes:
            self._nodes.pop(key).remove()
        if key in self._lines:
            self._lines.pop(key).set(np.zeros((0, 3)))

    def _show(self, key: Key, marker: raw.Marker) -> None:
        if self.is_hidden(marker):
            self._hide(key)
            return
        if marker.locked or key not in self._places:
            self._places[key] = self._stage.where(marker.frame)
        place = self._places[key] * marker.pose
        try:
            if marker.kind in SOLIDS and not self.has_look(marker):
                self._put_visual(key, None, place)
                self._solids.put(key, SOLIDS[marker.kind], place, marker.scale, marker.colour)
            elif marker.kind in SOLIDS or marker.kind == Kinds.MESH_RESOURCE:
                self._solids.drop(key)
                self._put_visual(key, _visual(*(getattr(marker, name) for name in LOOK)), place)
            elif marker.kind in SHOW:
                SHOW[marker.kind](self, key, marker, place)
        except LabError as error:
            self._report(f"{marker.space}: {error}")

    def _list(self, key: Key, marker: raw.Marker, place: Pose) -> None:
        self._hide(key)
        self._listed[key] = len(marker.points)
        for number, point in enumerate(marker.points.tolist()):
            colour = marker.colours[number] if len(marker.colours) else marker.colour
            pose = place * Pose(tuple(point))
            kind = LISTS[marker.kind]
            self._solids.put((*key, number), kind, pose, marker.scale, tuple(map(float, colour)))

    def _put_visual(self, key: Key, visual: Optional[Visual], place: Pose) -> None:
        for shown, copies in self._meshes.items():
            if shown != visual:
                copies.drop(key)
        if visual is None:
            return
        if visual not in self._meshes:
            name = f"{self._node}/meshes/{len(self._meshes)}"
            glb = glb_of([visual], self._report)
            made = glb_copies(self._stage.scene, name, glb) if glb else Copies(lambda _: None, ())
            self._meshes[visual] = made
        self._meshes[visual].put(key, place)

    def _label(self, key: Key, marker: raw.Marker, place: Pose) -> None:
        self._labels.put(key, marker.text, place.position)

    def _strip(self, key: Key, marker: raw.Marker, place: Pose) -> None:
        if key not in self._lines:
            self._lines[key] = Polyline(self._stage.scene, self._name(key), marker.colour)
        self._lines[key].set(placed(place, marker.points))

    def _segments(self, key: Key, marker: raw.Marker, place: Pose) -> None:
        points = placed(place, marker.points[: len(marker.points) // 2 * 2])
        self._replace(
            key,
            len(points),
            lambda name: self._stage.scene.add_line_segments(
                name, points.reshape(-1, 2, 3), rgb(marker.colour), thickness_units="screen"
            ),
        )

    def _points(self, key: Key, marker: raw.Marker, place: Pose) -> None:
        points = placed(place, marker.points)
        colours = np.array(rgb(marker.colour))
        if len(marker.colours) == len(points):
            colours = np.round(255.0 * np.clip(marker.colours[:, :3], 0.0, 1.0)).astype(np.uint8)
        self._replace(
            key,
            len(points),
            lambda name: self._stage.scene.add_point_cloud(
                name, points, colours, point_size=max(marker.scale[0], 0.01), precision="float32"
            ),
        )

    def _arrow(self, key: Key, marker: raw.Marker, place: Pose) -> None:
        if len(marker.points) >= 2:
            ends, shaft, head = marker.points[:2], marker.scale[0], marker.scale[1]
            length = marker.scale[2]
        else:
            ends, shaft = np.array(((0.0, 0.0, 0.0), (marker.scale[0], 0.0, 0.0))), marker.scale[1]
            head, length = HEAD_WIDTH * shaft, 0.0
        ends = placed(place, ends)
        reach = float(np.linalg.norm(ends[1] - ends[0]))
        self._replace(
            key,
            reach > 0.0,
            lambda name: self._stage.scene.add_arrows(
                name,
                ends[None],
                rgb(marker.colour),
                shaft_radius=0.5 * shaft,
                head_radius=0.5 * head,
                head_length=length or HEAD_LENGTH * reach,
            ),
        )

    def _triangles(self, key: Key, marker: raw.Marker, place: Pose) -> None:
        corners = placed(place, marker.points[: len(marker.points) // 3 * 3] * marker.scale)
        faces = np.arange(len(corners)).reshape(-1, 3)
        self._replace(
            key,
            len(corners),
            lambda name: self._stage.scene.add_mesh_simple(
                name, corners, faces, color=rgb(marker.colour), side="double", flat_shading=True
            ),
        )

    def _replace(self, key: Key, there_is: Any, make: Callable[[str], Any]) -> None:
        """Make the node of a marker anew, or take it away where there is nothing of it."""
        if there_is:
            self._nodes[key] = make(self._name(key))
        elif key in self._nodes:
            self._nodes.pop(key).remove()

    def _name(self, key: Key) -> str:
        space, number = key
        return f"{self._node}/{space or '_'}/{number}"


@functools.lru_cache(maxsize=1024)
def _visual(
    kind: int, scale: Vector, colour: Colour, text: str, mesh: str, own_looks: bool
) -> Visual:
    """Return what is seen of a solid or a mesh; raises ResourceError."""
    look = look_of(text)
    if kind == Kinds.MESH_RESOURCE:
        path = ResourceFinder.anywhere().find(mesh)
        material = replace(look.material, covers=not own_looks)
        colour = colour if colour[3] > 0.0 else WHITE
        return Visual(Mesh(Path(path), mesh, scale), colour=colour, material=material)
    shape = Plane(size=scale[:2]) if look.is_plane else SHAPES[kind](scale)
    return Visual(shape, colour=colour, material=look.material)


# The shape of a solid of a size; a mesh has its own.
SHAPES: Dict[int, Callable[[Vector], Geometry]] = {
    Kinds.CUBE: Box,
    Kinds.SPHERE: lambda size: Sphere(0.5 * size[0]),
    Kinds.CYLINDER: lambda size: Cylinder(0.5 * size[0], size[2]),
}
# How each other kind is shown.
SHOW: Dict[int, Callable[[MarkersDisplay, Key, raw.Marker, Pose], None]] = {
    Kinds.ARROW: MarkersDisplay._arrow,
    Kinds.LINE_STRIP: MarkersDisplay._strip,
    Kinds.LINE_LIST: MarkersDisplay._segments,
    Kinds.CUBE_LIST: MarkersDisplay._list,
    Kinds.SPHERE_LIST: MarkersDisplay._list,
    Kinds.POINTS: MarkersDisplay._points,
    Kinds.TEXT_VIEW_FACING: MarkersDisplay._label,
    Kinds.TRIANGLE_LIST: MarkersDisplay._triangles,
}


class WorldDisplay(MarkersDisplay):
    """The shapes of the world, less the models that are shown as robots."""

    def __init__(self, stage: Stage):
        super().__init__(stage, WORLD)
        self._robots: FrozenSet[str] = frozenset()

    def is_hidden(self, marker: raw.Marker) -> bool:  # noqa: D102 - as `MarkersDisplay` has it
        return marker.space in self._robots

    def has_look(self, marker: raw.Marker) -> bool:  # noqa: D102
        return bool(marker.text)

    def leave_out(self, robots: FrozenSet[str]) -> None:
        """Show all models but these."""
        changed, self._robots = robots ^ self._robots, robots
        for key, marker in self._markers.items():
            if marker.space in changed:
                self._show(key, marker)

    def models(self) -> Set[str]:
        """Return the names of all models, those that are left out among them."""
        return {marker.space for marker in self._markers.values()}


def single_marker_display(stage: Stage, topic: str) -> MarkersDisplay:
    """Return a display of a topic of single markers."""
    return MarkersDisplay(stage, topic, raw.read_marker)


def contacts_display(stage: Stage, topic: str) -> MarkersDisplay:
    """Return a display of what a bumper feels: points, normals and forces."""
    read = reader_of(msg.ContactsState)

    def markers(data: bytes) -> List[raw.Marker]:
        array = BytesIO()
        MarkerArray(list(contact_markers(read(data), CONTACT_SCALE))).serialize(array)
        return raw.read_markers(array.getvalue())

    display = MarkersDisplay(stage, topic, markers)
    display.stays = False
    return display
