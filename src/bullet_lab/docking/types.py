"""Inputs, outputs and settings of docking, as plain data; and steps between odometry messages.

Planar poses are (x m, y m, yaw rad). The pose of a dock is that of the point of the floor below
its marker's face, with the yaw of a robot that stands in it.
"""

from __future__ import annotations

import bisect
import functools
import math
from collections import deque
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from bullet_lab.core import se2
from bullet_lab.core.parameters import integer, number
from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.se2 import PlanarPose

HALF_WIDTH = 0.20
"""Half the edge of the robot, a square about the middle of its axle, m."""

TURNING_RADIUS = float(np.hypot(HALF_WIDTH, HALF_WIDTH))
"""Radius of the circle that the robot needs to turn on the spot, m."""

# Variances by distance and turn of wheels that slip, added to those of the odometry.
_ALONG = 0.004**2  # m²/m
_TURN_BY_DISTANCE = 0.004**2  # rad²/m
_TURN_BY_TURN = 0.006**2  # rad²/rad
_ACROSS_BY_DISTANCE = 0.0015**2  # m²/m
_ACROSS_BY_TURN = 0.002**2  # m²/rad
# Odometry that is kept, s.
_MEMORY = 3.0


class DockingState(IntEnum):
    """State that is reported, numbered as in action/Dock.action."""

    SEARCHING = 1
    STAGING = 2
    MEASURING = 3
    APPROACHING = 4
    RETREATING = 5
    DOCKED = 6


class DockingError(IntEnum):
    """Reason of a failure, numbered as in action/Dock.action."""

    NONE = 0
    NOT_IN_DATABASE = 901
    NOT_VALID = 902
    STAGING_FAILED = 903
    NOT_DETECTED = 904
    CONTROL_FAILED = 905
    TIMED_OUT = 906
    CAMERA_LOST = 907
    ODOMETRY_LOST = 908
    BLOCKED = 909
    PREEMPTED = 910
    UNKNOWN = 999


@dataclass(frozen=True)
class Odometry:
    """One message of odometry: stamp in s, and pose in the odometry frame.

    `twist_covariance` is (3, 3) of (vx, vy, wz) over the time since the message before; zeros or
    None: unknown.
    """

    stamp: float
    pose: PlanarPose
    twist_covariance: ndarray | None = None


@dataclass(frozen=True, eq=False)
class MotionStep:
    """A step of the robot in its frame before it: (dx m, dy m, dyaw rad) and (3, 3) covariance."""

    step: PlanarPose
    covariance: ndarray

    def then(self, after: MotionStep) -> MotionStep:
        """Return this step and the next one as one, for short ones: the covariances are added."""
        step = tuple(se2.compose(self.step, after.step).tolist())
        return MotionStep(step, self.covariance + after.covariance)


def motion_step(before: Odometry, after: Odometry) -> MotionStep:
    """Return the step between two messages of odometry.

    >>> motion_step(Odometry(0.0, (1.0, 0.0, 0.0)), Odometry(0.1, (1.5, 0.0, 0.0))).step
    (0.5, 0.0, 0.0)
    """
    step = tuple(se2.between(before.pose, after.pose).tolist())
    distance, turn = math.hypot(step[0], step[1]), abs(step[2])
    along = _ALONG * distance
    across = _ACROSS_BY_DISTANCE * distance + _ACROSS_BY_TURN * turn
    rotation = _TURN_BY_DISTANCE * distance + _TURN_BY_TURN * turn
    covariance = np.diag([along, across, rotation])
    if after.twist_covariance is not None:
        covariance = covariance + after.twist_covariance * (after.stamp - before.stamp) ** 2
    return MotionStep(step, covariance)


class OdometryBuffer:
    """Poses of the last seconds, to know where the robot was when an image was taken."""

    def __init__(self):
        self._past: deque[Odometry] = deque()

    @property
    def last(self) -> Odometry | None:
        """The newest message."""
        return self._past[-1] if self._past else None

    def add(self, odometry: Odometry) -> None:
        """Take the next message."""
        self._past.append(odometry)
        while odometry.stamp - self._past[0].stamp > _MEMORY and len(self._past) > 2:
            self._past.popleft()

    def pose_at(self, stamp: float) -> PlanarPose | None:
        """Return the pose at a time (s), interpolated; the newest after it, None before all."""
        if not self._past or stamp < self._past[0].stamp - 1e-6:
            return None
        after = bisect.bisect_right([one.stamp for one in self._past], stamp + 1e-9)
        if not 0 < after < len(self._past):
            return self._past[max(after, 1) - 1].pose
        before, after = self._past[after - 1], self._past[after]
        part = max((stamp - before.stamp) / (after.stamp - before.stamp), 0.0)
        step = se2.between(before.pose, after.pose)
        return tuple(se2.compose(before.pose, part * step).tolist())


@dataclass(frozen=True)
class CameraMount:
    """Pose of the camera, x ahead and z up, in base_footprint: m and rad (fixed axes x, y, z)."""

    x: float
    y: float
    z: float
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0

    @functools.cached_property
    def rotation(self) -> ndarray:
        """The (3, 3) matrix that turns directions of the camera into base_footprint."""
        sr, cr = np.sin(self.roll), np.cos(self.roll)
        sp, cp = np.sin(self.pitch), np.cos(self.pitch)
        sy, cy = np.sin(self.yaw), np.cos(self.yaw)
        return np.array(
            [
                [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                [-sp, cp * sr, cp * cr],
            ]
        )


@dataclass(frozen=True, eq=False)
class Sighting:
    """A marker in an image: its id, its dictionary as OpenCV names it, and its corners.

    These are (4, 2) px of the raw image: top left, top right, bottom right, bottom left. The
    `deviations` (4, 2) px of u and v of each, by the image itself, may be unknown.
    """

    id: int
    dictionary: str
    corners: ndarray
    deviations: ndarray | None = None


@dataclass(frozen=True, eq=False)
class Observation:
    """All sightings in one image; also given when there are none."""

    stamp: float
    camera: PinholeCamera
    sightings: tuple[Sighting, ...] = ()


@dataclass(frozen=True)
class DockingSettings:
    """Speeds and limits, which are parameters of the node dock but for `search`."""

    search: bool = True  #: for the marker where it is not seen at once
    drive_speed: float = number(0.4, "m/s, far from the dock", above=0.0, maximum=1.0)
    approach_speed: float = number(0.25, "m/s on the dock's axis", above=0.0, maximum=1.0)
    turn_speed: float = number(0.8, "rad/s on the spot", above=0.0, maximum=2.0)
    max_retries: int = integer(5, "how often to retreat and try again", minimum=0, maximum=1000)
    time_limit: float = number(300.0, "s for a docking", above=0.0)


class Learned(NamedTuple):
    """A value, and its standard deviation."""

    value: float
    deviation: float


_DEGREES = 180.0 / math.pi
# Of each of the calibration errors: how it is called, its factor, and the least that is remarked.
_REMARKS = (
    ("° roll", _DEGREES, 0.3),
    ("° pitch", _DEGREES, 0.3),
    ("° yaw", _DEGREES, 0.3),
    (" mm height", 1e3, 5.0),
    (" % way", 100.0, 1.0),
    (" % turn", 100.0, 2.0),
    ("°/m drift", _DEGREES, 0.3),
)


class CalibrationErrors(NamedTuple):
    """Estimated errors of camera and odometry, each against its nominal value."""

    roll: Learned  #: rad, of the camera about the direction it looks in
    pitch: Learned  #: rad, of the camera, down
    yaw: Learned  #: rad, of the camera, to the left
    height: Learned  #: m, of the marker above the camera
    way: Learned  #: true / reported distance - 1; a wrong printed size looks the same
    turn: Learned  #: true / reported turn - 1
    drift: Learned  #: rad/m, unreported turn to the left when driving ahead

    def remarks(self) -> str:
        """Return the errors that are large and certain (four standard deviations) as text."""
        remarks = []
        for (value, deviation), (unit, scale, least) in zip(self, _REMARKS):
            if abs(value) > 4.0 * deviation and abs(scale * value) > least:
                remarks.append(f"{scale * value:+.2g}{unit}")
        return ", ".join(remarks)


@dataclass(frozen=True)
class DockingResult:
    """Result of a docking, with the estimates at the end; NaN: unknown."""

    error: DockingError  #: NONE after a success
    message: str  #: one line for the user
    retries: int = 0  #: how often it retreated to try again
    distance: float = math.nan  #: m, camera to marker along the dock's axis
    lateral: float = math.nan  #: m, of the robot from the axis, left positive
    yaw: float = math.nan  #: rad, of the robot against the axis
    calibration: CalibrationErrors | None = None  #: None if the marker was not found

    @property
    def success(self) -> bool:
        """Whether the robot has docked or undocked."""
        return self.error == DockingError.NONE
