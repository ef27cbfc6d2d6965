"""The pinhole camera with the lens distortion that ROS calls plumb_bob."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

import numpy as np
from numpy import ndarray

from bullet_lab.errors import LabError

# Slope of 87° from the axis; what a lens shows beyond is ignored.
STEEPEST = 20.0
# Newton's method ends after so many steps, or at this error of the seen slope.
MAX_STEPS = 30
CONVERGED = 1e-12
# A slope with a larger error is not found.
FOUND = 1e-6

OPTICAL_AXES = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
"""Columns: the axes of an optical frame (right, down, ahead) in one with x ahead and z up."""


class PinholeError(LabError):
    """The parameters of a camera are invalid."""


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
        """Raise PinholeError if a parameter is invalid."""
        if self.width < 1 or self.height < 1:
            raise PinholeError(f"size {self.width} x {self.height} pixels; both must be >= 1")
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not all(map(math.isfinite, numbers)) or len(self.distortion) != 5:
            raise PinholeError(f"{numbers}; needs 4 intrinsics and 5 distortions, all finite")
        if self.fx <= 0.0 or self.fy <= 0.0:
            raise PinholeError(f"focal lengths {self.fx:g}, {self.fy:g}; both must be > 0")

    @property
    def matrix(self) -> ndarray:
        """The (3, 3) matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: ndarray) -> ndarray:
        """Return the (n, 2) pixels of (n, 3) points of the optical frame.

        The distortion model is that of OpenCV and sensor_msgs/distortion_models. Points that
        are not ahead of the camera give NaN.
        """
        points = np.asarray(points, dtype=float).reshape(-1, 3)
        depth = np.where(points[:, 2] > 0.0, points[:, 2], np.nan)
        seen = points[:, :2] / depth[:, None]
        if any(self.distortion):
            seen = np.column_stack(self._bent(seen[:, 0], seen[:, 1]))
        return seen * (self.fx, self.fy) + (self.cx, self.cy)

    def slopes(self, pixels: ndarray) -> ndarray:
        """Return the slopes x/z and y/z, (n, 2), of the rays of (n, 2) pixels; NaN without a ray.

        The inverse of `project`, by Newton's method. If the distortion folds the picture over,
        there is no ray beyond the fold.

        >>> camera = PinholeCamera(640, 480, 300.0, 300.0, 319.5, 239.5, (-0.3, 0.1, 0, 0, 0))
        >>> camera.slopes(camera.project([[0.5, -0.25, 1.0]])).round(9).tolist()
        [[0.5, -0.25]]
        """
        seen = (np.asarray(pixels, dtype=float).reshape(-1, 2) - (self.cx, self.cy)).T
        seen = seen / np.array((self.fx, self.fy))[:, None]
        if not any(self.distortion):
            return seen.T
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            found = seen * self._straightening(np.hypot(*seen))
            for _ in range(MAX_STEPS):
                missed = np.array(self._bent(*found)) - seen
                if not np.nanmax(np.abs(missed), initial=0.0) > CONVERGED:
                    break
                found = found - self._solved(*found, *missed)
            missed = np.abs(np.array(self._bent(*found)) - seen).max(axis=0)
            return np.where(missed < FOUND, found, np.nan).T

    def _bent(self, x: ndarray, y: ndarray) -> Tuple[ndarray, ndarray]:
        """Return the distorted slopes."""
        k1, k2, p1, p2, k3 = self.distortion
        square = x * x + y * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        u = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
        v = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y
        return u, v

    def _straightening(self, radii: ndarray) -> ndarray:
        """Return slope / distorted slope for the radial distortion alone; NaN beyond the fold."""
        k1, k2, _, _, k3 = self.distortion
        slopes = np.linspace(0.0, STEEPEST, 20_000)
        square = slopes * slopes
        bent = slopes * (1.0 + square * (k1 + square * (k2 + square * k3)))
        rising = np.concatenate(([True], np.diff(bent) > 0.0))
        end = len(rising) if rising.all() else int(np.argmin(rising))
        found = np.interp(radii, bent[:end], slopes[:end], right=np.nan)
        return np.where(radii > 0.0, found / radii, 1.0)

    def _solved(self, x: ndarray, y: ndarray, u: ndarray, v: ndarray) -> Tuple[ndarray, ndarray]:
        """Return the change of the slopes x, y that changes the distorted slopes by u, v."""
        k1, k2, p1, p2, k3 = self.distortion
        square = x * x + y * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        growth = 2.0 * (k1 + square * (2.0 * k2 + square * 3.0 * k3))
        # The derivatives of `_bent`, a symmetric matrix.
        xx = radial + x * x * growth + 2.0 * p1 * y + 6.0 * p2 * x
        yy = radial + y * y * growth + 6.0 * p1 * y + 2.0 * p2 * x
        xy = x * y * growth + 2.0 * p1 * x + 2.0 * p2 * y
        determinant = xx * yy - xy * xy
        return np.array(((yy * u - xy * v) / determinant, (xx * v - xy * u) / determinant))
