"""The world's shapes as markers, so that RViz shows what Gazebo's window would."""

from __future__ import annotations

from pathlib import Path
from typing import Iterable, Iterator

from geometry_msgs.msg import Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.conversions import pose_message
from bullet_lab.simulation.simulation import ModelInstance
from bullet_lab.simulation.world.description import Box, Cylinder, Mesh, Plane, Sphere, Visual

# A plane is drawn as a slab just below the floor, or it would flicker with RViz's grid.
SLAB_THICKNESS = 0.01
SLAB_DEPTH = 0.005
LARGEST_PLANE = 20.0


def world_markers(models: Iterable[ModelInstance], frame: str) -> MarkerArray:
    """Return the visible shapes of models; the namespace of a marker is the model's name.

    Args:
        models: what to draw, where it is now.
        frame: the world's frame.
    """
    markers = []
    for instance in models:
        for number, (pose, visual) in enumerate(_visuals(instance)):
            marker = _marker(visual)
            marker.header.frame_id = frame
            marker.ns = instance.name
            marker.id = number
            marker.pose = pose_message(pose)
            marker.color = ColorRGBA(*visual.colour)
            markers.append(marker)
    return MarkerArray(markers)


def deleted_markers(model: str, count: int, frame: str) -> MarkerArray:
    """Return what takes the markers of a model away.

    Args:
        model: its name.
        count: how many there are.
        frame: the world's frame.
    """
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
    marker = Marker(action=Marker.ADD, frame_locked=True)
    geometry = visual.geometry
    if isinstance(geometry, Box):
        marker.type, size = Marker.CUBE, geometry.size
    elif isinstance(geometry, Cylinder):
        marker.type = Marker.CYLINDER
        size = (2.0 * geometry.radius, 2.0 * geometry.radius, geometry.length)
    elif isinstance(geometry, Sphere):
        marker.type, size = Marker.SPHERE, (2.0 * geometry.radius,) * 3
    elif isinstance(geometry, Plane):
        marker.type = Marker.CUBE
        size = tuple(min(side, LARGEST_PLANE) for side in geometry.size) + (SLAB_THICKNESS,)
    else:
        marker.type, size = Marker.MESH_RESOURCE, geometry.scale
        marker.mesh_resource = _resource(geometry)
    marker.scale = Vector3(*size)
    return marker


def _resource(mesh: Mesh) -> str:
    # RViz knows package:// itself, and file:// for the rest.
    return mesh.uri if mesh.uri.startswith("package://") else Path(mesh.path).absolute().as_uri()
