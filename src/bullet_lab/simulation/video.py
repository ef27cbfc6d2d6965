"""A video of a simulation, in simulated time."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.errors import LabError
from bullet_lab.simulation.simulation import Simulation, View, take_picture

# Pictures per simulated second; in pixels.
RATE = 20.0
WIDTH, HEIGHT = 960, 540
# VP9, which browsers play as well. OpenCV's wheels can encode no H.264.
CODEC = "vp09"
HORIZONTAL_FOV = math.radians(50.0)
HALF_WIDTH = math.tan(0.5 * HORIZONTAL_FOV)
# m around the models' positions that are in the picture at least.
MARGIN = 0.5
# m; the view changes in steps of this size.
GRID = 0.25
# Where the camera is, seen from the middle of the picture: in the south, so that x is to the
# right; then the axes of the picture in the world.
BACK = np.array([-0.25, -1.0, 0.8]) / math.hypot(0.25, 1.0, 0.8)
RIGHT = np.array([-BACK[1], BACK[0], 0.0]) / math.hypot(BACK[0], BACK[1])
AXES = np.array([RIGHT, np.cross(BACK, RIGHT), BACK])
TRAIL = (60, 160, 255)


class VideoError(LabError):
    """A video cannot be written."""


def overview(low: ndarray, high: ndarray) -> View:
    """Return a view from above in which a box with two opposite corners in m just fits."""
    middle = 0.5 * (low + high)
    corners = np.array(list(itertools.product(*zip(low, high)))) - middle
    across, up, back = AXES @ corners.T
    wide = np.maximum(abs(across), abs(up) * WIDTH / HEIGHT)
    distance = (back + wide / HALF_WIDTH).max()
    eye = middle + distance * BACK
    size = (WIDTH, HEIGHT, HORIZONTAL_FOV)
    return View(tuple(eye.tolist()), tuple(middle.tolist()), *size, far=distance + 100.0)


def pixels_of(points: ndarray, view: View) -> ndarray:
    """Return where points (n, 3) in m in the world are in the picture of a view, (n, 2) int."""
    across, up, back = AXES @ (points - view.eye).T
    focal = 0.5 * WIDTH / HALF_WIDTH
    centred = focal * np.column_stack([across, -up]) / -back[:, np.newaxis]
    return np.rint(centred + (0.5 * WIDTH, 0.5 * HEIGHT)).astype(np.int32)


class Video:
    """Writes what a simulation looks like, with the paths of its models, into an mp4 file.

    The view grows such that all places where a model has been are in it.

    Args:
        simulation: its simulated time is the time of the video.
        path: of the file; its folder is made.

    Raises:
        VideoError: the file cannot be written.
    """

    def __init__(self, simulation: Simulation, path: Path):
        self._simulation = simulation
        self._low = np.full(3, math.inf)
        self._high = np.full(3, -math.inf)
        self._paths: dict[str, list[ndarray]] = {}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise VideoError(f"{path.parent}: {error.strerror}") from error
        fourcc = cv2.VideoWriter_fourcc(*CODEC)
        self._writer = cv2.VideoWriter(str(path), fourcc, RATE, (WIDTH, HEIGHT))
        if not self._writer.isOpened():
            raise VideoError(f"{path}: OpenCV cannot write a video there")
        simulation.every(RATE, self._take)

    def close(self) -> None:
        """Complete the file."""
        self._writer.release()

    def _take(self, _step: int) -> None:
        # Extends the models' paths, and the box in the view to where they are now.
        for name, model in self._simulation.models.items():
            place = np.array(model.pose().position)
            self._paths.setdefault(name, []).append(place)
            self._low = np.minimum(self._low, GRID * np.floor((place - MARGIN) / GRID))
            self._high = np.maximum(self._high, GRID * np.ceil((place + MARGIN) / GRID))
        view = overview(self._low, self._high)
        picture = take_picture(self._simulation, view, samples=2)
        picture = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
        paths = [pixels_of(np.array(path), view) for path in self._paths.values()]
        cv2.polylines(picture, paths, False, TRAIL, 1, cv2.LINE_AA)
        self._writer.write(picture)
