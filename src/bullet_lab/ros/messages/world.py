"""The world's shapes as markers, so that RViz shows what Gazebo's window would.

What markers have no field for stands in their text, which RViz passes over on all that is no text:
as JSON, the textures, and what shines by itself.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, Iterator, NamedTuple, Tuple

from geometry_msgs.msg import Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.poses import pose_message
from bullet_lab.simulation.simulation import ModelInstance
from bullet_lab.simulation.world.description import BLACK, Material, Texture, Visual
from bullet_lab.simulation.world.mesh_parts import has_own_looks
from bullet_lab.simulation.world.shapes import Box, Cylinder, Mesh, Plane, Sphere

# A plane is drawn as a slab just below the floor, or it would flicker with RViz's grid.
SLAB_THICKNESS = 0.01
SLAB_DEPTH = 0.005
LARGEST_PLANE = 20.0
# Type and scale of the marker of each shape.
MARKERS: Dict[type, Callable[[Any], Tuple[int, Tuple[float, ...]]]] = {
    Box: lambda box: (Marker.CUBE, box.size),
    Cylinder: lambda c: (Marker.CYLINDER, (2.0 * c.radius, 2.0 * c.radius, c.length)),
    Sphere: lambda sphere: (Marker.SPHERE, (2.0 * sphere.radius,) * 3),
    Plane: lambda plane: (
        Marker.CUBE,
        (*(min(side, LARGEST_PLANE) for side in plane.size), SLAB_THICKNESS),
    ),
    Mesh: lambda mesh: (Marker.MESH_RESOURCE, mesh.scale),
}


def world_markers(models: Iterable[ModelInstance], frame: str) -> MarkerArray:
    """Return the visible shapes of models in the world's frame, in namespaces of their names."""
    markers = []
    for instance in models:
        for number, (pose, visual) in enumerate(_visuals(instance)):
            marker = _marker(visual)
            marker.header.frame_id = frame
            marker.ns = instance.name
            marker.id = number
            marker.pose = pose_message(pose)
            markers.append(marker)
    return MarkerArray(markers)


def deleted_markers(model: str, count: int, frame: str) -> MarkerArray:
    """Return what takes the `count` markers of a model away."""
    array = MarkerArray()
    for number in range(count):
        marker = Marker(action=Marker.DELETE, ns=model, id=number)
        marker.header.frame_id = frame
        array.markers.append(marker)
    return array


class Look(NamedTuple):
    """What a shape looks like beyond its marker's colour, and whether its slab is a plane."""

    material: Material = Material()
    is_plane: bool = False


def _look_text(visual: Visual) -> str:
    """Return what `look_of` reads of a visual; empty for one that is all told by its colour."""
    material = visual.material
    said: Dict[str, Any] = {}
    if material.texture is not None:
        said = {"texture": asdict(material.texture), "plane": isinstance(visual.geometry, Plane)}
    if material.emissive != BLACK:
        said["emissive"] = material.emissive
    if not material.lit:
        said["lit"] = False
    return json.dumps(said, default=str) if said else ""


def look_of(text: str) -> Look:
    """Return the look that the text of a shape's marker tells; a plain one where it tells none.

    >>> look_of('{"texture": {"path": "/wood.png"}, "lit": false}').material.texture.path.name
    'wood.png'
    >>> look_of("a label") == Look()
    True
    """
    try:
        said = json.loads(text) if text else {}
        texture = _texture(said["texture"]) if "texture" in said else None
        emissive = _numbers(said.get("emissive", BLACK), 4)
        lit = bool(said.get("lit", True))
        return Look(Material(None, emissive, texture, lit), bool(said.get("plane")))
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
        return Look()


def _texture(said: Dict[str, Any]) -> Texture:
    scale = _numbers(said.get("scale", (1.0, 1.0)), 2)
    scroll = _numbers(said.get("scroll", (0.0, 0.0)), 2)
    if not all(scale):
        raise ValueError(scale)
    (rotation,) = _numbers((said.get("rotation", 0.0),), 1)
    repeats, blends, sharp = (
        bool(said.get(key, usual))
        for key, usual in (("repeats", True), ("blends", False), ("sharp", False))
    )
    return Texture(Path(said["path"]), scale, scroll, rotation, repeats, blends, sharp)


def _numbers(values: Iterable[Any], count: int) -> Tuple[Any, ...]:
    found = tuple(map(float, values))
    if len(found) != count or not all(map(math.isfinite, found)):
        raise ValueError(found)
    return found


def _visuals(instance: ModelInstance) -> Iterator[tuple]:
    for link in instance.model.links:
        pose = instance.frame(link.name).pose() if link.visuals else Pose()
        for visual in link.visuals:
            placed = pose * visual.pose
            if isinstance(visual.geometry, Plane):
                placed = placed * Pose((0.0, 0.0, -SLAB_DEPTH - 0.5 * SLAB_THICKNESS))
            yield placed, visual


def _marker(visual: Visual) -> Marker:
    shape = visual.geometry
    kind, size = MARKERS[type(shape)](shape)
    marker = Marker(action=Marker.ADD, frame_locked=True, type=kind, scale=Vector3(*size))
    marker.color = ColorRGBA(*visual.colour)
    marker.text = _look_text(visual)
    if isinstance(shape, Plane) and visual.material.texture is not None:
        # As large as the picture on it has it.
        marker.scale = Vector3(*shape.size, SLAB_THICKNESS)
    if isinstance(shape, Mesh):
        # RViz knows package:// itself, and file:// for the rest.
        in_package = shape.uri.startswith("package://")
        marker.mesh_resource = shape.uri if in_package else shape.path.absolute().as_uri()
        if not visual.material.covers and has_own_looks(shape):
            # Where there is no colour at all, a mesh keeps its own.
            marker.mesh_use_embedded_materials, marker.color = True, ColorRGBA()
    return marker
