"""The trial of a cell: worlds, camera poses, images, and their detections beside the truth."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Sequence
from zlib import crc32

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.core.pinhole import OPTICAL_AXES, PinholeCamera
from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.physics import pybullet
from bullet_lab.simulation.plugins.camera import Camera
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Link, Model, footprints
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.urdf import read_urdf_file
from bullet_lab.studies.study import Record
from bullet_lab.studies.worlds import DEFAULT_LIGHT, ROBOT, lit_world
from bullet_lab.vision.images import grey, mean_side
from bullet_lab.vision.marker_detector import DetectorSettings
from bullet_lab.vision.marker_pose import MarkerObserver, ObservedMarker

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

LARGEST_OFFSET = 0.15
"""Tolerance of a detection's corners as a share of the marker's side, plus one pixel."""

CELLS_PER_SIDE = 8
HIDDEN_SHARE = 0.2


@dataclass(frozen=True)
class PrintedMarker:
    """A marker of the wanted id in a world: edge (m) and centre; it faces -x."""

    size: float
    middle: Vector

    def corners(self) -> ndarray:
        """Return the (4, 3) corners: top left, top right, bottom right, bottom left."""
        # For a view along x, +y is to the left.
        offsets = np.array([(0, 1, 1), (0, -1, 1), (0, -1, -1), (0, 1, -1)], dtype=float)
        return np.asarray(self.middle) + 0.5 * self.size * offsets


WANTED = PrintedMarker(0.20, MARKER)
WORLDS: dict[str, tuple[PrintedMarker, ...]] = {
    "marker_panel": (WANTED,),
    "docking": (WANTED,),
    "docking_dots": (WANTED,),
    "docking_nested": (PrintedMarker(0.075, MARKER), PrintedMarker(0.8, (4.0, 0.05, 0.45))),
    "docking_decoy": (WANTED, PrintedMarker(0.35, (3.3, 1.65, 0.5))),
}
"""The wanted marker of each world, and other markers with the same id."""


@dataclass(frozen=True)
class Cell:
    """A cell of the grid: world, light, distance to the marker (m), bearing (rad, >= 0).

    The bearing is the angle at the marker between its axis and the camera.
    """

    world: str
    light: str
    distance: float
    bearing: float

    def key(self) -> tuple[int, ...]:
        """Return numbers that are unique to this cell, for its random stream."""
        words = (crc32(self.world.encode()), crc32(self.light.encode()))
        return (*words, round(1e6 * self.distance), round(1e6 * self.bearing))


class CameraShot(NamedTuple):
    """A pose of the camera, and the number of its image."""

    pose: Pose
    number: int


def cell_shots(cell: Cell, frames: int, seed: int) -> list[CameraShot]:
    """Return jittered camera poses for a cell, on the left and the right side in turn.

    They depend on the cell and the seed only. The camera faces the marker, with a small error.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=cell.key()))
    return [_shot(cell, (-1.0) ** index, rng) for index in range(frames)]


def strewn_shots(world: str, frames: int, seed: int, block: int) -> list[CameraShot]:
    """Return camera poses all over a world, at random distances and bearings."""
    key = (crc32(world.encode()), block)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
    found: list[CameraShot] = []
    while len(found) < frames:
        distance, bearing = rng.uniform(*STREWN_DISTANCES), rng.uniform(*STREWN_BEARINGS)
        cell = Cell(world, DEFAULT_LIGHT, distance, bearing)
        if is_reachable(cell):
            found.append(_shot(cell, rng.choice((-1.0, 1.0)), rng, STREWN_HEADING))
    return found


def _shot(
    cell: Cell, side: float, rng: np.random.Generator, astray: float = HEADING_JITTER
) -> CameraShot:
    share, most = DISTANCE_JITTER
    reach = min(share * cell.distance, most)
    off, aside, turned = rng.uniform(-1.0, 1.0, 3) * (reach, BEARING_JITTER, astray)
    bearing = side * cell.bearing + aside
    return CameraShot(camera_pose(cell.distance + off, bearing, turned), int(rng.integers(2**31)))


def camera_pose(distance: float, bearing: float, turned: float = 0.0) -> Pose:
    """Return the camera's pose at a distance (m) and bearing (rad) from the marker.

    It is level, and faces the marker except for `turned` rad to the left.
    """
    x = MARKER[0] - distance * math.cos(bearing)
    y = MARKER[1] + distance * math.sin(bearing)
    return Pose.from_rpy((x, y, CAMERA_HEIGHT), (0.0, 0.0, turned - bearing))


def _places(cell: Cell) -> list[Vector]:
    """Return the positions of the camera at a cell, on both sides."""
    return [camera_pose(cell.distance, side * cell.bearing).position for side in (-1.0, 1.0)]


def is_reachable(cell: Cell) -> bool:
    """Return whether there is room for the camera at a cell, on both sides."""
    plan = footprints(lit_world(cell.world, cell.light), below=CAMERA_HEIGHT + CLEARANCE)
    # The camera may come close to the wall that bears the marker.
    plan = [one for one in plan if one.pose[0] <= MARKER[0] - CLEARANCE]
    return all(one.distance(place[:2]) >= CLEARANCE for one in plan for place in _places(cell))


class FreeCamera:
    """The camera of the robot, with noise from a seed, at any pose in a world in one of `LIGHTS`.

    `camera` is the geometry of its images; `printed` has the wanted marker, and others with its id.
    Raises LabError if a file cannot be read.
    """

    def __init__(self, world: str, light: str = DEFAULT_LIGHT, seed: int = 0):
        self.printed = WORLDS[world]
        robot = read_urdf_file(ResourceFinder.anywhere().find(ROBOT))
        plugin = next(p for p in robot.plugins if p.filename in Camera.filenames)
        plugin = replace(plugin, link="camera")
        model = Model("free_camera", (Link("camera"),), plugins=(plugin,), static=True)
        self._simulation = Simulation(lit_world(world, light), seed)
        self._instance = self._simulation.add(model)
        self._device: Camera = self._instance.plugins[0]
        self.camera: PinholeCamera = self._device.camera

    def sees(self, eye: Vector, points: ndarray) -> bool:
        """Return whether nothing hides any of the points (m), shape (n, 3), from a place (m)."""
        # Not to the very end: the marker lies on the surface of a box.
        ends = np.asarray(eye) + 0.999 * (points - eye)
        client = self._simulation.client
        hits = pybullet.rayTestBatch([eye] * len(ends), ends.tolist(), physicsClientId=client)
        return all(body < 0 for body, *_ in hits)

    def take(self, pose: Pose, number: int) -> ndarray:
        """Return an image from a pose (x ahead, z up), (h, w) uint8, grey; raises LabError.

        Its noise follows from its number, >= 0, and the seed.
        """
        self._instance.place(pose)
        return grey(self._device.take(number), self._device.encoding)

    def observed(self, shot: CameraShot) -> tuple[ndarray, list[ObservedMarker]]:
        """Take an image and return it with the markers found."""
        observer = MarkerObserver(DetectorSettings(DICTIONARY), self.printed[0].size)
        picture = self.take(*shot)
        return picture, observer.observe(picture, self.camera).markers

    def judged(self, shot: CameraShot) -> Frame:
        """Take an image and compare the detections in it with the truth."""
        return judge(self.observed(shot)[1], shot.pose, self.printed, self.camera)


def in_optical_frame(pose: Pose, points: ndarray) -> ndarray:
    """Return (n, 3) points of the world in the optical frame of a camera: right, down, ahead."""
    inside = (np.asarray(points, dtype=float) - pose.position) @ pose.rotation_matrix()
    return inside @ OPTICAL_AXES


@dataclass(frozen=True)
class Frame:
    """The detections in one image.

    Attributes:
        found: whether the wanted marker was detected.
        others: detections of the other markers with its id.
        doubles: further detections of the wanted marker.
        false: detections where there is no marker.
        distance_error: m, of the marker's centre; measured minus true; NaN if it was not found.
        lateral_error: m, likewise, across the line of sight.
        rotation_error: rad, angle between measured and true attitude.
        flipped: whether the other of the two possible attitudes was nearer to the truth.
    """

    found: bool
    others: int = 0
    doubles: int = 0
    false: int = 0
    distance_error: float = math.nan
    lateral_error: float = math.nan
    rotation_error: float = math.nan
    flipped: bool = False


class MarkerImage(NamedTuple):
    """An image, (h, w) uint8 grey, and the (n, 4, 2) corners of the markers found in it, px."""

    picture: ndarray
    corners: ndarray


def cell_row(
    cell: Cell, visible: bool, frames: Sequence[Frame], pixels_per_cell: float
) -> Record:
    """Return the row of a cell in the table from the detections in its images.

    Without finds, the errors are None.
    """
    found = [frame for frame in frames if frame.found]
    return {
        "world": cell.world,
        "light": cell.light,
        "distance_m": cell.distance,
        "bearing_deg": round(math.degrees(cell.bearing), 6),
        "visible": visible,
        "frames": len(frames),
        "found": len(found),
        "rate": len(found) / len(frames),
        "other_detections": sum(frame.others for frame in frames),
        "double_detections": sum(frame.doubles for frame in frames),
        "false_detections": sum(frame.false for frame in frames),
        "pixels_per_cell": pixels_per_cell,
        **_spread("distance_error_m", [frame.distance_error for frame in found]),
        **_spread("lateral_error_m", [frame.lateral_error for frame in found]),
        **_spread("rotation_error_deg", [math.degrees(f.rotation_error) for f in found]),
        "flipped": sum(frame.flipped for frame in found),
    }


def _spread(name: str, values: list[float]) -> dict[str, float | None]:
    sizes = np.abs(values)
    return {
        f"{name}_median": float(np.median(sizes)) if len(sizes) else None,
        f"{name}_max": float(np.max(sizes)) if len(sizes) else None,
    }


def try_cell(
    cell: Cell, frames: int, seed: int, keep: bool = False
) -> tuple[Record, MarkerImage | None]:
    """Take images of a cell and compare the detections with the truth; raises LabError.

    If the marker is hidden, only `HIDDEN_SHARE` of the frames are taken. Returns the row of the
    table, and the first image if it is to be kept.
    """
    camera = _free_camera(cell.world, cell.light, seed)
    corners = camera.printed[0].corners()
    visible = all(camera.sees(place, corners) for place in _places(cell))
    shots = cell_shots(cell, frames if visible else math.ceil(HIDDEN_SHARE * frames), seed)
    judged = [camera.judged(shot) for shot in shots]
    seen = [camera.camera.project(in_optical_frame(shot.pose, corners)) for shot in shots]
    pixels_per_cell = float(np.mean(mean_side(np.stack(seen)))) / CELLS_PER_SIDE
    row = cell_row(cell, visible, judged, pixels_per_cell)
    if not keep:
        return row, None
    picture, markers = camera.observed(shots[0])
    return row, MarkerImage(picture, np.array([m.corners for m in markers]).reshape(-1, 4, 2))


def count_false(world: str, block: int, frames: int, seed: int) -> tuple[int, int]:
    """Take images all over a world, in its own light, and count false detections.

    Returns their number, and that of the images with the marker found.
    """
    camera = _free_camera(world, DEFAULT_LIGHT, seed)
    judged = [camera.judged(shot) for shot in strewn_shots(world, frames, seed, block)]
    return sum(frame.false for frame in judged), sum(frame.found for frame in judged)


@functools.lru_cache
def _free_camera(world: str, light: str, seed: int) -> FreeCamera:
    return FreeCamera(world, light, seed)


def judge(
    markers: list[ObservedMarker],
    pose: Pose,
    printed: Sequence[PrintedMarker],
    camera: PinholeCamera,
) -> Frame:
    """Compare the detections in an image from a pose in the world with the truth.

    The first marker that is printed is the wanted one; the others have the same id.
    """
    wanted, *others = printed

    def is_at(marker: ObservedMarker, one: PrintedMarker) -> bool:
        corners = camera.project(in_optical_frame(pose, one.corners()))
        farthest = np.linalg.norm(marker.corners - corners, axis=1).max()
        is_near = farthest <= 1.0 + LARGEST_OFFSET * mean_side(corners)
        return marker.id == WANTED_ID and bool(is_near)

    hits = [m for m in markers if is_at(m, wanted)]
    rest = [m for m in markers if not is_at(m, wanted)]
    known = [m for m in rest if any(is_at(m, one) for one in others)]
    counts = (len(known), max(0, len(hits) - 1), len(rest) - len(known))
    if not hits:
        return Frame(False, *counts)
    return Frame(True, *counts, **_pose_errors(hits[0], wanted, pose))


def _pose_errors(marker: ObservedMarker, printed: PrintedMarker, pose: Pose) -> dict[str, Any]:
    corners = in_optical_frame(pose, printed.corners())
    middle = corners.mean(axis=0)
    right, up = corners[1] - corners[0], corners[0] - corners[3]
    truth = np.column_stack([right, up, np.cross(right, up) / printed.size]) / printed.size
    best, distance = marker.pose.best, float(np.linalg.norm(middle))
    error = best.translation - middle
    along = float(error @ middle) / distance
    turned, other = (
        float(np.linalg.norm(cv2.Rodrigues(truth.T @ one.rotation)[0]))
        for one in (best, marker.pose.alternative)
    )
    return {
        "distance_error": best.distance - distance,
        "lateral_error": math.sqrt(max(0.0, float(error @ error) - along * along)),
        "rotation_error": turned,
        "flipped": other < turned,
    }
