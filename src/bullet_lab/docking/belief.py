"""Belief about the dock: particles until its marker is seen, then tracks of what shows it.

The particles live in the robot's frame, so that errors of the odometry spread them as the robot
moves. They start from the database, and learn from what was free to stand on and from looks
that did not find the marker.
"""

from __future__ import annotations

import math

import numpy as np
from numpy import ndarray

from bullet_lab.core import se2
from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.se2 import PlanarPose, wrapped
from bullet_lab.docking.database import Dock
from bullet_lab.docking.filter import UNKNOWN_ODOMETRY, DriftingPose, GaussianPose, true_steps
from bullet_lab.docking.geometry import (
    MarkerVisibility,
    Viewpoint,
    clearance,
    extent_of,
    extent_of_walls,
    wall_boxes,
)
from bullet_lab.docking.marker_track import MarkerTrack
from bullet_lab.docking.types import (
    HALF_WIDTH,
    CameraMount,
    DockingSettings,
    MotionStep,
    Observation,
    Odometry,
    OdometryBuffer,
    Sighting,
    motion_step,
)

PARTICLES = 600
# Number of the particles that no failed look makes less likely, and their share of the possible
# docks for path planning: paths lead around them, but they alone close no path.
_WALL_PARTICLES = 200
_WALL_SHARE = 0.05
# The database may be wrong by somewhat more than its uncertainty.
_MARGIN = 1.1
# Way between two looks at what is free, m, and what a turn counts as, m/rad.
_AGAIN, _LEVER = 0.05, 0.5
# Relative standard deviation of the size of a copy.
_SIZE_DEVIATION = 0.05
# Least size of a sighting and least distance from the edge of the image, px.
_SMALLEST = 6.0
_BORDER = 3.0
# White beside a marker that it needs to be found, as a share of its size.
_CUT = 0.06
_MOST_TRACKS = 8
# Squared distance up to which corners fit a track, and most by which the fit to an old track may
# be worse than that to a new one.
_FIT = 45.0
_FAMILIAR = 20
# Probability of a size that is certain, and of a track that is hardly the real marker.
_SURE_OF_SIZE = 0.8
_HARDLY_REAL = 0.01
# Distribution function of the light's reach, poor light included, and the golden ratio that spreads
# its quantiles evenly.
_REACHES = (0.0, 0.15, 1.0), (0.35, 0.7, 1.15)
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
# Share of the particles that stay where a track is dropped.
_MIXED = 0.6
# Standard deviation of the difference in yaw of two prints on one wall, rad.
_SAME_WALL = 0.015


class DockParticles:
    """Weighted poses of a dock in the robot's frame, drawn about the rough pose given there.

    Each has its own odometry errors, and its own reach of the light: a look that found nothing
    finds nothing again from the same place, be it that the marker is not there or that it is too
    dark.

    Short steps of the robot are made as one, when the poses are asked for.

    Attributes:
        weights: (n,).
        reach: (n,) of the light, as `MarkerVisibility.found` takes it.
        mass: share of the prior that is left.
    """

    def __init__(
        self, dock: Dock, rough: PlanarPose, rng: np.random.Generator, count: int = PARTICLES
    ):
        self._rng = rng
        self._boxes = wall_boxes(dock)
        self._extent = extent_of_walls(self._boxes)
        # The uncertainty is along the axes of the frame that the pose is given in, which may be
        # any; drawn on a disc and a square it makes little difference.
        position = _MARGIN * dock.uncertainty.position + 0.01
        yaw = _MARGIN * dock.uncertainty.yaw + 0.005
        off = rng.uniform(-1.0, 1.0, (count, 3)) * (position, position, yaw)
        self._poses = wrapped(rough + off)
        # What the robot has moved since the poses were; and m since `stands_free` looked at them.
        self._ahead: MotionStep | None = None
        self._travelled = math.inf
        self.weights = self._even = np.full(count, 1.0 / count)
        self.mass = 1.0
        # Errors of the odometry.
        self._errors = rng.standard_normal((count, len(UNKNOWN_ODOMETRY))) * UNKNOWN_ODOMETRY
        # Evenly spread, and in no order.
        self.reach = np.interp(_GOLDEN * np.arange(count) % 1.0, *_REACHES)

    def move(self, motion: MotionStep) -> None:
        """Follow a step of the robot."""
        self._ahead = motion if self._ahead is None else self._ahead.then(motion)
        dx, dy, turn = motion.step
        self._travelled += math.hypot(dx, dy) + _LEVER * abs(turn)

    @property
    def poses(self) -> ndarray:
        """Of the dock (n, 3) in the robot's present frame."""
        if self._ahead is not None:
            roots = _root(self._ahead.covariance)
            steps = true_steps(self._ahead.step, self._errors)
            steps = steps + self._rng.standard_normal((len(steps), 3)) @ roots.T
            self._poses, self._ahead = se2.between(steps, self._poses), None
        return self._poses

    def stands_free(self) -> bool:
        """Drop poses at which the robot, as a circle, is in a wall; return whether any is left.

        It looks again when the robot has moved by some centimetres.
        """
        if self._travelled < _AGAIN:
            return True
        self._travelled = 0.0
        if np.square(self.poses[:, :2]).sum(axis=1).min() > (self._extent + HALF_WIDTH) ** 2:
            return True
        free = clearance(se2.inverse(self.poses)[:, :2], self._boxes) > HALF_WIDTH
        if not np.all(free):
            self.learn(np.where(free, 1.0, 1e-6), counts=False)
        return bool(np.any(free))

    def concentrate(self, estimate: GaussianPose, margin: float) -> None:
        """Move the particles to a pose, with so much more uncertainty to either side, m."""
        count = len(self.weights)
        # The size of the copy, and so its distance, is known to some per cent only.
        covariance = estimate.covariance + np.diag([0.02, 0.01, 0.012]) ** 2
        covariance[:2, :2] += np.outer(estimate.mean[:2], estimate.mean[:2]) * _SIZE_DEVIATION**2
        drawn = estimate.mean + self._rng.standard_normal((count, 3)) @ _root(covariance).T
        beside = np.zeros((count, 3))
        beside[:, 1] = self._rng.uniform(-margin, margin, count)
        self._poses, self._ahead = se2.compose(drawn, beside), None
        self.weights = self._even

    def mix_in(self, poses: ndarray) -> None:
        """Replace a share of the particles by other poses (n, 3)."""
        count = int(_MIXED * len(self.poses))
        keep = self._rng.choice(len(self.poses), len(self.poses) - count, p=self.weights)
        drawn = poses[self._rng.integers(len(poses), size=count)]
        self._take(np.concatenate([keep, np.arange(count)]))
        self._poses[len(keep) :] = drawn

    def _take(self, chosen: ndarray) -> None:
        """Keep the particles of these indices (n,), with equal weights."""
        self._poses, self._errors = self.poses[chosen], self._errors[chosen]
        self.reach = self.reach[chosen]
        self.weights = self._even

    def gaussian(self) -> GaussianPose:
        """Return mean and covariance, widened a little."""
        mean = self.weights @ self.poses
        turn = np.exp(1j * self.poses[:, 2])
        mean[2] = np.angle(self.weights @ turn)
        off = wrapped(self.poses - mean)
        covariance = (self.weights[:, None] * off).T @ off
        return GaussianPose(mean, 1.2 * covariance + np.diag([0.05, 0.05, 0.03]) ** 2)

    def samples(self, count: int) -> tuple[ndarray, ndarray]:
        """Draw (count, 3) poses and the light's reach (count,) at each."""
        chosen = self._rng.choice(len(self.poses), count, p=self.weights)
        return self.poses[chosen], self.reach[chosen]

    def learn(self, likelihood: ndarray, counts: bool = True) -> None:
        """Weigh the poses by the likelihood (n,) of a look, which lessens `mass` if it counts."""
        weights = self.weights * likelihood
        total = float(np.sum(weights))
        if counts:
            self.mass *= total
        self.weights = weights / total
        count = len(self.poses)
        if 1.0 / np.sum(self.weights**2) >= 0.4 * count:
            return
        places = (np.arange(count) + self._rng.uniform()) / count
        chosen = np.minimum(np.searchsorted(np.cumsum(self.weights), places), count - 1)
        self._take(chosen)
        self._poses += self._rng.standard_normal((count, 3)) * (0.02, 0.02, 0.008)


def _root(covariance: ndarray) -> ndarray:
    """Return a matrix whose product with its transpose is a covariance, which may be singular."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return vectors * np.sqrt(np.maximum(values, 0.0))


class DockBelief:
    """Belief about the dock's pose, by the robot's odometry and the camera's images.

    The dock's rough pose, `dock_pose`, is in the odometry frame; `rng` draws the particles.

    Attributes:
        odometry: the last messages.
        particles: of the dock's pose before its marker was seen; None before the first odometry.
        walls: likewise, but without learning from looks that found nothing: the walls are there
            too if the marker is hidden or the detector misses it.
        visibility: from where the marker is visible; None before the first image.
        tracks: of what shows the marker.
        copy: track of a print where only the dock's back wall can be, by the last image; or None.
        last_image: stamp of the newest image, s.
        images: number of images that were taken in.
    """

    def __init__(
        self,
        dock: Dock,
        dock_pose: PlanarPose,
        mount: CameraMount,
        settings: DockingSettings,
        rng: np.random.Generator,
    ):
        self.dock, self.mount, self.settings = dock, mount, settings
        self._dock_pose, self._rng = dock_pose, rng
        self.odometry = OdometryBuffer()
        self.particles: DockParticles | None = None
        self.walls: DockParticles | None = None
        # The belief before the marker was seen, and the pose of the database; None like particles.
        self._prior: DriftingPose | None = None
        self._database: DriftingPose | None = None
        self.visibility: MarkerVisibility | None = None
        self._camera: PinholeCamera | None = None
        self.tracks: list[MarkerTrack] = []
        self.copy: MarkerTrack | None = None
        self.last_image = -math.inf
        self.images = 0
        # Result of `estimate` for the present tracks: it is called many times at each tick.
        self._estimated: tuple[GaussianPose | None] | None = None

    @property
    def pose(self) -> PlanarPose:
        """Of the robot in the odometry frame."""
        return self.odometry.last.pose

    def best(self) -> MarkerTrack | None:
        """Return the track to go for; None where none is plausible."""
        plausible = [t for t in self.tracks if t.frames >= 3 and t.real > _HARDLY_REAL]
        return max(plausible, key=lambda track: track.real, default=None)

    def estimate(self) -> GaussianPose | None:
        """Return the dock's pose in the robot's frame; None before the marker was seen.

        A small marker shows little of its yaw; a larger copy on the same wall shows more.
        """
        if self._estimated is None:
            best = self.best()
            estimate = None if best is None else best.estimate()
            if estimate is not None and self.copy is not None:
                estimate = estimate.turned_to(*_wall_yaw(self.copy))
            self._estimated = (estimate,)
        return self._estimated[0]

    def pending(self) -> bool:
        """Return whether some more images may show that a track is the marker."""
        return any(t.frames < 3 and t.real > _HARDLY_REAL for t in self.tracks)

    def samples(self, count: int) -> ndarray:
        """Draw (count, 3) poses of the dock in the odometry frame."""
        best = self.best()
        if best is None:
            drawn = self._possible(count)
        else:
            others = int(round(count * min(1.0 - best.real, 0.5))) if best.real < 0.9 else 0
            drawn = best.samples(self._rng, count - others)
            if others:
                drawn = np.concatenate([drawn, self._possible(others)])
        return se2.compose(self.pose, drawn)

    def _possible(self, count: int) -> ndarray:
        """Draw (count, 3) poses of a dock whose marker is not seen, in the robot's frame."""
        of_walls = int(_WALL_SHARE * count)
        particles, _ = self.particles.samples(count - of_walls)
        walls, _ = self.walls.samples(of_walls)
        return np.concatenate([particles, walls])

    def stands_free(self) -> bool:
        """Drop poses at which the robot is in a wall; return whether any is left."""
        self.walls.stands_free()
        return self.particles.stands_free()

    def obstacles(self) -> ndarray:
        """Return copies of the marker as obstacles (n, 4): x, y, radius (m, odometry), weight."""
        rows = [np.empty((0, 4))]
        for track in self.tracks:
            if track.real > 0.5 or track.frames < 3:
                continue
            places, sizes, weights = track.copies()
            world = se2.compose(self.pose, np.column_stack([places, np.zeros(len(places))]))
            rows.append(np.column_stack([world[:, :2], 0.65 * sizes, weights]))
        return np.concatenate(rows)

    def copies_seen(self) -> bool:
        """Return whether a print of the marker was in sight lately."""
        return any(t.frames >= 3 and self.last_image - t.last_seen < 2.0 for t in self.tracks)

    def _copy_on_the_wall(self) -> MarkerTrack | None:
        for track in self.tracks:
            if track.real > _HARDLY_REAL or track.frames < 5 or track.sized < _SURE_OF_SIZE:
                continue
            if self._database.pose.excess(track.likeliest().mean[None].copy())[0] <= 0.0:
                return track
        return None

    def cut_off(self, track: MarkerTrack) -> bool:
        """Return whether an edge of an image taken now would cut off a marker's white border."""
        corners, camera = track.predict_corners(Viewpoint(self._camera, self.mount)), self._camera
        return not _inside(corners, camera) >= _CUT * extent_of(corners)

    def add_odometry(self, odometry: Odometry) -> None:
        """Follow the odometry."""
        self._estimated = None
        before = self.odometry.last
        self.odometry.add(odometry)
        if before is None:
            rough = se2.between(odometry.pose, self._dock_pose)
            drawn = self.dock, tuple(rough.tolist()), self._rng
            self.particles = DockParticles(*drawn)
            self.walls = DockParticles(*drawn, _WALL_PARTICLES)
            self._prior = DriftingPose(self.particles.gaussian())
            self._database = DriftingPose(self.particles.gaussian())
            return
        step = motion_step(before, odometry)
        for moved in (self.particles, self.walls, self._prior, self._database, *self.tracks):
            moved.move(step)

    def observe(self, observation: Observation) -> None:
        """Take in an image; one older than the memory of the odometry is ignored."""
        then = self.odometry.pose_at(observation.stamp)
        if then is None:
            return
        self._estimated = None
        camera = observation.camera
        if camera is not self._camera:
            self._camera = camera
            self.visibility = MarkerVisibility(self.dock, camera, self.mount.z)
        self.last_image = max(self.last_image, observation.stamp)
        self.images += 1
        view = Viewpoint(camera, self.mount, tuple(se2.between(self.pose, then).tolist()))
        shown = filter(self._shows_marker, observation.sightings)
        self._associate(list(shown), view, observation.stamp)
        self.copy = self._copy_on_the_wall()
        for track in self.tracks if self.copy is not None else ():
            if track is not self.copy:
                track.adopt_yaw(*_wall_yaw(self.copy))

    def concentrate(self, estimate: GaussianPose, margin: float) -> None:
        """Concentrate the belief at a pose, with so much more uncertainty to either side, m."""
        self.particles.concentrate(estimate, margin)
        self.walls.concentrate(estimate, margin)
        self._prior = DriftingPose(self.particles.gaussian())

    def forget(self, track: MarkerTrack) -> None:
        """Drop a track that is not where it should be; some particles stay there."""
        if track.real > 0.3:
            drawn = track.samples(self._rng, 200)
            drawn = drawn + self._rng.standard_normal(drawn.shape) * (0.1, 0.1, 0.06)
            self.particles.mix_in(drawn)
            self.walls.mix_in(drawn)
        self.tracks.remove(track)
        self.copy, self._estimated = self._copy_on_the_wall(), None

    def _shows_marker(self, sighting: Sighting) -> bool:
        corners = sighting.corners
        whole = _inside(corners, self._camera) >= _BORDER and extent_of(corners) >= _SMALLEST
        return whole and self.dock.marker.is_shown_by(sighting)

    def _associate(self, sightings: list[Sighting], view: Viewpoint, stamp: float) -> None:
        """Give each sighting to the track that it fits best, or begin a new one with it."""
        pairs = []
        for number, sighting in enumerate(sightings):
            for track in self.tracks:
                cost = _association_cost(track, sighting, view)
                if cost is not None:
                    pairs.append((cost, number, track))
        owners: dict[int, MarkerTrack] = {}
        for _, number, track in sorted(pairs, key=lambda pair: pair[0]):
            if number not in owners and track not in owners.values():
                owners[number] = track
        # Drop a younger track of a sighting that an older track owns: both are one print.
        for _, number, track in pairs:
            owner = owners.get(number)
            if owner is None or track in owners.values() or track not in self.tracks:
                continue
            if track.frames < owner.frames:
                self.tracks.remove(track)
        for number, sighting in enumerate(sightings):
            track = owners.get(number)
            if track is None:
                track = MarkerTrack(sighting, view, self.dock.marker, self._prior.pose)
                self.tracks.append(track)
            else:
                track.see(sighting, view)
            track.last_seen = stamp
        while len(self.tracks) > _MOST_TRACKS:
            self.tracks.remove(min(self.tracks, key=lambda t: (t.frames >= 3, t.last_seen)))


def _inside(corners: ndarray, camera: PinholeCamera) -> float:
    """Return how far within the image (4, 2) corners are, px; NaN if a corner is NaN."""
    return float(np.minimum(corners, (camera.width - 1, camera.height - 1) - corners).min())


def _wall_yaw(copy: MarkerTrack) -> tuple[float, float]:
    """Return the yaw of the wall with a copy, rad, and its variance."""
    likeliest = copy.likeliest()
    return float(likeliest.mean[2]), float(likeliest.covariance[2, 2]) + _SAME_WALL**2


def _association_cost(track: MarkerTrack, sighting: Sighting, view: Viewpoint) -> float | None:
    """Return how badly corners fit a track, None if they are not of it.

    A track that was seen often is preferred to a new one, which fits anything.
    """
    corners = sighting.corners
    misfit, predicted = track.nearest(sighting, view)
    if misfit < _FIT:
        return misfit - min(track.frames, _FAMILIAR)
    if not np.isfinite(predicted).all():
        return None
    extent, expected = extent_of(corners), extent_of(predicted)
    away = float(np.hypot(*(np.mean(corners, axis=0) - np.mean(predicted, axis=0))))
    if not 0.75 < extent / expected < 1.33 or away > max(25.0, 0.6 * extent):
        return None
    return 1e3 + away
