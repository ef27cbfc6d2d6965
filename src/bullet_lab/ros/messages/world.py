"""The world's shapes as markers, so that RViz shows what Gazebo's window would."""

from __future__ import annotations

from typing import Any, Callable, Dict, Iterable, Iterator, Tuple

from geometry_msgs.msg import Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.poses import pose_message
from bullet_lab.simulation.simulation import ModelInstance
from bullet_lab.simulation.world.description import Visual
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
    if isinstance(shape, Mesh):
        # RViz knows package:// itself, and file:// for the rest.
        in_package = shape.uri.startswith("package://")
        marker.mesh_resource = shape.uri if in_package else shape.path.absolute().as_uri()
        if not visual.material.covers and has_own_looks(shape):
            # Where there is no colour at all, a mesh keeps its own.
            marker.mesh_use_embedded_materials, marker.color = True, ColorRGBA()
    return marker
