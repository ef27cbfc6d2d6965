"""Poses of markers: both that the corners allow, and the choice from one image to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import List, Mapping, Optional, Sequence, Tuple

import cv2
import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.vision.algebra import (
    homography,
    invert_symmetric,
    largest_singular_value,
    solve_symmetric,
)
from bullet_lab.vision.images import VisionError
from bullet_lab.vision.marker_detector import (
    DetectedMarker,
    Detections,
    DetectorSettings,
    MarkerDetector,
)
from bullet_lab.vision.pose_tilts import Seen, linearised, mean_squares

# Two poses are told apart if the worse one fits so much worse, and by more than the corners'
# own error.
_CLEAR_RATIO = 2.0
_CLEAR_SIGMAS = 3.0
_ITERATIONS = 10
# px²; corners that span less are no marker's.
_LEAST_AREA = 1.0
# In squares of standard deviations; a step that gains less changes nothing any more.
_CONVERGED = 1e-5
# Top left, top right, bottom right, bottom left corner in the marker's frame, by half its edge.
_SQUARE = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
# Seconds after which a pose says nothing about the next one.
_PATIENCE = 1.0
# A marker moves by less than this part of its distance from one image to the next.
_NEAR = 0.2
# One pose is clearly more upright than the other from this cosine of the tilt on: 3 degrees.
_CLEARLY_UPRIGHT = 0.0014
# Up, in the optical frame of a level camera.
_UP = np.array([0.0, -1.0, 0.0])


@dataclass(frozen=True, eq=False)
class MarkerPose:
    """Pose of a marker in the optical frame of a camera.

    The marker's frame has x to its right as one looks at it, y up, z out of its face. The
    covariance (6, 6) is of x, y, z and small rotations about the x, y, z of the optical frame, as
    in geometry_msgs/PoseWithCovariance; m² and rad².
    """

    rotation: np.ndarray  #: (3, 3), from the marker's frame to the optical frame
    translation: np.ndarray  #: (3,) m, the marker's middle
    error: float  #: root mean square of the corners' distances from where the pose puts them, px
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
    """The two poses of a flat marker that its corners allow."""

    best: MarkerPose  #: the one that fits better
    alternative: MarkerPose  #: the other one; the same as `best` where there is but one
    ambiguous: bool  #: the corners do not tell which is right

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
    corners: np.ndarray,
    size: float,
    camera: PinholeCamera,
    pixel_sigma: float = 0.1,
    covariance: Optional[np.ndarray] = None,
) -> PoseEstimate:
    """Return the poses of a marker from its corners.

    The two poses are those of Collins and Bartoli (2014, IPPE), each refined to the least
    squares of the reprojection error, weighted by the corners' covariance.

    Args:
        corners: (4, 2) u, v in px: top left, top right, bottom right, bottom left.
        size: edge of the black square, m.
        camera: geometry of the image; of a rectified one without distortion.
        pixel_sigma: standard deviation of each coordinate of a corner, px.
        covariance: (8, 8) of u0, v0, u1 ... in px², which is added to that; None: nothing.

    Raises:
        VisionError: the numbers make no marker, or no pose fits.
    """
    corners = np.asarray(corners, dtype=float)
    if corners.shape != (4, 2) or not np.isfinite(corners).all():
        raise VisionError("a marker has four finite corners")
    total = pixel_sigma**2 * np.eye(8) + (0.0 if covariance is None else covariance)
    sigma = float(np.sqrt(np.trace(total) / 8.0))
    if not (np.isfinite(size) and size > 0.0 and np.isfinite(sigma) and sigma > 0.0):
        raise VisionError(f"a marker of {size} m with corners to {pixel_sigma} px")
    # The area of a quadrilateral, from its diagonals.
    (ax, ay), (bx, by) = corners[2] - corners[0], corners[3] - corners[1]
    if 0.5 * abs(float(ax * by - ay * bx)) < _LEAST_AREA:
        raise VisionError("the corners of a marker are not four")
    points = 0.5 * size * _SQUARE
    rays = _undistorted(corners, camera)
    starts = _both_poses(points, rays)
    whitening = _whitening(total)
    refined = [_refined(r, t, points, corners, camera, whitening) for r, t in starts]
    fits = sorted((fit for fit in refined if fit is not None), key=lambda fit: fit[0])
    if not fits:
        raise VisionError("no pose fits the corners")
    best, other = fits[0][1], fits[-1][1]
    seen = Seen(points, corners, camera, whitening)
    best, other = _widened(best, other, seen), _widened(other, best, seen)
    same = fits[0] is fits[-1] or np.sum(best.rotation * other.rotation) > 3.0 - 1e-4
    clear = other.error > _CLEAR_RATIO * best.error
    clear = clear and other.error - best.error > 0.5 * _CLEAR_SIGMAS * sigma
    return PoseEstimate(best, other, not (same or clear))


def _widened(pose: MarkerPose, other: MarkerPose, seen: Seen) -> MarkerPose:
    turn = cv2.Rodrigues(other.rotation @ pose.rotation.T)[0].ravel()
    covariance = mean_squares(pose.rotation, pose.translation, pose.covariance, turn, seen)
    return replace(pose, covariance=covariance)


def _whitening(covariance: np.ndarray) -> np.ndarray:
    """Return the (8, 8) matrix by which errors of a covariance become independent ones of 1."""
    _, values, vectors = cv2.eigen(covariance)
    return vectors / np.sqrt(np.maximum(values, 1e-9 * values.max()))


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
        # The nearest one to what is nearly one already.
        _, left, right = cv2.SVDecomp(to_middle @ local)
        rotation = left @ right
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
    return solve_symmetric(a.T @ a, a.T @ (rays * turned[:, 2:] - turned[:, :2]).ravel())


def _refined(
    rotation: np.ndarray,
    translation: np.ndarray,
    points: np.ndarray,
    corners: np.ndarray,
    camera: PinholeCamera,
    whitening: np.ndarray,
) -> Optional[Tuple[float, MarkerPose]]:
    """Return the pose of least squares from a start (Levenberg and Marquardt), and how it fits."""

    def weighted(turned: np.ndarray, moved: np.ndarray):
        residuals, jacobian = linearised(turned, moved, points, corners, camera)
        return residuals, whitening @ residuals, whitening @ jacobian

    seen, residuals, jacobian = weighted(rotation, translation)
    error, damping = float(residuals @ residuals), 1e-6
    for _ in range(_ITERATIONS):
        if not np.isfinite(error):
            return None
        normal = jacobian.T @ jacobian
        damped = normal + damping * np.diag(np.diag(normal))
        step = -solve_symmetric(damped, jacobian.T @ residuals)
        moved = translation + step[:3]
        turned = cv2.Rodrigues(step[3:])[0] @ rotation
        there = weighted(turned, moved)
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
    covariance = invert_symmetric(jacobian.T @ jacobian)
    distance = float(np.sqrt(seen @ seen / 4.0))
    return error, MarkerPose(rotation, translation, distance, covariance)


@dataclass(frozen=True, eq=False)
class ObservedMarker(DetectedMarker):
    """A marker that was found, with both poses that it may have."""

    size: float  #: edge of its black square, m
    pose: PoseEstimate


class MarkerObserver:
    """Finds markers and where they are.

    Args:
        settings: what to look for.
        size: edge of the markers' black square, m.
        sizes: of those ids that have another.
        pixel_sigma: standard deviation of a corner's coordinates beside what the image's noise
            explains, px: of the print, or of a lens that is known badly.

    Raises:
        VisionError: a setting is not allowed.
    """

    def __init__(
        self,
        settings: Optional[DetectorSettings] = None,
        size: float = 0.2,
        sizes: Optional[Mapping[int, float]] = None,
        pixel_sigma: float = 0.02,
    ):
        self.detector = MarkerDetector(settings)
        self._size = size
        self._sizes = dict(sizes or {})
        self._sigma = pixel_sigma
        for value in (size, *self._sizes.values()):
            if not math.isfinite(value) or value <= 0.0:
                raise VisionError(f"a size of {value}: it must be above 0")
        if not math.isfinite(pixel_sigma) or pixel_sigma < 0.0:
            raise VisionError(f"corners to {pixel_sigma} px: it must be 0 or more")

    def observe(self, image: np.ndarray, camera: PinholeCamera) -> Detections:
        """Return the `ObservedMarker`s in an image, (h, w) grey levels or (h, w, 3) BGR, uint8.

        Raises:
            VisionError: the image is none, or not of the camera's size.
        """
        if image.shape[:2] != (camera.height, camera.width):
            size = f"{image.shape[1]} x {image.shape[0]} px"
            raise VisionError(f"an image of {size} of a camera of {camera.width} x {camera.height}")
        detections = self.detector.detect(image, camera)
        return Detections([self.locate(m, camera) for m in detections.markers], detections.report)

    def locate(self, marker: DetectedMarker, camera: PinholeCamera) -> ObservedMarker:
        """Return a detected marker with its poses."""
        size = self._sizes.get(marker.id, self._size)
        pose = estimate_pose(marker.corners, size, camera, self._sigma, marker.covariance)
        return ObservedMarker(**vars(marker), size=size, pose=pose)


class PoseMemory:
    """Chooses between the two poses of each marker, from one image to the next.

    Where the image tells them apart, it decides. Where it does not: the one nearest the last
    pose of that marker; else, if markers hang `upright` before a level camera, the more upright
    one where that is clear; else the one that fits better.
    """

    def __init__(self, upright: bool = True):
        self._upright = upright
        self._last: List[Tuple[int, MarkerPose]] = []
        self._stamp = -np.inf

    def forget(self) -> None:
        """Forget what was seen."""
        self._last = []

    def choose(self, markers: Sequence[ObservedMarker], stamp: float) -> List[MarkerPose]:
        """Return a pose for each marker of an image of a stamp in s."""
        if not 0.0 <= stamp - self._stamp <= _PATIENCE:
            self._last = []
        poses = [self._choose(marker) for marker in markers]
        if poses:
            self._last = [(m.id, pose) for m, pose in zip(markers, poses)]
            self._stamp = stamp
        return poses

    def _choose(self, marker: ObservedMarker) -> MarkerPose:
        estimate, best = marker.pose, marker.pose.best
        if not estimate.ambiguous:
            return best
        # The last pose of this very marker; others may bear the same id.
        same = [pose for number, pose in self._last if number == marker.id]
        distances = [float(np.linalg.norm(pose.translation - best.translation)) for pose in same]
        if same and min(distances) <= _NEAR * best.distance:
            return estimate.nearest_to(same[int(np.argmin(distances))].rotation)
        return estimate.upright(_UP, _CLEARLY_UPRIGHT) if self._upright else best
