"""Worlds, lights and camera poses in which the detection of the marker is measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import List, Tuple
from zlib import crc32

import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.plugins.camera import Camera
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Box, Link, Model, World, footprints
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.urdf import read_urdf_file
from bullet_lab.studies.worlds import DEFAULT_LIGHT, ROBOT, lit_world
from bullet_lab.vision.images import grey

DICTIONARY = "apriltag_36h10"
WANTED_ID = 0
CAMERA_HEIGHT = 0.44
MARKER: Vector = (4.0, 0.0, 0.5)
"""Centre of the wanted marker in all worlds; all markers in them face -x."""

CLEARANCE = 0.12
"""m; smallest distance of a robot's camera from a wall beside it."""

DISTANCE_JITTER = (0.005, 0.02)
"""Share of the distance, and m; the smaller one holds."""

BEARING_JITTER = math.radians(1.0)
HEADING_JITTER = math.radians(2.0)

STREWN_DISTANCES = (0.35, 8.0)
STREWN_BEARINGS = (0.0, math.radians(60.0))
STREWN_HEADING = math.radians(25.0)


# Columns: the axes of the optical frame (right, down, ahead) in that of the camera's link.
OPTICAL_AXES = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))


@dataclass(frozen=True)
class PrintedMarker:
    """A marker of the wanted id in a world: edge (m) and centre; it faces -x."""

    size: float
    middle: Vector

    def corners(self) -> np.ndarray:
        """Return the (4, 3) corners: top left, top right, bottom right, bottom left."""
        half = 0.5 * self.size
        # For a view along x, +y is to the left.
        offsets = np.array([(0, 1, 1), (0, -1, 1), (0, -1, -1), (0, 1, -1)], dtype=float)
        return np.asarray(self.middle) + half * offsets


@dataclass(frozen=True)
class DetectionWorld:
    """The wanted marker of a world, and other markers with the same id."""

    wanted: PrintedMarker = PrintedMarker(0.20, MARKER)
    others: Tuple[PrintedMarker, ...] = ()


WORLDS = {
    "marker_panel": DetectionWorld(),
    "docking": DetectionWorld(),
    "docking_dots": DetectionWorld(),
    "docking_nested": DetectionWorld(
        PrintedMarker(0.075, MARKER), (PrintedMarker(0.8, (4.0, 0.05, 0.45)),)
    ),
    "docking_decoy": DetectionWorld(others=(PrintedMarker(0.35, (3.3, 1.65, 0.5)),)),
}


@dataclass(frozen=True)
class Cell:
    """A cell of the grid: world, light, distance to the marker (m), bearing (rad, >= 0).

    The bearing is the angle at the marker between its axis and the camera.
    """

    world: str
    light: str
    distance: float
    bearing: float

    def key(self) -> Tuple[int, ...]:
        """Return numbers that are unique to this cell, for its random stream."""
        words = (crc32(self.world.encode()), crc32(self.light.encode()))
        return (*words, round(1e6 * self.distance), round(1e6 * self.bearing))


@dataclass(frozen=True)
class Shot:
    """A pose of the camera, and the number of its image."""

    pose: Pose
    number: int


def cell_shots(cell: Cell, frames: int, seed: int) -> List[Shot]:
    """Return jittered camera poses for a cell, on the left and the right side in turn.

    They depend on the cell and the seed only. The camera faces the marker, with a small error.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=cell.key()))
    return [_shot(cell, (-1.0) ** index, rng) for index in range(frames)]


def strewn_shots(world: str, frames: int, seed: int, block: int) -> List[Shot]:
    """Return camera poses all over a world, at random distances and bearings."""
    key = (crc32(world.encode()), block)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
    found: List[Shot] = []
    while len(found) < frames:
        distance, bearing = rng.uniform(*STREWN_DISTANCES), rng.uniform(*STREWN_BEARINGS)
        cell = Cell(world, DEFAULT_LIGHT, distance, bearing)
        if is_reachable(cell):
            found.append(_shot(cell, rng.choice((-1.0, 1.0)), rng, STREWN_HEADING))
    return found


def _shot(
    cell: Cell, side: float, rng: np.random.Generator, astray: float = HEADING_JITTER
) -> Shot:
    share, most = DISTANCE_JITTER
    reach = min(share * cell.distance, most)
    off, aside, turned = rng.uniform(-1.0, 1.0, 3) * (reach, BEARING_JITTER, astray)
    bearing = side * cell.bearing + aside
    return Shot(camera_pose(cell.distance + off, bearing, turned), int(rng.integers(2**31)))


def camera_pose(distance: float, bearing: float, turned: float = 0.0) -> Pose:
    """Return the camera's pose at a distance (m) and bearing (rad) from the marker.

    It is level, and faces the marker except for `turned` rad to the left.
    """
    x = MARKER[0] - distance * math.cos(bearing)
    y = MARKER[1] + distance * math.sin(bearing)
    return Pose.from_rpy((x, y, CAMERA_HEIGHT), (0.0, 0.0, turned - bearing))


def is_reachable(cell: Cell) -> bool:
    """Return whether there is room for the camera at a cell, on both sides."""
    plan = footprints(lit_world(cell.world, cell.light), below=CAMERA_HEIGHT + CLEARANCE)
    # The camera may come close to the wall that bears the marker.
    plan = [one for one in plan if one.centre[0] <= MARKER[0] - CLEARANCE]
    return all(one.distance(place[:2]) >= CLEARANCE for one in plan for place in _places(cell))


def _places(cell: Cell) -> List[Vector]:
    """Return the positions of the camera at a cell, on both sides."""
    return [camera_pose(cell.distance, side * cell.bearing).position for side in (-1.0, 1.0)]


def is_visible(cell: Cell) -> bool:
    """Return whether no box hides the wanted marker from the camera, on both sides."""
    boxes = [
        (model.pose * link.pose * shape.pose, shape.geometry)
        for model in lit_world(cell.world, cell.light).models
        for link in model.links
        for shape in link.collisions
        if isinstance(shape.geometry, Box)
    ]
    corners = WORLDS[cell.world].wanted.corners()
    rays = [(np.array(eye), corner) for eye in _places(cell) for corner in corners]
    return not any(_cuts(pose, box, eye, corner) for pose, box in boxes for eye, corner in rays)


def _cuts(pose: Pose, box: Box, eye: np.ndarray, point: np.ndarray) -> bool:
    """Return whether a box cuts the ray from an eye to a point (slab method)."""
    turn = pose.rotation_matrix()
    start, end = ((p - pose.position) @ turn for p in (eye, point))
    # Not to the very end: the marker lies on the surface of a box.
    ray = 0.999 * (end - start)
    half = 0.5 * np.array(box.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (-half - start) / ray, (half - start) / ray
    enter = np.nanmax(np.minimum(first, second))
    leave = np.nanmin(np.maximum(first, second))
    return bool(max(enter, 0.0) < min(leave, 1.0))


class FreeCamera:
    """The camera of the robot, noise included, at any pose in a world.

    Args:
        world: to take images of.
        seed: of the noise.

    Raises:
        LabError: a file cannot be read.
    """

    def __init__(self, world: World, seed: int = 0):
        robot = read_urdf_file(ResourceFinder.anywhere().find(ROBOT))
        plugin = next(p for p in robot.plugins if p.filename in Camera.filenames)
        plugin = replace(plugin, link="camera")
        model = Model("free_camera", (Link("camera"),), plugins=(plugin,), static=True)
        self._simulation = Simulation(world, seed)
        self._instance = self._simulation.add(model)
        self._device: Camera = self._instance.plugins[0]

    def close(self) -> None:
        """Close the simulation."""
        self._simulation.close()

    @property
    def camera(self) -> PinholeCamera:
        """Geometry of the images."""
        return self._device.camera

    def take(self, pose: Pose, number: int) -> np.ndarray:
        """Return the image from a pose, (height, width) of uint8, grey; raises LabError.

        Args:
            pose: of the camera in the world: x ahead, z up.
            number: of the image, >= 0; its noise follows from this and the seed.
        """
        self._instance.place(pose)
        return grey(self._device.take(number), self._device.encoding)


def in_optical_frame(pose: Pose, points: np.ndarray) -> np.ndarray:
    """Return (n, 3) points of the world in the optical frame of a camera: right, down, ahead."""
    inside = (np.asarray(points, dtype=float) - pose.position) @ pose.rotation_matrix()
    return inside @ np.array(OPTICAL_AXES)
