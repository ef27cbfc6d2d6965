"""All that is known of the dock: before its marker was seen, and since."""

from __future__ import annotations

import math
from typing import Dict, List, Optional

import numpy as np

from bullet_lab.core import se2
from bullet_lab.docking.candidate import Candidate
from bullet_lab.docking.cloud import DockCloud
from bullet_lab.docking.database import Dock
from bullet_lab.docking.geometry import View
from bullet_lab.docking.marker_model import Viewpoint, extent_of
from bullet_lab.docking.motion import (
    DockEstimate,
    DockPrior,
    MotionStep,
    OdometryTrack,
    motion_step,
)
from bullet_lab.docking.settings import DockingSettings
from bullet_lab.docking.types import CameraMount, Observation, Odometry, PlanarPose

_SMALLEST = 6.0
_BORDER = 3.0
_MOST_CANDIDATES = 8
_FIT = 45.0
# By so much may the fit to an old candidate be worse than that to a new one, at most.
_FAMILIAR = 20
_SURE_OF_SIZE = 0.8
_HARDLY_REAL = 0.01
SAME_WALL = 0.015
"""How far, in rad, two prints on one wall may differ in yaw (a standard deviation)."""


class _Tracked:
    """A candidate and when it was seen."""

    def __init__(self, candidate: Candidate, stamp: float):
        self.candidate = candidate
        self.stamp = stamp


class DockKnowledge:
    """Follows the robot's odometry and takes in what the camera sees.

    Args:
        dock: what the database says.
        dock_pose: its rough pose in the odometry frame.
        mount: of the camera on the robot.
        settings: see `DockingSettings`.
        rng: for the cloud.
    """

    def __init__(
        self,
        dock: Dock,
        dock_pose: PlanarPose,
        mount: CameraMount,
        settings: DockingSettings,
        rng: np.random.Generator,
    ):
        self.dock, self.mount = dock, mount
        self._dock_pose, self._settings, self._rng = dock_pose, settings, rng
        self.track = OdometryTrack()
        self.cloud: Optional[DockCloud] = None
        self.prior: Optional[DockPrior] = None
        self._database: Optional[DockPrior] = None
        self.view: Optional[View] = None
        self._camera = None
        self._tracked: List[_Tracked] = []
        self.last_image = -math.inf
        self.images = 0

    # What is known ----------------------------------------------------------------------------

    @property
    def pose(self) -> PlanarPose:
        """Of the robot in the odometry frame."""
        return self.track.last.pose

    def best(self) -> Optional[Candidate]:
        """Return the candidate to go for; None where none is plausible."""
        plausible = [t.candidate for t in self._tracked if self._plausible(t.candidate)]
        return max(plausible, key=lambda c: c.real, default=None)

    def _plausible(self, candidate: Candidate) -> bool:
        return candidate.frames >= 3 and candidate.real > _HARDLY_REAL

    def pending(self) -> bool:
        """Say whether something may turn out to be the marker with some more images."""
        candidates = [tracked.candidate for tracked in self._tracked]
        return any(c.frames < 3 and c.real > _HARDLY_REAL for c in candidates)

    def last_seen(self, candidate: Candidate) -> float:
        """Return the time of the last image that showed a candidate, in s."""
        return next((t.stamp for t in self._tracked if t.candidate is candidate), -math.inf)

    def robot_in_dock(self, estimate: DockEstimate) -> np.ndarray:
        """Return the pose (3,) of the robot in the dock's frame."""
        return se2.inverse(estimate.mean)

    def samples(self, count: int) -> np.ndarray:
        """Draw (count, 3) poses of the dock in the odometry frame."""
        best = self.best()
        if best is None:
            drawn = self.cloud.samples(count)
        else:
            doubtful = int(round(count * min(1.0 - best.real, 0.5))) if best.real < 0.9 else 0
            drawn = best.samples(self._rng, count - doubtful)
            if doubtful:
                drawn = np.concatenate([drawn, self.cloud.samples(doubtful)])
        return se2.compose(self.pose, drawn)

    def obstacles(self) -> np.ndarray:
        """Return what bears copies of the marker as (n, 4) x, y, radius, weight (odometry)."""
        rows = [np.empty((0, 4))]
        for tracked in self._tracked:
            candidate = tracked.candidate
            if candidate.real > 0.5 or candidate.frames < 3:
                continue
            places, sizes, weights = candidate.copies()
            flat = np.column_stack([places, np.zeros(len(places))])
            world = se2.compose(self.pose, flat)
            rows.append(np.column_stack([world[:, :2], 0.65 * sizes, weights]))
        return np.concatenate(rows)

    def copies_seen(self) -> bool:
        """Say whether something else that shows the wanted marker is in sight."""
        return any(
            t.candidate.frames >= 3 and self.last_image - t.stamp < 2.0 for t in self._tracked
        )

    def copy_on_the_wall(self) -> Optional[Candidate]:
        """Return a copy of the marker that stands where only the dock's back wall can be."""
        for tracked in self._tracked:
            candidate = tracked.candidate
            if candidate.real > _HARDLY_REAL or candidate.frames < 5:
                continue
            if candidate.sized < _SURE_OF_SIZE:
                continue
            pose = candidate.likeliest().mean
            if self._database.excess(pose[None].copy())[0] <= 0.0:
                return candidate
        return None

    # What it is told --------------------------------------------------------------------------

    def add_odometry(self, odometry: Odometry) -> Optional[MotionStep]:
        """Follow the odometry; returns the step, None for the first message."""
        before = self.track.last
        self.track.add(odometry)
        if before is None:
            rough = se2.between(odometry.pose, self._dock_pose)
            self.cloud = DockCloud(self.dock, tuple(rough.tolist()), self._rng)
            self.prior = self._database = self.cloud.prior()
            return None
        step = motion_step(before, odometry)
        self.cloud.move(step)
        self.prior, self._database = self.prior.moved(step), self._database.moved(step)
        for tracked in self._tracked:
            tracked.candidate.move(step)
        return step

    def observe(self, observation: Observation) -> None:
        """Take in an image; one older than the memory of the odometry is ignored."""
        then = self.track.pose_at(observation.stamp)
        if then is None:
            return
        if observation.camera is not self._camera:
            self._camera = observation.camera
            self.view = self._make_view()
        self.last_image = max(self.last_image, observation.stamp)
        self.images += 1
        moved = tuple(se2.between(self.pose, then).tolist())
        view = Viewpoint(observation.camera, self.mount, moved)
        corners = [s.corners for s in observation.sightings if self._wanted(s)]
        self._associate([np.asarray(c, dtype=float) for c in corners], view, observation.stamp)
        self._agree_on_yaw()

    def narrow(self, estimate: DockEstimate, play: float) -> None:
        """Believe that the dock is at a pose, with so much more play to either side in m."""
        self.cloud.gather(estimate, play)
        self.prior = self.cloud.prior()

    def forget(self, candidate: Candidate) -> None:
        """Drop a candidate that is not where it should be; the cloud keeps a trace of it."""
        if candidate.real > 0.3:
            drawn = candidate.samples(self._rng, 200)
            drawn = drawn + self._rng.standard_normal(drawn.shape) * (0.1, 0.1, 0.06)
            self.cloud.widen(drawn, 0.6)
        self._tracked = [t for t in self._tracked if t.candidate is not candidate]

    def _make_view(self) -> View:
        farthest = self._camera.fy * self.dock.marker.size / self._settings.smallest_marker
        return View(self.dock, self._camera, self.mount.z, farthest)

    def _wanted(self, sighting) -> bool:
        marker, camera = self.dock.marker, self._camera
        if sighting.id != marker.id or plain_name(sighting.dictionary) != plain_name(
            marker.dictionary
        ):
            return False
        corners = np.asarray(sighting.corners, dtype=float)
        if corners.shape != (4, 2) or not np.isfinite(corners).all():
            return False
        u, v = corners[:, 0], corners[:, 1]
        inside = min(u.min(), v.min(), camera.width - 1 - u.max(), camera.height - 1 - v.max())
        return inside >= _BORDER and extent_of(corners) >= _SMALLEST

    def _associate(self, sightings: List[np.ndarray], view: Viewpoint, stamp: float) -> None:
        """Give each sighting to the candidate that it fits best, or make a new one of it."""
        pairs = []
        for number, corners in enumerate(sightings):
            for tracked in self._tracked:
                cost = _association_cost(tracked.candidate, corners, view)
                if cost is not None:
                    pairs.append((cost, number, tracked))
        owners: Dict[int, _Tracked] = {}
        for _, number, tracked in sorted(pairs, key=lambda pair: pair[0]):
            if number not in owners and tracked not in owners.values():
                owners[number] = tracked
        self._drop_twins(pairs, owners)
        for number, tracked in owners.items():
            tracked.candidate.see(sightings[number], view)
            tracked.stamp = stamp
        for number, corners in enumerate(sightings):
            if number not in owners:
                self._begin(corners, view, stamp)

    def _agree_on_yaw(self) -> None:
        """Set right the yaw of a small marker by a larger copy on the same wall."""
        copy = self.copy_on_the_wall()
        if copy is None:
            return
        other = copy.likeliest()
        for tracked in self._tracked:
            if tracked.candidate is not copy:
                variance = float(other.covariance[2, 2]) + SAME_WALL**2
                tracked.candidate.agree(float(other.mean[2]), variance)

    def _drop_twins(self, pairs, owners: Dict[int, _Tracked]) -> None:
        """Drop younger candidates for what belongs to an older one: it is one thing."""
        for _, number, tracked in pairs:
            owner = owners.get(number)
            if owner is None or tracked in owners.values() or tracked not in self._tracked:
                continue
            if tracked.candidate.frames < owner.candidate.frames:
                self._tracked.remove(tracked)

    def _begin(self, corners: np.ndarray, view: Viewpoint, stamp: float) -> None:
        marker, noise = self.dock.marker, self._settings.noise
        candidate = Candidate(corners, view, marker.size, marker.height, self.prior, noise)
        self._tracked.append(_Tracked(candidate, stamp))
        if len(self._tracked) > _MOST_CANDIDATES:
            self._tracked.remove(
                min(self._tracked, key=lambda t: (t.candidate.frames >= 3, t.stamp))
            )


def plain_name(dictionary: str) -> str:
    """Return the name of a dictionary without what differs between spellings."""
    name = dictionary.strip().lower()
    return name[len("dict_") :] if name.startswith("dict_") else name


def _association_cost(
    candidate: Candidate, corners: np.ndarray, view: Viewpoint
) -> Optional[float]:
    """Return how badly corners fit a candidate, None if they are not of it.

    What was seen often is preferred to what is new and fits anything.
    """
    misfit, foretold = candidate.nearest(corners, view)
    if misfit < _FIT:
        return misfit - min(candidate.frames, _FAMILIAR)
    if not np.isfinite(foretold).all():
        return None
    extent, expected = extent_of(corners), extent_of(foretold)
    away = float(np.hypot(*(np.mean(corners, axis=0) - np.mean(foretold, axis=0))))
    if not 0.75 < extent / expected < 1.33 or away > max(25.0, 0.6 * extent):
        return None
    return 1e3 + away
