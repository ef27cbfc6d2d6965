"""The trial of a cell: its images, and their detections compared with the truth."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Tuple

import cv2
import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.studies.detection_range.scenes import (
    DICTIONARY,
    WANTED_ID,
    WORLDS,
    Cell,
    FreeCamera,
    PrintedMarker,
    Shot,
    cell_shots,
    in_optical_frame,
    is_visible,
    strewn_shots,
)
from bullet_lab.studies.worlds import DEFAULT_LIGHT, lit_world
from bullet_lab.vision.marker_detector import DetectorSettings
from bullet_lab.vision.marker_pose import MarkerObserver, ObservedMarker

LARGEST_OFFSET = 0.15
"""Tolerance of a detection's corners as a share of the marker's side, plus one pixel."""

CELLS_PER_SIDE = 8
HIDDEN_SHARE = 0.2


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


@dataclass(frozen=True)
class Snapshot:
    """An image as PNG, and the (n, 4, 2) corners of the markers found in it, in pixels."""

    png: bytes
    corners: np.ndarray


@dataclass(frozen=True)
class CellResult:
    """The detections in a cell of the grid.

    Attributes:
        cell: of the grid.
        visible: whether the marker is not hidden.
        frames: detections in each image.
        pixels_per_cell: mean size of a cell of the marker.
        snapshot: one of the images, if it is kept.
    """

    cell: Cell
    visible: bool
    frames: Tuple[Frame, ...]
    pixels_per_cell: float
    snapshot: Optional[Snapshot] = None

    def rate(self) -> float:
        """Return the share of frames in which the wanted marker was found."""
        return sum(frame.found for frame in self.frames) / len(self.frames)

    def row(self) -> Dict[str, Any]:
        """Return the row of the table; without finds, the errors are None."""
        found = [frame for frame in self.frames if frame.found]
        return {
            "world": self.cell.world,
            "light": self.cell.light,
            "distance_m": self.cell.distance,
            "bearing_deg": round(math.degrees(self.cell.bearing), 6),
            "visible": self.visible,
            "frames": len(self.frames),
            "found": len(found),
            "rate": self.rate(),
            "other_detections": sum(frame.others for frame in self.frames),
            "double_detections": sum(frame.doubles for frame in self.frames),
            "false_detections": sum(frame.false for frame in self.frames),
            "pixels_per_cell": self.pixels_per_cell,
            **_spread("distance_error_m", [frame.distance_error for frame in found]),
            **_spread("lateral_error_m", [frame.lateral_error for frame in found]),
            **_spread("rotation_error_deg", [math.degrees(f.rotation_error) for f in found]),
            "flipped": sum(frame.flipped for frame in found),
        }


def _spread(name: str, values: List[float]) -> Dict[str, Optional[float]]:
    sizes = np.abs(values)
    return {
        f"{name}_median": float(np.median(sizes)) if len(sizes) else None,
        f"{name}_max": float(np.max(sizes)) if len(sizes) else None,
    }


def try_cell(cell: Cell, frames: int, seed: int, keep: bool = False) -> CellResult:
    """Take images of a cell and compare the detections with the truth; raises LabError.

    If the marker is hidden, only `HIDDEN_SHARE` of the frames are taken. With `keep`, the first
    image is returned.
    """
    visible = is_visible(cell)
    count = frames if visible else math.ceil(HIDDEN_SHARE * frames)
    inspection = _inspection(cell.world, cell.light, seed)
    shots = cell_shots(cell, count, seed)
    judged = tuple(inspection.judge(shot) for shot in shots)
    side = float(np.mean([inspection.side(shot.pose) for shot in shots]))
    snapshot = inspection.snapshot(shots[0]) if keep else None
    return CellResult(cell, visible, judged, side / CELLS_PER_SIDE, snapshot)


def count_false(world: str, block: int, frames: int, seed: int) -> Tuple[int, int]:
    """Take images all over a world, in its own light, and count false detections.

    Returns:
        The numbers of false detections, and of images with the marker found.
    """
    inspection = _inspection(world, DEFAULT_LIGHT, seed)
    judged = [inspection.judge(shot) for shot in strewn_shots(world, frames, seed, block)]
    return sum(frame.false for frame in judged), sum(frame.found for frame in judged)


@functools.lru_cache(maxsize=None)
def _inspection(world: str, light: str, seed: int) -> Inspection:
    return Inspection(world, light, seed)


class Inspection:
    """Camera and detector in a world whose markers are known."""

    def __init__(self, world: str, light: str, seed: int):
        self._camera = FreeCamera(lit_world(world, light), seed)
        self._geometry = self._camera.camera
        self._known = WORLDS[world]
        self._observer = MarkerObserver(DetectorSettings(DICTIONARY), self._known.wanted.size)

    def snapshot(self, shot: Shot) -> Snapshot:
        """Take an image and return it with the corners of the markers found."""
        picture, markers = self._observe(shot)
        png = cv2.imencode(".png", picture)[1].tobytes()
        return Snapshot(png, np.array([m.corners for m in markers]).reshape(-1, 4, 2))

    def judge(self, shot: Shot) -> Frame:
        """Take an image and compare the detections with the truth."""
        _, markers = self._observe(shot)
        return judge(markers, shot.pose, self._known.wanted, self._known.others, self._geometry)

    def _observe(self, shot: Shot) -> Tuple[np.ndarray, List[ObservedMarker]]:
        picture = self._camera.take(shot.pose, shot.number)
        return picture, self._observer.observe(picture, self._geometry).markers

    def side(self, pose: Pose) -> float:
        """Return the mean side of the wanted marker in the image, in pixels."""
        corners = in_optical_frame(pose, self._known.wanted.corners())
        return _side(self._geometry.project(corners))


def judge(
    markers: List[ObservedMarker],
    pose: Pose,
    wanted: PrintedMarker,
    others: Tuple[PrintedMarker, ...],
    camera: PinholeCamera,
) -> Frame:
    """Compare the detections in an image with the truth.

    Args:
        markers: detections.
        pose: of the camera in the world.
        wanted: the marker to find.
        others: other markers with the same id.
        camera: geometry of the image.
    """
    hits = [m for m in markers if _is_seen_at(m, wanted, pose, camera)]
    rest = [m for m in markers if not _is_seen_at(m, wanted, pose, camera)]
    known = [m for m in rest if any(_is_seen_at(m, one, pose, camera) for one in others)]
    counts = (len(known), max(0, len(hits) - 1), len(rest) - len(known))
    if not hits:
        return Frame(False, *counts)
    return Frame(True, *counts, **_pose_errors(hits[0], wanted, pose))


def _is_seen_at(
    marker: ObservedMarker, printed: PrintedMarker, pose: Pose, camera: PinholeCamera
) -> bool:
    if marker.id != WANTED_ID:
        return False
    corners = camera.project(in_optical_frame(pose, printed.corners()))
    offsets = np.linalg.norm(np.asarray(marker.corners) - corners, axis=1)
    return bool(np.max(offsets) <= 1.0 + LARGEST_OFFSET * _side(corners))


def _side(corners: np.ndarray) -> float:
    return float(np.mean(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)))


def _pose_errors(marker: ObservedMarker, printed: PrintedMarker, pose: Pose) -> Dict[str, Any]:
    corners = in_optical_frame(pose, printed.corners())
    middle = corners.mean(axis=0)
    right, up = corners[1] - corners[0], corners[0] - corners[3]
    truth = np.column_stack([right, up, np.cross(right, up) / printed.size]) / printed.size
    best, alternative = marker.pose.best, marker.pose.alternative
    distance = float(np.linalg.norm(middle))
    error = np.asarray(best.translation) - middle
    along = float(error @ middle) / distance
    turned, other = (_angle(truth, p.rotation) for p in (best, alternative))
    return {
        "distance_error": float(np.linalg.norm(best.translation)) - distance,
        "lateral_error": math.sqrt(max(0.0, float(error @ error) - along * along)),
        "rotation_error": turned,
        "flipped": other < turned,
    }


def _angle(one: np.ndarray, two: np.ndarray) -> float:
    """Return the angle between two attitudes, (3, 3) each."""
    vector, _ = cv2.Rodrigues(np.asarray(one).T @ np.asarray(two))
    return float(np.linalg.norm(vector))
