"""Worlds, lights and places of the camera in which the detection of the marker is tried."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import List, Tuple
from zlib import crc32

import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose, Vector
from bullet_lab.errors import LabError
from bullet_lab.simulation.plugins.camera import Camera
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Box, Link, Model, World
from bullet_lab.simulation.world.floor_plan import footprints
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.sdf import read_world_file
from bullet_lab.simulation.world.urdf import read_urdf_file
from bullet_lab.vision.images import grey

DICTIONARY = "apriltag_36h10"
WANTED_ID = 0
CAMERA_HEIGHT = 0.44
MARKER: Vector = (4.0, 0.0, 0.5)
"""Middle of the wanted marker in all worlds; like all markers in them it looks along -x."""

CLEARANCE = 0.12
"""m; a camera on a robot comes no nearer to a wall at its side."""

DISTANCE_JITTER = (0.005, 0.02)
"""Share of the distance, and m; the smaller one counts."""

BEARING_JITTER = math.radians(1.0)
HEADING_JITTER = math.radians(2.0)

STREWN_DISTANCES = (0.35, 8.0)
STREWN_BEARINGS = (0.0, math.radians(60.0))
STREWN_HEADING = math.radians(25.0)


class SceneError(LabError):
    """A world, a light, a place or a robot that is not known or cannot be used."""


@dataclass(frozen=True)
class PrintedMarker:
    """A marker of the wanted id in a world: edge (m) and middle; it looks along -x."""

    size: float
    middle: Vector

    def corners(self) -> np.ndarray:
        """Return the (4, 3) corners: top left, top right, bottom right, bottom left."""
        half = 0.5 * self.size
        # As one looks along x, +y is to the left.
        offsets = np.array([(0, 1, 1), (0, -1, 1), (0, -1, -1), (0, 1, -1)], dtype=float)
        return np.asarray(self.middle) + half * offsets


@dataclass(frozen=True)
class DetectionWorld:
    """The wanted marker of a world, and others with the same id that are not meant."""

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

LIGHTS = {
    "default": "",
    "dark": "docking_dark",
    "bright": "docking_bright",
    "backlit": "docking_backlit",
}
"""The world whose light is taken; the world's own if empty."""


@dataclass(frozen=True)
class Cell:
    """One field of the grid: world, light, distance to the marker (m), bearing (rad, >= 0).

    The bearing is the angle between the marker's axis and the camera, seen from the marker.
    """

    world: str
    light: str
    distance: float
    bearing: float

    def key(self) -> Tuple[int, ...]:
        """Return numbers that tell this cell from all others, for what is random in it."""
        words = (crc32(self.world.encode()), crc32(self.light.encode()))
        return (*words, round(1e6 * self.distance), round(1e6 * self.bearing))


@dataclass(frozen=True)
class Shot:
    """A place of the camera, and the number of its picture."""

    pose: Pose
    number: int


def lit_world(name: str, light: str) -> World:
    """Return a world of the package in a light; raises LabError for unknown names."""
    world = _world(_known(name, WORLDS, "world"))
    source = LIGHTS[_known(light, LIGHTS, "light")]
    if not source:
        return world
    other = _world(source)
    return replace(world, lights=other.lights, ambient=other.ambient, background=other.background)


def _known(name: str, names, what: str) -> str:
    if name not in names:
        raise SceneError(f"there is no {what} '{name}', only {', '.join(names)}")
    return name


@functools.lru_cache(maxsize=None)
def _world(name: str) -> World:
    uri = f"package://bullet_lab/worlds/{name}.world"
    return read_world_file(ResourceFinder.anywhere().find(uri))


def cell_shots(cell: Cell, frames: int, seed: int) -> List[Shot]:
    """Return the camera's places for a cell: jittered, to the left and the right in turn.

    They depend on the cell, the seed and nothing else. The camera looks at the marker, but for
    a little.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=cell.key()))
    return [_shot(cell, (-1.0) ** index, rng) for index in range(frames)]


def strewn_shots(world: str, frames: int, seed: int, block: int) -> List[Shot]:
    """Return places of the camera all over a world, at random distances and bearings."""
    key = (crc32(world.encode()), block)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
    found: List[Shot] = []
    while len(found) < frames:
        cell = Cell(world, "default", rng.uniform(*STREWN_DISTANCES), rng.uniform(*STREWN_BEARINGS))
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
    """Return the camera's pose at a distance (m) and bearing (rad), seen from the marker.

    It looks at the marker, but for `turned` rad to the left, and stands upright.
    """
    x = MARKER[0] - distance * math.cos(bearing)
    y = MARKER[1] + distance * math.sin(bearing)
    return Pose.from_rpy((x, y, CAMERA_HEIGHT), (0.0, 0.0, turned - bearing))


def is_reachable(cell: Cell) -> bool:
    """Tell whether the camera can stand at a cell, on both sides."""
    plan = footprints(lit_world(cell.world, cell.light), below=CAMERA_HEIGHT + CLEARANCE)
    places = [camera_pose(cell.distance, side * cell.bearing).position for side in (-1.0, 1.0)]
    # Straight ahead it comes as near to what bears the marker as it likes.
    plan = [one for one in plan if one.centre[0] <= MARKER[0] - CLEARANCE]
    return all(one.distance(place[:2]) >= CLEARANCE for one in plan for place in places)


def is_visible(cell: Cell) -> bool:
    """Tell whether nothing stands between the camera and the wanted marker, on both sides."""
    boxes = [
        (model.pose * link.pose * shape.pose, shape.geometry)
        for model in lit_world(cell.world, cell.light).models
        for link in model.links
        for shape in link.collisions
        if isinstance(shape.geometry, Box)
    ]
    corners = WORLDS[cell.world].wanted.corners()
    places = [camera_pose(cell.distance, side * cell.bearing).position for side in (-1.0, 1.0)]
    ways = [(np.array(eye), corner) for eye in places for corner in corners]
    return not any(_cuts(pose, box, eye, corner) for pose, box in boxes for eye, corner in ways)


def _cuts(pose: Pose, box: Box, eye: np.ndarray, point: np.ndarray) -> bool:
    """Tell whether the way from an eye to a point leads through a box (the slab method)."""
    turn = pose.rotation_matrix()
    start, end = ((p - pose.position) @ turn for p in (eye, point))
    # Not to the very end: the marker lies on the surface of a box.
    way = 0.999 * (end - start)
    half = 0.5 * np.array(box.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (-half - start) / way, (half - start) / way
    enter = np.nanmax(np.minimum(first, second))
    leave = np.nanmin(np.maximum(first, second))
    return bool(max(enter, 0.0) < min(leave, 1.0))


ROBOT = "package://bullet_lab/urdf/camera_robot.urdf"
NAME = "free_camera"

# Columns: the axes of the optical frame (right, down, ahead) in that of the camera's link.
OPTICAL_AXES = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))


class FreeCamera:
    """Takes pictures in a world with the camera that a robot has, noise included.

    Args:
        world: what there is to see.
        seed: of the noise.

    Raises:
        LabError: a file cannot be read, or the robot has no camera.
    """

    def __init__(self, world: World, seed: int = 0):
        model = camera_alone(read_urdf_file(ResourceFinder.anywhere().find(ROBOT)))
        self._simulation = Simulation(world, seed)
        self._instance = self._simulation.add(model)
        self._device: Camera = self._instance.plugins[0]

    def close(self) -> None:
        """Give everything back."""
        self._simulation.close()

    @property
    def camera(self) -> PinholeCamera:
        """Geometry of the pictures."""
        return self._device.camera

    def take(self, pose: Pose, number: int) -> np.ndarray:
        """Return the picture from a pose, (height, width) of uint8, grey; raises LabError.

        Args:
            pose: of the camera in the world: x ahead, z up.
            number: of the picture, >= 0; its noise follows from this and the seed.
        """
        self._instance.place(pose)
        return grey(self._device.take(number), self._device.encoding)


def camera_alone(robot: Model) -> Model:
    """Return a model of nothing but a robot's camera, in the frame of its link; raises LabError."""
    cameras = [plugin for plugin in robot.plugins if plugin.filename == "libgazebo_ros_camera.so"]
    if not cameras:
        raise SceneError(f"robot '{robot.name}' has no camera")
    plugin = replace(cameras[0], link="camera")
    return Model(NAME, (Link("camera"),), plugins=(plugin,), static=True)


def in_optical_frame(pose: Pose, points: np.ndarray) -> np.ndarray:
    """Return (n, 3) points of the world as a camera at a pose has them: right, down, ahead."""
    inside = (np.asarray(points, dtype=float) - pose.position) @ pose.rotation_matrix()
    return inside @ np.array(OPTICAL_AXES)
