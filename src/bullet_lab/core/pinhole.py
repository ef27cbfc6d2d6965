"""The pinhole camera with the lens distortion that ROS calls plumb_bob."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

import numpy as np

from bullet_lab.errors import LabError


class PinholeError(LabError):
    """Numbers that make no camera."""


@dataclass(frozen=True)
class PinholeCamera:
    """Geometry of an image.

    Pixel coordinates are OpenCV's: the centre of the top left pixel is (0, 0). Points are given
    in the optical frame of REP 103: x right, y down, z ahead.

    Attributes:
        width: of the image, in pixels.
        height: of the image, in pixels.
        fx: focal length along the rows, in pixels.
        fy: focal length along the columns, in pixels.
        cx: column of the principal point.
        cy: row of the principal point.
        distortion: k1, k2, p1, p2, k3 as in OpenCV.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Raise PinholeError where the numbers make no camera."""
        if self.width < 1 or self.height < 1:
            raise PinholeError(f"an image of {self.width} x {self.height} pixels")
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not all(map(math.isfinite, numbers)) or len(self.distortion) != 5:
            raise PinholeError("the camera's numbers are not finite, or not 5 of distortion")
        if self.fx <= 0.0 or self.fy <= 0.0:
            raise PinholeError(f"focal lengths of {self.fx:g} and {self.fy:g} pixels")

    @property
    def matrix(self) -> np.ndarray:
        """The (3, 3) matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: np.ndarray) -> np.ndarray:
        """Return the (n, 2) pixels where (n, 3) points of the optical frame are seen.

        The distortion model is that of OpenCV and sensor_msgs/distortion_models. Points that
        are not ahead of the camera give NaN.
        """
        points = np.asarray(points, dtype=float).reshape(-1, 3)
        depth = np.where(points[:, 2] > 0.0, points[:, 2], np.nan)
        x, y = points[:, 0] / depth, points[:, 1] / depth
        k1, k2, p1, p2, k3 = self.distortion
        square = x * x + y * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        u = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
        v = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y
        return np.column_stack((self.fx * u + self.cx, self.fy * v + self.cy))
