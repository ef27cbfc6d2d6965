"""Fits the pose of points that a camera sees, by least squares, weighted by their covariance."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose, Quaternion
from bullet_lab.vision.images import solve_symmetric

_ITERATIONS = 10
# The fit has converged when a step gains less, in squares of standard deviations.
_CONVERGED = 1e-5
# The better of two poses is right if the other one's error is larger by this factor, and by so many
# standard deviations of the corners.
_CLEAR_RATIO = 2.0
_CLEAR_SIGMAS = 3.0


@dataclass(frozen=True, eq=False)
class MarkerPose:
    """Pose of a marker in the optical frame of a camera.

    The marker's frame has x to its right as one looks at it, y up, z out of its face. The
    covariance (6, 6) is of x, y, z and small rotations about the x, y, z of the optical frame, as
    in geometry_msgs/PoseWithCovariance; m² and rad².
    """

    rotation: ndarray  #: (3, 3), from the marker's frame to the optical frame
    translation: ndarray  #: (3,) m, the marker's middle
    #: root mean square of the corners' distances from where the pose puts them, ideal px
    error: float
    covariance: ndarray

    @property
    def quaternion(self) -> Quaternion:
        """The rotation as x, y, z, w."""
        return Pose.from_matrix(tuple(self.translation), self.rotation).quaternion

    @property
    def distance(self) -> float:
        """From the camera to the marker's middle, m."""
        return float(np.linalg.norm(self.translation))


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """The two poses of a flat marker that its corners allow."""

    best: MarkerPose  #: the one that fits better
    alternative: MarkerPose  #: the other one; the same as `best` where there is but one
    ambiguous: bool  #: the corners do not show which is right

    def nearest_to(self, rotation: ndarray) -> MarkerPose:
        """Return the pose that is turned least from a (3, 3) rotation, such as the last."""
        both = self.best, self.alternative
        return max(both, key=lambda pose: float(np.sum(pose.rotation * rotation)))

    def upright(self, up: ndarray, least: float) -> MarkerPose:
        """Return the pose whose y axis is nearer to a direction (3,) of the optical frame.

        A marker on an upright wall has its y axis up: (0, -1, 0) for a level camera. The one that
        fits worse is returned only if the cosine of its angle is larger by more than `least`.
        """
        gain = (self.alternative.rotation[:, 1] - self.best.rotation[:, 1]) @ up
        return self.alternative if gain > least else self.best


class PoseFit:
    """Fits the pose of the corners of markers that are fixed to each other.

    Args:
        points: (4 n, 3) the corners of n markers in their common frame, m.
        corners: (4 n, 2) where they are seen, ideal px.
        covariances: (n, 8, 8) of u0, v0, u1 … of each marker, px².
        camera: geometry of the image; its distortion does not matter.
    """

    def __init__(
        self, points: ndarray, corners: ndarray, covariances: ndarray, camera: PinholeCamera
    ):
        self._points, self._corners, self._camera = points, corners, camera
        # With these matrices the corners' errors become independent ones of 1.
        self._whitening = np.stack([_whitening(one) for one in covariances])

    def refined(self, rotation: ndarray, translation: ndarray) -> tuple[float, MarkerPose] | None:
        """Return the pose of least squares from a start, and its sum of squares; None if none.

        By Levenberg and Marquardt.
        """
        seen, residuals, jacobian = self.whitened(rotation, translation)
        error, damping = float(residuals @ residuals), 1e-6
        for _ in range(_ITERATIONS):
            if not np.isfinite(error):
                return None
            normal = jacobian.T @ jacobian
            damped = normal + damping * np.diag(np.diag(normal))
            step = -solve_symmetric(damped, jacobian.T @ residuals)
            moved = translation + step[:3]
            turned = cv2.Rodrigues(step[3:])[0] @ rotation
            there = self.whitened(turned, moved)
            error_there = float(there[1] @ there[1])
            if not error_there < error:
                damping *= 100.0
                continue
            gain = error - error_there
            rotation, translation, error = turned, moved, error_there
            seen, residuals, jacobian = there
            damping *= 0.1
            if gain < _CONVERGED:
                break
        solved, inverse = cv2.invert(jacobian.T @ jacobian, flags=cv2.DECOMP_CHOLESKY)
        covariance = 0.5 * (inverse + inverse.T) if solved else np.full((6, 6), np.nan)
        distance = float(np.sqrt(2.0 * np.mean(np.square(seen))))
        return error, MarkerPose(rotation, translation, distance, covariance)

    def whitened(self, rotation: ndarray, translation: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        """Return the residuals (8 n,) in px, and them and their derivatives in deviations.

        The derivatives (8 n, 6) are by x, y, z and rotations.
        """
        turned = self._points @ rotation.T
        pixels, by_point = projected(turned + translation, self._camera)
        x, y, z = turned.T
        crosses = np.zeros((len(turned), 3, 3))
        crosses[:, 0, 1], crosses[:, 0, 2], crosses[:, 1, 2] = z, -y, x
        crosses -= np.swapaxes(crosses, 1, 2)
        by_pose = np.concatenate((by_point, by_point @ crosses), axis=2)
        residuals = (pixels - self._corners).ravel()
        scaled = self._whitening @ residuals.reshape(-1, 8, 1)
        jacobian = self._whitening @ by_pose.reshape(-1, 8, 6)
        return residuals, scaled.ravel(), jacobian.reshape(-1, 6)


def _whitening(covariance: ndarray) -> ndarray:
    _, values, vectors = cv2.eigen(covariance)
    return vectors / np.sqrt(np.maximum(values, 1e-9 * values.max()))


def projected(seen: ndarray, camera: PinholeCamera) -> tuple[ndarray, ndarray]:
    """Return ideal pixels (n, 2) of points of the optical frame and their (n, 2, 3) derivatives."""
    x, y = seen[:, 0], seen[:, 1]
    z = np.where(seen[:, 2] > 0.0, seen[:, 2], np.nan)
    u, v = camera.fx * x / z, camera.fy * y / z
    by_point = np.zeros((len(seen), 2, 3))
    by_point[:, 0, 0], by_point[:, 0, 2] = camera.fx / z, -u / z
    by_point[:, 1, 1], by_point[:, 1, 2] = camera.fy / z, -v / z
    return np.column_stack((u + camera.cx, v + camera.cy)), by_point


def clearly_better(best: MarkerPose, other: MarkerPose, sigma: float) -> bool:
    """Return whether the first of two poses is right; corners deviate by `sigma` px."""
    gain = other.error - best.error
    return other.error > _CLEAR_RATIO * best.error and gain > 0.5 * _CLEAR_SIGMAS * sigma
