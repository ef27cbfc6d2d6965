"""The world's shapes as markers, so that RViz shows them as Gazebo's window would.

A marker has no fields for textures and emissive colours. They are in its text as JSON; RViz
displays the text of text markers only.
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

# m; a plane is a slab just below the floor, or it would flicker with RViz's grid.
SLAB_THICKNESS = 0.01
SLAB_DEPTH = 0.005
# m; longest side of a plane without texture.
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
    """Return the visible shapes of models as markers; their namespace is the model's name."""
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
    """Return markers that delete the `count` markers of a model."""
    array = MarkerArray()
    for number in range(count):
        marker = Marker(action=Marker.DELETE, ns=model, id=number)
        marker.header.frame_id = frame
        array.markers.append(marker)
    return array


class Look(NamedTuple):
    """The appearance of a shape besides its colour, and whether its slab is a plane."""

    material: Material = Material()
    is_plane: bool = False


def _look_text(visual: Visual) -> str:
    """Return the text of a visual's marker for `look_of`; empty if it has only a colour."""
    material = visual.material
    look: Dict[str, Any] = {}
    if material.texture is not None:
        look = {"texture": asdict(material.texture), "plane": isinstance(visual.geometry, Plane)}
    if material.emissive != BLACK:
        look["emissive"] = material.emissive
    if not material.lit:
        look["lit"] = False
    return json.dumps(look, default=str) if look else ""


def look_of(text: str) -> Look:
    """Return the look in the text of a shape's marker; the default look if there is none.

    >>> look_of('{"texture": {"path": "/wood.png"}, "lit": false}').material.texture.path.name
    'wood.png'
    >>> look_of("a label") == Look()
    True
    """
    try:
        look = json.loads(text) if text else {}
        texture = _texture(**look["texture"]) if "texture" in look else None
        emissive = _numbers(look.get("emissive", BLACK), 4)
        lit = bool(look.get("lit", True))
        return Look(Material(None, emissive, texture, lit), bool(look.get("plane")))
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
        return Look()


def _texture(path: Any, **values: Any) -> Texture:
    texture = Texture(Path(path), **values)
    scale, scroll = _numbers(texture.scale, 2), _numbers(texture.scroll, 2)
    if not all(scale):
        raise ValueError(scale)
    flags = (bool(flag) for flag in (texture.repeats, texture.blends, texture.sharp))
    return Texture(texture.path, scale, scroll, *_numbers([texture.rotation], 1), *flags)


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
        # The full size, which the texture depends on.
        marker.scale = Vector3(*shape.size, SLAB_THICKNESS)
    if isinstance(shape, Mesh):
        # RViz resolves package:// itself.
        in_package = shape.uri.startswith("package://")
        marker.mesh_resource = shape.uri if in_package else shape.path.absolute().as_uri()
        if not visual.material.covers and has_own_looks(shape):
            # Without a colour of the marker, a mesh has its own colours.
            marker.mesh_use_embedded_materials, marker.color = True, ColorRGBA()
    return marker
