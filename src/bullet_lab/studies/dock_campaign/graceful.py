"""Controllers that drive into a dock, by name: `DockingTask`, and another one to compare it with.

The other one, `GracefulTask`, docks as nav2's docking server does. The robot drives to a staging
pose by the database, waits until it sees the marker, and drives to the filtered pose of the dock by
the smooth control law of J. J. Park and B. Kuipers, "A smooth control law for graceful motion of
differential wheeled mobile robots in 2D environment", ICRA 2011, as opennav_docking and
nav2_graceful_controller do. If it loses the dock, or takes too long, it goes back to the staging
pose by the same law and tries again. Parameters have nav2's names and defaults. The paths to the
staging pose, the limits of acceleration and the watch over odometry and wheels are those of
`DockingTask`.

A further controller is a subclass of `WatchedTask` in a file of its own, and a line in CONTROLLERS.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Callable

import numpy as np
from numpy import ndarray

from bullet_lab.core import se2
from bullet_lab.core.pinhole import OPTICAL_AXES, PinholeCamera
from bullet_lab.core.se2 import PlanarPose, wrap, wrapped
from bullet_lab.docking.belief import DockBelief
from bullet_lab.docking.database import Dock
from bullet_lab.docking.filter import GaussianPose
from bullet_lab.docking.paths import PathPlanner
from bullet_lab.docking.progress import DockingFailureError
from bullet_lab.docking.task import USUAL, DockingTask, WatchedTask
from bullet_lab.docking.types import (
    CameraMount,
    DockingError,
    DockingResult,
    Observation,
    Odometry,
)
from bullet_lab.drive import STANDSTILL, Command, clip
from bullet_lab.navigation.paths import PathFollower, turn_command
from bullet_lab.vision.images import VisionError
from bullet_lab.vision.marker_pose import estimate_pose
from bullet_lab.vision.pose_fit import MarkerPose

_NEAREST = 1e-3


@dataclass(frozen=True)
class GracefulSettings:
    """Parameters by nav2's names and with its defaults; lengths in m, angles in rad, times in s."""

    k_phi: float = 3.0  #: how fast the heading comes to point at the way, against the distance
    k_delta: float = 2.0  #: how fast it comes to be what the first asks for
    beta: float = 0.4  #: how much speed is lost by curvature
    lambda_: float = 2.0  #: how sharply it is lost
    v_linear_min: float = 0.1
    v_linear_max: float = 0.25
    v_angular_max: float = 0.75
    slowdown_radius: float = 0.25  #: from the aim, within which it slows down
    backward_projection: float = 0.25  #: of the aim behind the dock's pose, out of the singularity
    #: of the pose that it is to stand at, ahead; nav2's default is that of another marker's place
    external_detection_translation_x: float = 0.0
    docking_threshold: float = 0.05  #: from the dock's pose, where it is held to be docked
    filter_coef: float = 0.1  #: of a detection in the filtered pose, at each tick
    external_detection_timeout: float = 1.0  #: after which the dock is lost
    initial_perception_timeout: float = 5.0
    dock_approach_timeout: float = 30.0
    dock_prestaging_tolerance: float = 0.5  #: from the staging pose, within which it is not gone to
    undock_linear_tolerance: float = 0.05  #: of the way back to the staging pose
    undock_angular_tolerance: float = 0.05
    max_retries: int = 3


NAV2 = GracefulSettings()
"""nav2's defaults."""


def graceful_command(target, settings: GracefulSettings, backwards: bool = False) -> Command:
    """Return the command (m/s, rad/s) towards a target pose (3,) in the robot's frame.

    With r, theta and delta as in Park and Kuipers: distance, and angles of target and robot against
    the line of sight.

    >>> graceful_command((2.0, 0.0, 0.0), GracefulSettings())
    (0.25, 0.0)
    """
    x, y, heading = (float(value) for value in target)
    r = max(math.hypot(x, y), _NEAREST)
    sight = math.atan2(y, x) + (math.pi if backwards else 0.0)
    theta, delta = wrap(heading - sight), wrap(-sight)
    k_phi = settings.k_phi
    fast = settings.k_delta * (delta - math.atan(-k_phi * theta))
    slow = (1.0 + k_phi / (1.0 + (k_phi * theta) ** 2)) * math.sin(delta)
    curvature = -(fast + slow) / r
    fastest = settings.v_linear_max
    v = fastest / (1.0 + settings.beta * abs(curvature) ** settings.lambda_)
    v = max(min(v, fastest * r / settings.slowdown_radius), settings.v_linear_min)
    w = clip(curvature * v, settings.v_angular_max)
    # If the turn is too fast, drive the same arc more slowly.
    v = w / curvature if curvature else v
    return (-v if backwards else v), w + 0.0


def filtered(pose: ndarray, measured: ndarray, coefficient: float) -> ndarray:
    """Return the exponentially smoothed pose of the dock, (3,), as nav2 has it."""
    return pose + coefficient * wrapped(measured - pose)


class GracefulTask(WatchedTask):
    """Docks as nav2's docking server does; made as a `DockingTask`."""

    def __init__(
        self,
        dock: Dock,
        dock_pose: PlanarPose,
        mount: CameraMount,
        settings: GracefulSettings = NAV2,
        seed: int = 0,
    ):
        # The belief gets no images: it knows the database only.
        belief = DockBelief(dock, dock_pose, mount, USUAL, np.random.default_rng(seed))
        super().__init__(belief)
        self._paths, self._law = PathPlanner(belief), settings
        self._database = np.array(dock_pose, dtype=float)
        self._staging = se2.compose(dock_pose, (-dock.staging_distance, 0.0, 0.0))
        ahead = settings.external_detection_translation_x
        self._stop = np.array([ahead - dock.docked_distance - mount.x, 0.0, 0.0])
        self._dock_pose: ndarray | None = None
        self._filtered_at = -math.inf
        self._detected: ndarray | None = None
        self._detected_at = -math.inf
        self._way: PathFollower | None = None
        self._phase: Callable[[], Command | None] = self._navigate
        self._since = 0.0
        self._retries = 0

    @property
    def wants_images(self) -> bool:
        """Whether an image would be used now."""
        return self.result is None and self._phase != self._navigate

    def _move(self, odometry: Odometry) -> None:
        if self._phase == self._navigate:
            self._belief.add_odometry(odometry)
            self._belief.stands_free()
        else:
            self._belief.odometry.add(odometry)

    def add_observation(self, observation: Observation) -> None:
        """Take the sightings in an image: the one that fits best is the dock."""
        then = self._belief.odometry.pose_at(observation.stamp)
        if then is None:
            return
        expected = self._database if self._dock_pose is None else self._dock_pose
        best = math.inf
        marker, mount = self._belief.dock.marker, self._belief.mount
        for sighting in filter(marker.is_shown_by, observation.sightings):
            for pose in marker_poses(sighting.corners, marker.size, observation.camera, mount):
                found = se2.compose(then, pose)
                off = found - expected
                away = math.hypot(off[0], off[1]) + abs(wrap(float(off[2])))
                if away < best:
                    best, self._detected, self._detected_at = away, found, observation.stamp

    def _advance(self) -> Command | None:
        return None if self._belief.odometry.last is None else self._phase()

    def _navigate(self) -> Command:
        """Drive to the staging pose."""
        pose, staging = self._belief.pose, self._staging
        if self._way is None:
            # As there, metres and radians together.
            if np.linalg.norm(se2.between(pose, staging)) < self._law.dock_prestaging_tolerance:
                return self._go_on(self._perceive)
            dock = GaussianPose(se2.between(pose, self._database), np.zeros((3, 3)))
            way = self._paths.way_to_staging(dock)
            if way is None:
                message = "no safe way to the staging pose"
                raise DockingFailureError(DockingError.STAGING_FAILED, message)
            self._way = PathFollower(way)
        settings = self._settings
        command = self._way.command(pose, settings.drive_speed, settings.turn_speed)
        if command == STANDSTILL:
            command = turn_command(wrap(float(staging[2]) - pose[2]), self._settings.turn_speed)
        return self._go_on(self._perceive) if command == STANDSTILL else command

    def _perceive(self) -> Command:
        """Wait for the marker."""
        if self._refine():
            return self._go_on(self._approach)
        if self._now - self._since > self._law.initial_perception_timeout:
            message = "the marker is not seen from the staging pose"
            raise DockingFailureError(DockingError.NOT_DETECTED, message)
        return STANDSTILL

    def _approach(self) -> Command | None:
        """Drive at the dock by the control law."""
        pose, law = self._belief.pose, self._law
        docked = se2.compose(self._dock_pose, self._stop)
        if math.dist(pose[:2], docked[:2]) < law.docking_threshold:
            self._end(DockingError.NONE, "docked")
            return None
        if not self._refine():
            return self._retry(DockingError.NOT_DETECTED, "the marker is lost")
        if self._now - self._since > law.dock_approach_timeout:
            return self._retry(DockingError.CONTROL_FAILED, "the dock is not reached")
        aim = self._stop + (law.backward_projection, 0.0, 0.0)
        return graceful_command(se2.between(pose, se2.compose(self._dock_pose, aim)), law)

    def _retry(self, error: DockingError, trouble: str) -> Command:
        if self._retries >= self._law.max_retries:
            raise DockingFailureError(error, f"gave up: {trouble}")
        self._retries += 1
        return self._go_on(self._reset)

    def _reset(self) -> Command:
        """Drive back to the staging pose by the control law."""
        law, target = self._law, se2.between(self._belief.pose, self._staging)
        there = math.hypot(target[0], target[1]) < law.undock_linear_tolerance
        if there and abs(target[2]) < law.undock_angular_tolerance:
            return self._go_on(self._approach)
        if self._now - self._since > law.dock_approach_timeout:
            message = "the staging pose is not reached again"
            raise DockingFailureError(DockingError.CONTROL_FAILED, message)
        return graceful_command(target, law, backwards=True)

    def _go_on(self, phase: Callable[[], Command | None]) -> Command:
        self._phase, self._since = phase, self._now
        return STANDSTILL

    def _refine(self) -> bool:
        """Filter the newest detection into the dock's pose; return whether there is one."""
        law, measured = self._law, self._detected
        if self._now - self._detected_at > law.external_detection_timeout:
            return False
        # After a gap in time it starts anew.
        if self._detected_at - self._filtered_at <= law.external_detection_timeout:
            measured = filtered(self._dock_pose, measured, law.filter_coef)
        self._dock_pose, self._filtered_at = measured, self._detected_at
        return True

    def _make_result(self, error: DockingError, message: str) -> DockingResult:
        seen = ()
        if self._dock_pose is not None:
            x, y, yaw = se2.between(self._dock_pose, self._belief.pose).tolist()
            seen = -x - self._belief.mount.x, y, yaw
        return DockingResult(error, message, self._retries, *seen)


def marker_poses(
    corners: ndarray, size: float, camera: PinholeCamera, mount: CameraMount
) -> list[ndarray]:
    """Return the poses (3,) that a dock may have in the robot's frame by one image of its marker.

    Two where the image leaves open which of a flat marker's poses it is; none where it shows none.
    `corners` are as in `Sighting`, `size` is the edge of the black square, m.
    """
    try:
        estimate = estimate_pose(corners, size, camera)
    except VisionError:
        return []
    poses = (estimate.best, estimate.alternative) if estimate.ambiguous else (estimate.best,)
    return [_planar(pose, mount) for pose in poses]


def _planar(pose: MarkerPose, mount: CameraMount) -> ndarray:
    turn = mount.rotation @ OPTICAL_AXES
    place = turn @ pose.translation + (mount.x, mount.y, mount.z)
    # A docked robot looks into the face, against the marker's z axis.
    ahead = -turn @ pose.rotation[:, 2]
    return np.array([place[0], place[1], math.atan2(ahead[1], ahead[0])])


TUNED = GracefulSettings(
    k_delta=3.0,
    v_linear_min=0.02,
    slowdown_radius=1.0,
    backward_projection=0.1,
    external_detection_translation_x=0.0075,
    docking_threshold=0.01,
    dock_approach_timeout=60.0,
)
"""Tuned to the docks and the robot of this package, see docs/docking.md."""

CONTROLLERS: dict[str, Callable[..., WatchedTask]] = {
    "ours": DockingTask,
    "graceful": functools.partial(GracefulTask, settings=TUNED),
    "graceful_nav2": GracefulTask,
}
"""The last one has nav2's defaults."""
