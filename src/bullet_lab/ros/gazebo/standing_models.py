"""What stands where in a running world, of the markers that the bridge shows."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import Dict, List, Optional, Tuple

import numpy as np
import rospy
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.errors import LabError
from bullet_lab.ros.messages.poses import pose_of
from bullet_lab.simulation.world.description import Mesh
from bullet_lab.simulation.world.meshes import load_triangles
from bullet_lab.simulation.world.resources import ResourceFinder

TOPIC = "/bullet_lab/world"
# What rises less than this (m) above the floor is floor.
FLOOR = 0.02
_CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


@dataclass(frozen=True)
class Standing:
    """The box around a shape.

    Attributes:
        least: x, y, z of its lower corner in the world, m.
        greatest: of its upper corner.
        origin: x, y, z of the shape itself.
    """

    least: Tuple[float, float, float]
    greatest: Tuple[float, float, float]
    origin: Tuple[float, float, float]

    def distance(self, x: float, y: float) -> float:
        """Return how far (m) a point of the floor is from it, 0 below it."""
        dx = max(self.least[0] - x, 0.0, x - self.greatest[0])
        dy = max(self.least[1] - y, 0.0, y - self.greatest[1])
        return math.hypot(dx, dy)


class StandingModels:
    """Keeps the shapes of all models, by the markers' namespaces and numbers.

    Thread-safe: messages come in threads of rospy.
    """

    def __init__(self):
        self._lock = threading.Lock()
        self._shapes: Dict[Tuple[str, int], Standing] = {}
        self._known = False

    def take(self, message: MarkerArray) -> None:
        """Take note of shapes that came, moved or went."""
        with self._lock:
            self._known = True
            for marker in message.markers:
                if marker.action == Marker.DELETEALL:
                    self._shapes.clear()
                elif marker.action == Marker.DELETE:
                    self._shapes.pop((marker.ns, marker.id), None)
                else:
                    self._shapes[marker.ns, marker.id] = standing(marker)

    def is_known(self) -> bool:
        """Return whether anything has been told yet."""
        return self._known

    def names(self) -> Tuple[str, ...]:
        """Return the names of the models."""
        with self._lock:
            return tuple(sorted({name for name, _ in self._shapes}))

    def origin(self, name: str) -> Optional[Tuple[float, float, float]]:
        """Return where (m) a model's first shape is; None if there is no such model."""
        with self._lock:
            numbers = [number for model, number in self._shapes if model == name]
            return self._shapes[name, min(numbers)].origin if numbers else None

    def nearest(self, x: float, y: float) -> Tuple[str, float]:
        """Return the nearest model that rises above the floor, and its distance in m."""
        with self._lock:
            found: List[Tuple[float, str]] = [
                (shape.distance(x, y), name)
                for (name, _), shape in self._shapes.items()
                if shape.greatest[2] > FLOOR
            ]
        distance, name = min(found, default=(math.inf, ""))
        return name, distance


def standing(marker: Marker) -> Standing:
    """Return the box around a marker's shape; that around its origin if nobody knows its size."""
    pose = pose_of(marker.pose.position, marker.pose.orientation)
    scale = (marker.scale.x, marker.scale.y, marker.scale.z)
    corners = np.array([pose.rotate(tuple(corner)) for corner in _extent(marker, scale)])
    corners += np.array(pose.position)
    least, greatest = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return Standing(tuple(least), tuple(greatest), pose.position)


def _extent(marker: Marker, scale: Tuple[float, ...]) -> np.ndarray:
    """Return the corners (n, 3) of a shape in its own frame."""
    if marker.type != Marker.MESH_RESOURCE:
        return _CORNERS * np.array(scale)
    try:
        path = ResourceFinder.anywhere().find(marker.mesh_resource)
        vertices = load_triangles(Mesh(path, marker.mesh_resource, scale)).vertices
    except LabError as error:
        rospy.logwarn_once("a mesh whose size nobody knows: %s", error)
        return np.zeros((1, 3))
    return np.where(_CORNERS < 0.0, vertices.min(axis=0), vertices.max(axis=0))
