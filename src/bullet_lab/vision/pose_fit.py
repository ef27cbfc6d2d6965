"""Fit of a marker's pose to its corners, and how far off it may be."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.vision.images import (
    homography,
    solve_symmetric,
)

# Top left, top right, bottom right, bottom left corner in the marker's frame, by half its edge.
_SQUARE = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
_ITERATIONS = 10
# The fit has converged when a step gains less, in squares of standard deviations.
_CONVERGED = 1e-5
# Tilts (n, 2) at which the likelihood is evaluated, up to so many standard deviations.
_REACH = 3.5
_TILTS = np.stack(np.meshgrid(*2 * [np.linspace(-_REACH, _REACH, 15)]), axis=-1).reshape(-1, 2)
# The other pose does not matter if it is so many standard deviations away.
_FAR = 16.0


@dataclass(frozen=True, eq=False)
class MarkerPose:
    """Pose of a marker in the optical frame of a camera.

    The marker's frame has x to its right as one looks at it, y up, z out of its face. The
    covariance (6, 6) is of x, y, z and small rotations about the x, y, z of the optical frame, as
    in geometry_msgs/PoseWithCovariance; m² and rad².
    """

    rotation: ndarray  #: (3, 3), from the marker's frame to the optical frame
    translation: ndarray  #: (3,) m, the marker's middle
    error: float  #: root mean square of the corners' distances from where the pose puts them, px
    covariance: ndarray

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """The rotation as x, y, z, w."""
        vector = cv2.Rodrigues(self.rotation)[0].ravel()
        angle = float(np.linalg.norm(vector))
        scale = np.sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
        x, y, z = (float(value) for value in vector * scale)
        return x, y, z, float(np.cos(0.5 * angle))

    @property
    def distance(self) -> float:
        """From the camera to the marker's middle, m."""
        return float(np.linalg.norm(self.translation))


class SquareFit:
    """Fits the pose of a square marker to its corners.

    Args:
        corners: (4, 2) px.
        size: edge of the black square, m.
        camera: geometry of the image.
        covariance: (8, 8) of the corners, px².
    """

    def __init__(
        self, corners: ndarray, size: float, camera: PinholeCamera, covariance: ndarray
    ):
        self._corners, self._camera = corners, camera
        self._points = 0.5 * size * _SQUARE
        # With this matrix the corners' errors become independent ones of 1.
        _, values, vectors = cv2.eigen(covariance)
        self._whitening = vectors / np.sqrt(np.maximum(values, 1e-9 * values.max()))

    def starts(self) -> list[tuple[ndarray, ndarray]]:
        """Return both poses, rotation and translation, by Collins and Bartoli (2014, IPPE).

        (OpenCV's IPPE_SQUARE uses rotation vectors and fails at half turns, which is how a level
        camera sees an upright marker.)
        """
        rays = self._rays()
        size = self._points[1, 0] - self._points[0, 0]
        from_plane = np.array([[1.0 / size, 0.0, 0.5], [0.0, -1.0 / size, 0.5], [0.0, 0.0, 1.0]])
        plane = homography(rays) @ from_plane
        plane = plane / plane[2, 2]
        middle = plane[:2, 2]
        # How the image moves with the plane about its middle.
        by_plane = plane[:2, :2] - np.outer(middle, plane[2, :2])
        to_middle = _rotation_to(np.array([*middle, 1.0]))
        by_space = np.column_stack((np.eye(2), -middle)) @ to_middle
        (a, b), (c, d) = by_space[:, :2]
        scaled = np.array([[d, -b], [-c, a]]) @ by_plane / (a * d - b * c)
        upper = scaled / _largest_singular_value(scaled)
        rest = np.eye(2) - upper.T @ upper
        lower = np.sqrt(np.maximum(0.0, np.diag(rest)))
        if rest[0, 1] < 0.0:
            lower[1] = -lower[1]
        poses = []
        for sign in (1.0, -1.0):
            columns = np.vstack((upper, sign * lower))
            local = np.column_stack((columns, np.cross(columns[:, 0], columns[:, 1])))
            # The nearest rotation to a matrix that is nearly one.
            _, left, right = cv2.SVDecomp(to_middle @ local)
            rotation = left @ right
            poses.append((rotation, _translation(self._points @ rotation.T, rays)))
        return poses

    def refined(
        self, rotation: ndarray, translation: ndarray
    ) -> tuple[float, MarkerPose] | None:
        """Return the pose of least squares from a start, and its sum of squares; None if none.

        By Levenberg and Marquardt.
        """
        seen, residuals, jacobian = self._whitened(rotation, translation)
        error, damping = float(residuals @ residuals), 1e-6
        for _ in range(_ITERATIONS):
            if not np.isfinite(error):
                return None
            normal = jacobian.T @ jacobian
            damped = normal + damping * np.diag(np.diag(normal))
            step = -solve_symmetric(damped, jacobian.T @ residuals)
            moved = translation + step[:3]
            turned = cv2.Rodrigues(step[3:])[0] @ rotation
            there = self._whitened(turned, moved)
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
        covariance = _inverse(jacobian.T @ jacobian)
        distance = float(np.sqrt(seen @ seen / 4.0))
        return error, MarkerPose(rotation, translation, distance, covariance)

    def widened(self, pose: MarkerPose, other: MarkerPose) -> MarkerPose:
        """Return a pose with the mean squares of its error as covariance.

        How a marker that faces the camera looks changes with the square of its tilt: equally likely
        tilts form no ellipse, and the estimate is not in their middle. So the likelihood is summed
        over both tilts, up to half way to the other pose, with every angle between the marker's
        axis and the line of sight equally likely before; all else follows the tilts to first order.

        Args:
            pose: its covariance is the inverse of the curvature.
            other: the other pose that the corners allow, or the same.
        """
        turn = cv2.Rodrigues(other.rotation @ pose.rotation.T)[0].ravel()
        covariance = pose.covariance
        sight = pose.translation / np.linalg.norm(pose.translation)
        across = np.linalg.svd(sight[None])[2][1:]
        of_tilts = across @ covariance[3:, 3:] @ across.T
        away = across @ turn
        if not np.linalg.det(of_tilts) > 0.0 or away @ away > _FAR**2 * np.trace(of_tilts):
            return pose
        scale = np.linalg.cholesky(of_tilts + np.outer(away, away) / (2.0 * _REACH) ** 2)
        tilts = _TILTS @ scale.T
        tilts = tilts[tilts @ away <= 0.5 * (away @ away)]
        along = covariance[:, 3:] @ across.T @ np.linalg.inv(of_tilts)
        moves, squares = self._followed(pose, tilts @ along.T)
        facing = across @ np.cross(sight, pose.rotation[:, 2])
        likely = np.exp(-0.5 * (squares - squares.min()))
        likely /= np.hypot(np.hypot(*(tilts - facing).T), math.sqrt(np.trace(of_tilts)))
        beside = covariance - along @ of_tilts @ along.T
        squares = beside + (moves.T * (likely / likely.sum())) @ moves
        return replace(pose, covariance=squares) if np.isfinite(squares).all() else pose

    def _followed(self, pose: MarkerPose, moves: ndarray) -> tuple[ndarray, ndarray]:
        """Return moves (n, 6) with the best place and roll for their tilts, and squares (n,)."""
        residuals = self._moved_residuals(pose, moves) @ self._whitening.T
        _, jacobian = self._linearised(pose.rotation, pose.translation)
        free = np.zeros((6, 4))
        free[:3, :3] = np.eye(3)
        free[3:, 3] = pose.translation / np.linalg.norm(pose.translation)
        basis, upper = np.linalg.qr(self._whitening @ jacobian @ free)
        in_basis = residuals @ basis
        squares = np.square(residuals).sum(axis=1) - np.square(in_basis).sum(axis=1)
        return moves - in_basis @ np.linalg.inv(upper).T @ free.T, squares

    def _moved_residuals(self, pose: MarkerPose, moves: ndarray) -> ndarray:
        """Return the residuals (n, 8), px, of a pose that is moved by (n, 6)."""
        turned = self._points @ pose.rotation.T
        angles = np.linalg.norm(moves[:, 3:], axis=1)
        axes = moves[:, 3:] / np.maximum(angles, 1e-12)[:, None]
        # Rodrigues' formula.
        sine, cosine = (np.reshape(f(angles), (-1, 1, 1)) for f in (np.sin, np.cos))
        axes = axes[:, None]
        points = cosine * turned + sine * np.cross(axes, turned)
        points += (1.0 - cosine) * (axes * turned).sum(axis=2, keepdims=True) * axes
        points += (pose.translation + moves[:, :3])[:, None]
        pixels, _ = _projected(points.reshape(-1, 3), self._camera)
        return pixels.reshape(len(moves), 8) - self._corners.ravel()

    def _whitened(
        self, rotation: ndarray, translation: ndarray
    ) -> tuple[ndarray, ndarray, ndarray]:
        """Return the residuals (8,) in px, and them and their derivatives in deviations."""
        residuals, jacobian = self._linearised(rotation, translation)
        return residuals, self._whitening @ residuals, self._whitening @ jacobian

    def _linearised(
        self, rotation: ndarray, translation: ndarray
    ) -> tuple[ndarray, ndarray]:
        """Return the residuals (8,), px, and their derivatives (8, 6) by x, y, z and rotations."""
        turned = self._points @ rotation.T
        pixels, by_point = _projected(turned + translation, self._camera)
        x, y, z = turned.T
        crosses = np.zeros((4, 3, 3))
        crosses[:, 0, 1], crosses[:, 0, 2], crosses[:, 1, 2] = z, -y, x
        crosses -= np.swapaxes(crosses, 1, 2)
        jacobian = np.concatenate((by_point, by_point @ crosses), axis=2).reshape(8, 6)
        return (pixels - self._corners).ravel(), jacobian

    def _rays(self) -> ndarray:
        """Return the (4, 2) corners on the plane one ahead of an ideal camera."""
        corners, camera = self._corners, self._camera
        if not any(camera.distortion):
            return (corners - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-8)
        distortion = np.array(camera.distortion)
        rays = cv2.undistortPointsIter(
            corners[:, None], camera.matrix, distortion, None, None, criteria
        )
        return rays[:, 0]


def _inverse(matrix: ndarray) -> ndarray:
    """Return the inverse of a positive definite (n, n) matrix; NaN if it is not."""
    solved, inverse = cv2.invert(matrix, flags=cv2.DECOMP_CHOLESKY)
    return 0.5 * (inverse + inverse.T) if solved else np.full(matrix.shape, np.nan)


def _largest_singular_value(matrix: ndarray) -> float:
    """Return the largest singular value of a (2, 2) matrix."""
    (a, b), (c, d) = matrix
    square, determinant = float(a * a + b * b + c * c + d * d), float(a * d - b * c)
    rest = max(0.0, square * square - 4.0 * determinant * determinant)
    return float(np.sqrt(0.5 * (square + np.sqrt(rest))))


def _rotation_to(direction: ndarray) -> ndarray:
    """Return the least rotation that turns the z axis to a direction with z > 0."""
    x, y, z = direction / np.linalg.norm(direction)
    return np.array(
        [
            [1.0 - x * x / (1.0 + z), -x * y / (1.0 + z), x],
            [-x * y / (1.0 + z), 1.0 - y * y / (1.0 + z), y],
            [-x, -y, z],
        ]
    )


def _translation(turned: ndarray, rays: ndarray) -> ndarray:
    """Return the translation (least squares) that puts turned points on their rays."""
    a = np.zeros((8, 3))
    a[0::2, 0] = a[1::2, 1] = 1.0
    a[:, 2] = -rays.ravel()
    return solve_symmetric(a.T @ a, a.T @ (rays * turned[:, 2:] - turned[:, :2]).ravel())


def _projected(seen: ndarray, camera: PinholeCamera) -> tuple[ndarray, ndarray]:
    """Return the pixels (n, 2) of points of the optical frame and their (n, 2, 3) derivatives."""
    if not any(camera.distortion):
        x, y = seen[:, 0], seen[:, 1]
        z = np.where(seen[:, 2] > 0.0, seen[:, 2], np.nan)
        u, v = camera.fx * x / z, camera.fy * y / z
        by_point = np.zeros((len(seen), 2, 3))
        by_point[:, 0, 0], by_point[:, 0, 2] = camera.fx / z, -u / z
        by_point[:, 1, 1], by_point[:, 1, 2] = camera.fy / z, -v / z
        return np.column_stack((u + camera.cx, v + camera.cy)), by_point
    # By central differences through the lens.
    step = 1e-6 * float(np.abs(seen[:, 2]).mean())
    shifts = step * np.vstack((np.zeros(3), np.eye(3), -np.eye(3)))
    pixels = camera.project((seen[:, None] + shifts).reshape(-1, 3)).reshape(len(seen), 7, 2)
    by_point = np.swapaxes((pixels[:, 1:4] - pixels[:, 4:]) / (2.0 * step), 1, 2)
    return pixels[:, 0], by_point
