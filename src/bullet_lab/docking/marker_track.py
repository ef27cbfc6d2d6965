"""Track of one print of the marker: where it is, and whether it is the real one.

A flat marker has two poses that look alike, and a larger print far away looks like the real one
close by. So a track is a sum of Gaussians: several yaws, and several sizes of which only one
is the marker's. All are moved along with the odometry and weighed by how well they predict the
corners in each image. A copy of another size betrays itself as the robot moves, since its range
changes by more or less than it should; the marker's height betrays many at once.
"""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np
from numpy import ndarray

from bullet_lab.core.se2 import wrap, wrapped
from bullet_lab.docking.database import DockMarker
from bullet_lab.docking.filter import (
    CAMERA,
    CORNERS,
    ODOMETRY,
    OFF_CORNER,
    STATES,
    UNKNOWN_CAMERA,
    UNKNOWN_ODOMETRY,
    GaussianPose,
    Measurement,
    applied,
    as_known,
    carried,
    innovations,
    predict,
    robust_update,
    squared_distances,
)
from bullet_lab.docking.geometry import Viewpoint, extent_of
from bullet_lab.docking.types import CalibrationErrors, Learned, MotionStep, Sighting

SCALES = np.array([1.0, 0.35, 0.45, 0.6, 0.8, 1.25, 1.6, 2.1, 2.8, 3.7, 5.0, 6.5, 8.5, 11.0])
"""Sizes that are thought possible, as multiples of the marker's; the first is the real one."""

_WINDOW = 0.22
# Relative standard deviation of each size; the real one is known well.
_SIZE_DEVIATIONS = np.where(SCALES == 1.0, 0.02, 0.08)
_ODOMETRY_SCALE = 0.04
# Noise of the height in the image, which shows the range, px.
_EDGE = 0.35
_BEARING = 0.03

# Standard deviations of height, m, and of the logarithm of the size: of the real one, and others.
_KNOWN, _FREE = (0.008, 1e-4), (0.4, 0.12)
# Yaws at the start, against the line of sight, and their deviations, rad.
_SLANTS = np.radians(np.arange(-70.0, 71.0, 7.0))
_START_DEVIATION = math.radians(5.0)
# Gaussians that are kept: most of a size, least weight within it, least probability of a size.
_PER_SCALE = 3
_LEAST_WEIGHT = 1e-6
_LEAST_SHARE = 1e-5
# Images from one spot that count in full, and of a marker narrower than so many px.
_FRAMES_AT_A_SPOT, _OF_A_SMALL_ONE, _SMALL = 8, 3, 40.0
# Gaussians of at least this part of the greatest weight decide whether a corner is hidden.
_LIKELY = 0.1
# Squared distance above which an image is an outlier; so many in a row are believed.
_OUTLIER = 40.0
_STUBBORN = 4
# A wider marker shows its yaw itself, px; squared deviations that contradict a yaw.
_CLEAR, _CONTRADICTION = 60.0, 9.0


class SizeTest:
    """Log-likelihoods of the sizes, from the seeming range `reach` and its `deviation`, m.

    Taken for the real one, a copy twice as large seems half as far away; but then the robot has
    to go two metres to come one metre nearer. This compares changes of the seeming range with
    what was travelled towards the marker, over ways long enough for the noise of both to matter
    little.
    """

    def __init__(self, reach: float, deviation: float):
        self.logs = np.zeros(len(SCALES))
        self._restart(reach, deviation)
        self._unseen = 0.0

    def travel(self, away: float, beside: float, variance: float) -> None:
        """Note a step: m away from the marker, m across, and the variance of the first."""
        self._away += away
        self._variance += variance + (_BEARING * beside) ** 2
        self._unseen += math.hypot(away, beside)

    def see(self, reach: float, deviation: float, since: float = 0.0) -> None:
        """Note a seeming range (m) and its standard deviation.

        `since` is what was travelled away from the marker since then, m: images may be late.
        """
        unseen, self._unseen = self._unseen, 0.0
        if unseen > 0.8:
            self._restart(reach, deviation, since)
            return
        change, away = reach - self._reach, self._away - since
        if max(abs(away), abs(change)) < max(_WINDOW, 6.0 * (deviation + self._deviation)):
            return
        expected = SCALES * change
        variance = (
            self._variance
            + SCALES**2 * (deviation**2 + self._deviation**2)
            + (_ODOMETRY_SCALE * away) ** 2
            + (_SIZE_DEVIATIONS * expected) ** 2
            + 1e-6
        )
        square = (away - expected) ** 2 / variance
        # No single comparison decides.
        logs = -0.5 * square - 0.5 * np.log(variance)
        self.logs += np.maximum(logs - np.max(logs), -8.0)
        self._restart(reach, deviation, since)

    def _restart(self, reach: float, deviation: float, since: float = 0.0) -> None:
        self._reach, self._deviation = reach, deviation
        self._away, self._variance = since, 0.0


class MarkerTrack:
    """A print of the marker, followed from image to image.

    It begins with a first sighting, and a prior of the dock's pose in the robot's frame if the
    print is the real marker.

    Attributes:
        frames: images that were taken into account.
        last_seen: stamp of the last image that showed it, s.
        found_from: from how far it was found, at most, m.
        real: probability that it is the marker itself and no copy of another size.
    """

    def __init__(
        self, sighting: Sighting, view: Viewpoint, marker: DockMarker, prior: GaussianPose
    ):
        self._size, self._height = marker.size, marker.height
        self.frames, self.last_seen, self.found_from = 0, -math.inf, 0.0
        self._eye = np.array([view.mount.x, view.mount.y])
        # What was driven (m) and turned (rad) since the first image from this spot.
        self._spot = np.array([math.inf, math.inf])
        self._spot_frames = 0
        self._outliers = 0
        # Result of `components`, which is needed many times at each tick.
        self._known: tuple[ndarray, ndarray, ndarray] | None = None
        self._extent = extent_of(sighting.corners)
        self._start(sighting, view, prior)

    def estimate(self) -> GaussianPose:
        """Return the pose if it is real, which must be possible."""
        poses, covariances, weights = self.components()
        best = poses[np.argmax(weights)]
        off = wrapped(poses - best)
        shift = weights @ off
        spread = off - shift
        covariance = np.sum(weights[:, None, None] * covariances, axis=0)
        covariance += (weights[:, None] * spread).T @ spread
        return GaussianPose(wrapped(best + shift), covariance)

    def components(self) -> tuple[ndarray, ndarray, ndarray]:
        """Return the Gaussians (n, 3), (n, 3, 3) of the pose if it is real, with weights (n,)."""
        if self._known is None:
            real = self._scale == 0
            x, p = as_known(self._x[real], self._p[real])
            weights = self._weights[real] / float(np.sum(self._weights[real]))
            self._known = x[:, :3].copy(), p[:, :3, :3].copy(), weights
        return self._known

    def samples(self, rng: np.random.Generator, count: int) -> ndarray:
        """Draw (count, 3) poses of the dock, if it is real."""
        poses, covariances, weights = self.components()
        chosen = rng.choice(len(weights), size=count, p=weights)
        roots = np.linalg.cholesky(covariances + 1e-12 * np.eye(3))
        return wrapped(poses[chosen] + applied(roots[chosen], rng.standard_normal((count, 3))))

    def copies(self) -> tuple[ndarray, ndarray, ndarray]:
        """Return where the thing may be (n, 2) in the robot's frame, its size and weights (n,)."""
        return self._x[:, :2].copy(), self._actual_sizes(), self._weights.copy()

    @property
    def sized(self) -> float:
        """Probability that its size is within a fifth of the likeliest."""
        sizes = self._actual_sizes()
        best = sizes[np.argmax(self._weights)]
        return float(np.sum(self._weights[np.abs(np.log(sizes / best)) < 0.2]))

    def likeliest(self) -> GaussianPose:
        """Return the likeliest pose of a dock with this marker, whatever its size."""
        best = np.argmax(self._weights)
        x, p = as_known(self._x[best, None], self._p[best, None])
        return GaussianPose(x[0, :3].copy(), p[0, :3, :3].copy())

    def learned(self) -> CalibrationErrors:
        """Return camera and odometry errors of the likeliest Gaussian, if it is real."""
        best = self._best_real()
        (x,), (p,) = as_known(self._x[best, None], self._p[best, None])
        values = [Learned(*pair) for pair in zip(x.tolist(), np.sqrt(np.diag(p)).tolist())]
        height = Learned(values[3].value - self._height, values[3].deviation)
        roll, pitch, yaw = values[CAMERA]
        way, turn, drift, _ = values[ODOMETRY]
        return CalibrationErrors(
            roll, pitch, yaw, height, Learned(math.expm1(way.value), way.deviation), turn, drift
        )

    def likeliest_size(self) -> float:
        """Return the likeliest size in m."""
        return float(self._actual_sizes()[np.argmax(self._weights)])

    def _best_real(self) -> int:
        """Return the index of the likeliest Gaussian, if it is real."""
        return int(np.argmax(np.where(self._scale == 0, self._within, -1.0)))

    @property
    def _sizes(self) -> ndarray:
        """Assumed sizes (n,), m."""
        return self._size * SCALES[self._scale]

    def _actual_sizes(self) -> ndarray:
        return self._sizes * np.exp(self._x[:, 4])

    def move(self, motion: MotionStep) -> None:
        """Follow a step of the robot."""
        dx, dy, turn = motion.step
        # Motion of the camera, for the test of sizes.
        cos, sin = math.cos(turn), math.sin(turn)
        ex, ey = self._eye
        moved = np.array([dx + cos * ex - sin * ey - ex, dy + sin * ex + cos * ey - ey])
        ray = self._x[np.argmax(self._weights), :2] - self._eye
        ray = ray / max(float(np.hypot(*ray)), 1e-6)
        variance = float(ray @ motion.covariance[:2, :2] @ ray)
        beside = float(ray[0] * moved[1] - ray[1] * moved[0])
        self._sizing.travel(-float(ray @ moved), abs(beside), variance)
        self._x, self._p = carried(self._x, self._p, motion)
        self._known = None
        self._spot = self._spot + np.abs((math.hypot(dx, dy), turn))

    def nearest(self, sighting: Sighting, view: Viewpoint) -> tuple[float, ndarray]:
        """Return the least squared Mahalanobis distance (of 8 values) to one of its Gaussians.

        And the (4, 2) corners as that one predicts them; NaN if behind the camera.
        """
        given = self._x, self._p, self._sizes, Measurement(sighting, view)
        rest, _, covariance, seen = innovations(self._x, *given)
        squares = squared_distances(rest, covariance)
        best = int(np.argmin(squares))
        return float(squares[best]), seen[best].reshape(4, 2)

    def predict_corners(self, view: Viewpoint) -> ndarray:
        """Return where the corners (4, 2) would be seen, if it is real; NaN if behind."""
        best = self._best_real()
        return predict(self._x[best, None], self._sizes[best, None], view)[0].reshape(4, 2)

    def see(self, sighting: Sighting, view: Viewpoint) -> None:
        """Update the track by one more image.

        Images from one spot share their errors; after some of them, more count little.
        """
        self._extent = extent_of(sighting.corners)
        measured = Measurement(sighting, view, self._repeated_here())
        likely = self._weights > _LIKELY * np.max(self._weights)
        seen = self._sizes, measured, 3, likely
        x, p, squares, logs = robust_update(self._x, self._p, *seen)
        if np.min(squares) > _OUTLIER:
            self._outliers += 1
            if self._outliers < _STUBBORN:
                return
            self._p[:, :3, :3] *= 4.0
            x, p, squares, logs = robust_update(self._x, self._p, *seen)
        else:
            self._outliers = 0
        self.frames += 1
        self._x, self._p = x, p
        # One image cannot rule out for good what later ones may show.
        self._within *= np.exp(
            -0.5 * np.minimum(squares - np.min(squares), 60.0) - 0.5 * (logs - np.min(logs))
        )
        ray = self._x[np.argmax(self._weights), :2] - self._eye
        moved = self._eye - view.origin[:2]
        away = float(np.hypot(*ray))
        self.found_from = max(self.found_from, away)
        since = -float(ray @ moved) / max(away, 1e-6)
        self._sizing.see(*self._reach(sighting.corners, view), since)
        self._reduce()

    def adopt_yaw(self, yaw: float, variance: float) -> None:
        """Take over the yaw (rad, rad²) of a larger print if all of its own differ.

        A marker of few pixels that faces the camera looks the same over 20 degrees.
        """
        real = np.flatnonzero(self._scale == 0)
        if not len(real) or self._extent > _CLEAR:
            return
        off = wrap(yaw - self._x[real, 2])
        if np.min(off**2 / (self._p[real, 2, 2] + variance)) < _CONTRADICTION:
            return
        best = real[np.argmax(self._within[real])]
        self._x[best, 2] = yaw
        self._p[best, 2, :] = self._p[best, :, 2] = 0.0
        self._p[best, 2, 2] = variance
        self._within[real] = real == best
        self._reduce()

    def _reach(self, corners: ndarray, view: Viewpoint) -> tuple[float, float]:
        """Return the seeming range in m and its standard deviation."""
        _, reach = view.line_of_sight(corners, self._size)
        pixels = view.camera.fy * self._size / reach
        return reach, reach * _EDGE / max(pixels, 1.0)

    def _repeated_here(self) -> float:
        """Return by how much more images from this spot are off than the first ones."""
        if self._spot[0] > 0.012 or self._spot[1] > math.radians(0.7):
            self._spot, self._spot_frames = np.zeros(2), 0
        self._spot_frames += 1
        few = _OF_A_SMALL_ONE if self._extent < _SMALL else _FRAMES_AT_A_SPOT
        return max(1.0, self._spot_frames / few)

    def _weigh(self) -> None:
        """Put the weights together: of the sizes, and of the yaws within each."""
        logs = self._sizing.logs + self._first
        present = np.unique(self._scale)
        shares = np.zeros(len(SCALES))
        shares[present] = np.exp(logs - np.max(logs))[present]
        for index in present:
            of_size = self._scale == index
            self._within[of_size] /= float(self._within[of_size].sum())
        self._weights = self._within * shares[self._scale] / np.sum(shares)
        self.real = float(np.sum(self._weights[self._scale == 0]))

    def _start(self, sighting: Sighting, view: Viewpoint, prior: GaussianPose) -> None:
        ray, reach = view.line_of_sight(sighting.corners, self._size)
        count = len(_SLANTS)
        self._scale = scale = np.repeat(np.arange(len(SCALES)), count)
        real = scale == 0
        slants = np.tile(_SLANTS, len(SCALES))
        distance = reach * SCALES[scale]
        eye = view.origin
        states = np.zeros((len(scale), STATES))
        states[:, :2] = eye[:2] + distance[:, None] * ray[:2]
        states[:, 2] = wrap(math.atan2(ray[1], ray[0]) + slants)
        states[:, 3] = np.where(real, self._height, eye[2] + distance * ray[2])
        deviations = np.empty_like(states)
        deviations[:, :2] = 0.3 * distance[:, None] + 0.05
        deviations[:, 2] = _START_DEVIATION
        deviations[:, 3:5] = np.where(real[:, None], _KNOWN, _FREE)
        deviations[:, CAMERA] = UNKNOWN_CAMERA
        deviations[:, CORNERS] = OFF_CORNER
        deviations[:, ODOMETRY] = UNKNOWN_ODOMETRY
        covariance = deviations[:, None] ** 2 * np.eye(STATES)
        given = states, covariance, self._sizes, Measurement(sighting, view)
        self._x, self._p, squares, _ = robust_update(*given, rounds=6)
        unlikely = np.where(real, prior.excess(self._x[:, :3].copy()), 0.0)
        self._fuse(prior)
        logs = -0.5 * np.minimum(squares + unlikely, 2000.0)
        # Within a size the yaws compete; between the sizes the best of each does.
        best = logs.reshape(-1, count).max(axis=1)
        self._within = np.exp(logs - best[scale])
        self._first = np.minimum(best - np.max(best), 0.0)
        # Before anything is known of its size, nine of ten are real.
        self._first[1:] -= math.log(9.0 * (len(SCALES) - 1))
        self._sizing = SizeTest(*self._reach(sighting.corners, view))
        self.frames = 1
        self._reduce()

    def _fuse(self, prior: GaussianPose) -> None:
        """Fuse the belief before the marker was seen with the Gaussians of the real size."""
        real = self._scale == 0
        x, p = self._x[real], self._p[real]
        off = wrapped(prior.mean - x[:, :3])
        gain = np.linalg.solve(p[:, :3, :3] + prior.covariance, p[:, :3]).transpose(0, 2, 1)
        x = wrapped(x + applied(gain, off))
        p = p - gain @ p[:, :3]
        self._x[real], self._p[real] = x, 0.5 * (p + p.transpose(0, 2, 1))

    def _reduce(self) -> None:
        """Merge Gaussians that have become the same and drop the weakest of each size."""
        self._known = None
        self._weigh()
        keep, rivals_of = [], defaultdict(list)
        spreads = 0.7 * np.sqrt(np.diagonal(self._p, axis1=1, axis2=2)) + 1e-5
        spreads[:, CORNERS] = np.inf
        for index in np.argsort(-self._within).tolist():
            rivals = rivals_of[self._scale[index]]
            off = wrapped(self._x[rivals] - self._x[index])
            alike = (np.abs(off) < spreads[rivals]).all(axis=1)
            if alike.any():
                self._within[rivals[int(alike.argmax())]] += self._within[index]
            elif not rivals or (
                self._within[index] > _LEAST_WEIGHT
                and len(rivals) < (12 if self.frames < 2 else _PER_SCALE)
            ):
                keep.append(index)
                rivals.append(index)
        likely = [s for s in rivals_of if np.sum(self._weights[self._scale == s]) > _LEAST_SHARE]
        keep = [k for k in keep if self._scale[k] in likely]
        self._x, self._p = self._x[keep], self._p[keep]
        self._scale, self._within = self._scale[keep], self._within[keep]
        self._weigh()
