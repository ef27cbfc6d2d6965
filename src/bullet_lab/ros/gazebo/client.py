"""Clients of a running simulator: calls of its services, and where its models are.

The latter follows from the markers that the bridge publishes.
"""

from __future__ import annotations

import math
import re
import threading
from itertools import product
from typing import Any, Iterable, NamedTuple

import numpy as np
import rospy
from numpy import ndarray
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.core.pose import Vector
from bullet_lab.errors import LabError
from bullet_lab.ros.messages.poses import pose_of
from bullet_lab.ros.node.node import NodeError, Refusals, wait_until
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.shapes import Box, Mesh

# Topic with the markers of all shapes in the world.
WORLD = "/bullet_lab/world"
# m; a shape whose top is lower counts as floor.
FLOOR = 0.02


def call(service: str, kind: type, *arguments: Any) -> Any:
    """Wait for a service and call it; raises NodeError if it fails or its response says so."""
    wait_until(lambda: _is_offered(service), service)
    try:
        answer = rospy.ServiceProxy(service, kind)(*arguments)
    except rospy.ServiceException as error:
        raise NodeError(f"{service}: {error}") from error
    # std_srvs/Empty has no such field.
    if not getattr(answer, "success", True):
        raise NodeError(f"{service}: {answer.status_message}")
    return answer


def _is_offered(service: str) -> bool:
    try:
        rospy.wait_for_service(service, 0.2)
        return True
    except rospy.ROSInterruptException:
        raise
    except rospy.ROSException:
        return False


def numbered(names: Iterable[str], name: str) -> list[str]:
    """Return the names that consist of `name`, an underscore and a number."""
    pattern = re.compile(rf"{re.escape(name)}_\d+")
    return [found for found in names if pattern.fullmatch(found)]


class _BoundingBox(NamedTuple):
    """The axis-aligned box around a shape in the world: two corners and the shape's origin, m."""

    least: ndarray
    greatest: ndarray
    origin: Vector

    def distance(self, x: float, y: float) -> float:
        """Return the horizontal distance (m) of a point; 0 inside the box."""
        gaps = np.maximum(self.least[:2] - (x, y), (x, y) - self.greatest[:2])
        return math.hypot(*gaps.clip(0.0))


class StandingModels:
    """Keeps the bounding boxes of all shapes, by model and marker number; thread-safe."""

    def __init__(self):
        self._lock = threading.Lock()
        self._shapes: dict[tuple[str, int], _BoundingBox] = {}
        self._known = False
        self._refusals = Refusals()

    def take(self, message: MarkerArray) -> None:
        """Add, move and remove the shapes of a message."""
        with self._lock:
            self._known = True
            for marker in message.markers:
                if marker.action == Marker.DELETEALL:
                    self._shapes.clear()
                elif marker.action == Marker.DELETE:
                    self._shapes.pop((marker.ns, marker.id), None)
                else:
                    with self._refusals.on(WORLD):
                        self._shapes[marker.ns, marker.id] = _bounding_box(marker)

    def is_known(self) -> bool:
        """Return whether a message has arrived."""
        return self._known

    def names(self) -> tuple[str, ...]:
        """Return the names of the models."""
        with self._lock:
            return tuple(sorted({name for name, _ in self._shapes}))

    def origin(self, name: str) -> Vector | None:
        """Return the position (m) of a model's first shape; None if there is no such model."""
        with self._lock:
            numbers = [number for model, number in self._shapes if model == name]
            return self._shapes[name, min(numbers)].origin if numbers else None

    def nearest(self, x: float, y: float) -> tuple[str, float]:
        """Return the nearest model that rises above the floor, and its distance in m."""
        with self._lock:
            found = [
                (shape.distance(x, y), name)
                for (name, _), shape in self._shapes.items()
                if shape.greatest[2] > FLOOR
            ]
        distance, name = min(found, default=(math.inf, ""))
        return name, distance


def _bounding_box(marker: Marker) -> _BoundingBox:
    """Return the box around a marker's shape; its origin alone if the size is unknown."""
    pose = pose_of(marker.pose.position, marker.pose.orientation)
    corners = np.array([pose.rotate(corner) for corner in product(*_bounds(marker).T.tolist())])
    corners += np.array(pose.position)
    return _BoundingBox(corners.min(axis=0), corners.max(axis=0), pose.position)


def _bounds(marker: Marker) -> ndarray:
    """Return the lower and upper corner of a shape in its own frame, (2, 3)."""
    scale = (marker.scale.x, marker.scale.y, marker.scale.z)
    if marker.type != Marker.MESH_RESOURCE:
        return Box(scale).bounds()
    try:
        path = ResourceFinder.anywhere().find(marker.mesh_resource)
        return Mesh(path, marker.mesh_resource, scale).bounds()
    except LabError as error:
        rospy.logwarn_once("a mesh of unknown size: %s", error)
        return np.zeros((2, 3))
