"""Where a marker is: both poses that its corners allow, and how well they are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Tuple

import cv2
import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.vision.algebra import (
    homography,
    invert_symmetric,
    largest_singular_value,
    least_squares,
    nearest_rotation,
    solve_symmetric,
)
from bullet_lab.vision.images import VisionError

# Two poses are told apart if the worse one fits so much worse, and by more than the corners'
# own error.
_CLEAR_RATIO = 2.0
_CLEAR_SIGMAS = 3.0
_ITERATIONS = 10
# px²; corners that span less are no marker's.
_LEAST_AREA = 1.0
# px²; a step that gains less changes nothing any more.
_CONVERGED = 1e-6


@dataclass(frozen=True, eq=False)
class MarkerPose:
    """Pose of a marker in the optical frame of a camera.

    The marker's frame has x to its right as one looks at it, y up, z out of its face.

    Attributes:
        rotation: (3, 3), from the marker's frame to the optical frame.
        translation: (3,) m, the marker's middle.
        error: root mean square of the corners' distances from where the pose puts them, px.
        covariance: (6, 6) of x, y, z and small rotations about the x, y, z of the optical
            frame, as in geometry_msgs/PoseWithCovariance; m² and rad².
    """

    rotation: np.ndarray
    translation: np.ndarray
    error: float
    covariance: np.ndarray

    @property
    def quaternion(self) -> Tuple[float, float, float, float]:
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


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """The two poses of a flat marker that its corners allow.

    Attributes:
        best: the one that fits better.
        alternative: the other one; the same as `best` where there is but one.
        ambiguous: the corners do not tell which is right.
    """

    best: MarkerPose
    alternative: MarkerPose
    ambiguous: bool

    def nearest_to(self, rotation: np.ndarray) -> MarkerPose:
        """Return the pose that is turned least against a (3, 3) rotation, such as the last."""
        both = self.best, self.alternative
        return max(both, key=lambda pose: float(np.sum(pose.rotation * rotation)))

    def upright(self, up: np.ndarray, least: float = 0.0) -> MarkerPose:
        """Return the pose whose y axis is nearer a direction (3,) of the optical frame.

        A marker on an upright wall has its y axis up: (0, -1, 0) for a level camera. The one that
        fits worse is returned only if the cosine of its angle is larger by `least`.
        """
        gain = (self.alternative.rotation[:, 1] - self.best.rotation[:, 1]) @ np.asarray(up)
        return self.alternative if gain > least else self.best


def estimate_pose(
    corners: np.ndarray, size: float, camera: PinholeCamera, pixel_sigma: float = 0.1
) -> PoseEstimate:
    """Return the poses of a marker from its corners.

    The two poses are those of Collins and Bartoli (2014, IPPE), each refined to the least
    squares of the reprojection error by Gauss and Newton.

    Args:
        corners: (4, 2) u, v in px: top left, top right, bottom right, bottom left.
        size: edge of the black square, m.
        camera: geometry of the image; of a rectified one without distortion.
        pixel_sigma: standard deviation of each coordinate of a corner, px; scales the covariance.

    Raises:
        VisionError: the numbers make no marker, or no pose fits.
    """
    corners = np.asarray(corners, dtype=float)
    if corners.shape != (4, 2) or not np.isfinite(corners).all():
        raise VisionError("a marker has four finite corners")
    if not (np.isfinite(size) and size > 0.0 and np.isfinite(pixel_sigma) and pixel_sigma > 0.0):
        raise VisionError(f"a marker of {size} m with corners to {pixel_sigma} px")
    if abs(_area(corners)) < _LEAST_AREA:
        raise VisionError("the corners of a marker are not four")
    points = square_corners(size)
    rays = _undistorted(corners, camera)
    starts = _both_poses(points, rays)
    poses = [_refined(r, t, points, corners, camera, pixel_sigma) for r, t in starts]
    poses = sorted((p for p in poses if p is not None), key=lambda pose: pose.error)
    if not poses:
        raise VisionError("no pose fits the corners")
    best, other = poses[0], poses[-1]
    return PoseEstimate(best, other, _is_ambiguous(best, other, pixel_sigma))


def square_corners(size: float) -> np.ndarray:
    """Return the (4, 3) corners of a marker in its frame: top left, right, bottom right, left."""
    half = 0.5 * size
    return half * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])


def _area(corners: np.ndarray) -> float:
    """Return the area of a quadrilateral, from its diagonals, px²."""
    (ax, ay), (bx, by) = corners[2] - corners[0], corners[3] - corners[1]
    return 0.5 * float(ax * by - ay * bx)


def _undistorted(corners: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """Return the (4, 2) corners on the plane one ahead of an ideal camera."""
    if not any(camera.distortion):
        return (corners - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-8)
    distortion = np.array(camera.distortion)
    points = corners[:, None]
    return cv2.undistortPointsIter(points, camera.matrix, distortion, None, None, criteria)[:, 0]


def _both_poses(points: np.ndarray, rays: np.ndarray) -> List[Tuple[np.ndarray, np.ndarray]]:
    """Return both poses by which the middle of a square looks as it does, in closed form.

    (OpenCV's IPPE_SQUARE goes through rotation vectors and fails at half turns, which is what
    an upright marker before a level camera is.)
    """
    size = points[1, 0] - points[0, 0]
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
    upper = scaled / largest_singular_value(scaled)
    rest = np.eye(2) - upper.T @ upper
    lower = np.sqrt(np.maximum(0.0, np.diag(rest)))
    if rest[0, 1] < 0.0:
        lower[1] = -lower[1]
    poses = []
    for sign in (1.0, -1.0):
        columns = np.vstack((upper, sign * lower))
        local = np.column_stack((columns, np.cross(columns[:, 0], columns[:, 1])))
        rotation = nearest_rotation(to_middle @ local)
        poses.append((rotation, _translation(points @ rotation.T, rays)))
    return poses


def _rotation_to(direction: np.ndarray) -> np.ndarray:
    """Return the least rotation that turns the z axis to a direction with z > 0."""
    x, y, z = direction / np.linalg.norm(direction)
    return np.array(
        [
            [1.0 - x * x / (1.0 + z), -x * y / (1.0 + z), x],
            [-x * y / (1.0 + z), 1.0 - y * y / (1.0 + z), y],
            [-x, -y, z],
        ]
    )


def _translation(turned: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Return the translation (least squares) that puts turned points on their rays."""
    a = np.zeros((8, 3))
    a[0::2, 0] = a[1::2, 1] = 1.0
    a[:, 2] = -rays.ravel()
    b = (rays * turned[:, 2:] - turned[:, :2]).ravel()
    return least_squares(a, b)


def _refined(
    rotation: np.ndarray,
    translation: np.ndarray,
    points: np.ndarray,
    corners: np.ndarray,
    camera: PinholeCamera,
    sigma: float,
) -> Optional[MarkerPose]:
    """Return the pose of least reprojection error from a start (Levenberg and Marquardt)."""
    residuals, jacobian = _linearised(rotation, translation, points, corners, camera)
    error, damping = float(residuals @ residuals), 1e-6
    for _ in range(_ITERATIONS):
        if not np.isfinite(error):
            return None
        normal = jacobian.T @ jacobian
        damped = normal + damping * np.diag(np.diag(normal))
        step = -solve_symmetric(damped, jacobian.T @ residuals)
        moved = translation + step[:3]
        turned = cv2.Rodrigues(step[3:])[0] @ rotation
        residuals_there, jacobian_there = _linearised(turned, moved, points, corners, camera)
        error_there = float(residuals_there @ residuals_there)
        if not error_there < error:
            damping *= 100.0
            continue
        gain = error - error_there
        rotation, translation, error = turned, moved, error_there
        residuals, jacobian = residuals_there, jacobian_there
        damping *= 0.1
        if gain < _CONVERGED:
            break
    covariance = sigma**2 * invert_symmetric(jacobian.T @ jacobian)
    return MarkerPose(rotation, translation, float(np.sqrt(error / 4.0)), covariance)


def _linearised(
    rotation: np.ndarray,
    translation: np.ndarray,
    points: np.ndarray,
    corners: np.ndarray,
    camera: PinholeCamera,
) -> Tuple[np.ndarray, np.ndarray]:
    """Return the (8,) residuals in px and their (8, 6) derivatives by x, y, z and rotations."""
    turned = points @ rotation.T
    pixels, by_point = _projected(turned + translation, camera)
    crosses = np.zeros((4, 3, 3))
    crosses[:, 0, 1], crosses[:, 0, 2], crosses[:, 1, 2] = turned[:, 2], -turned[:, 1], turned[:, 0]
    crosses -= np.swapaxes(crosses, 1, 2)
    jacobian = np.concatenate((by_point, by_point @ crosses), axis=2).reshape(8, 6)
    return (pixels - corners).ravel(), jacobian


def _projected(seen: np.ndarray, camera: PinholeCamera) -> Tuple[np.ndarray, np.ndarray]:
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


def _is_ambiguous(best: MarkerPose, other: MarkerPose, sigma: float) -> bool:
    if other is best or np.sum(best.rotation * other.rotation) > 3.0 - 1e-4:
        return False
    clear = other.error > _CLEAR_RATIO * best.error
    return not (clear and other.error - best.error > 0.5 * _CLEAR_SIGMAS * sigma)
