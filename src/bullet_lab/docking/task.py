"""Docking and undocking as tasks: they take odometry and images, and return commands."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import replace

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.docking.belief import DockBelief
from bullet_lab.docking.database import Dock
from bullet_lab.docking.geometry import misfit
from bullet_lab.docking.progress import DockAxis, DockingFailureError, DockingProgress
from bullet_lab.docking.states import TRANSITIONS, LookForMarker, Outcome, State
from bullet_lab.docking.types import (
    CameraMount,
    DockingError,
    DockingResult,
    DockingSettings,
    DockingState,
    MotionStep,
    Observation,
    Odometry,
    motion_step,
)
from bullet_lab.drive import STANDSTILL, Command, clip
from bullet_lab.navigation.paths import ACCELERATION, Point

USUAL = DockingSettings()
"""The settings by default."""

_UNKNOWN = (math.nan, math.nan, math.nan)
_MOST_WAITING = 50
_TURN_ACCELERATION = 2.0  # rad/s²
# Without odometry, and without any image while they are wanted, s.
_ODOMETRY_TIMEOUT = 1.0
_IMAGE_TIMEOUT = 3.0
# States that may follow each other in one tick.
_MOST_TRANSITIONS = 3
# Of an undocking: its time limit, s to look for the marker before it, and m from the goal at which
# it is reached.
_UNDOCKING_LIMIT = 60.0
_LOOK_SECONDS = 1.5
_UNDOCKED = 0.003
# A robot is stuck if in so many seconds it was commanded to move by so much, m or rad, and did less
# than this share of it.
_SECONDS = 2.0
_LEAST_DISTANCE = 0.08
_LEAST_TURN = 0.25
_DONE = 0.3


class StuckWatch:
    """Compares the commands of the last seconds with the odometry."""

    def __init__(self):
        # Seconds, distance and turn by the command, distance and turn by the odometry.
        self._past: deque[tuple[float, float, float, float, float]] = deque()

    def add(self, command: Command, step: PlanarPose, seconds: float) -> None:
        """Take a step of the odometry, how long it took, and the command (m/s, rad/s) then."""
        v, w = (abs(part) * seconds for part in command)
        self._past.append((seconds, v, w, abs(step[0]), abs(step[2])))
        while sum(entry[0] for entry in self._past) > _SECONDS:
            self._past.popleft()

    def is_stuck(self) -> bool:
        """Return whether the robot was commanded to move, and did not."""
        _, distance, turn, driven, turned = map(sum, zip(*self._past or [(0.0,) * 5]))
        if distance > _LEAST_DISTANCE and driven < _DONE * distance:
            return True
        return turn > _LEAST_TURN and turned < _DONE * turn


class WatchedTask(ABC):
    """Base of all tasks: limits of time, odometry and acceleration, and stuck wheels.

    Pass it all odometry and one observation for each image that it wants, and call `tick` at a
    steady rate (20 Hz). All stamps are in seconds of one clock.

    The belief of the dock's pose has the odometry and the settings.

    Attributes:
        done: what the task is when it has succeeded, in a word.
        result: how it ended; None before.
    """

    done = "docked"

    def __init__(self, belief: DockBelief):
        self._belief, self._settings = belief, belief.settings
        self._command = STANDSTILL
        self._stuck = StuckWatch()
        self._started: float | None = None
        self._now = 0.0
        self.result: DockingResult | None = None

    def add_odometry(self, odometry: Odometry) -> None:
        """Take the next message of odometry; an impossible one ends the task."""
        if self.result is not None:
            return
        last = self._belief.odometry.last
        if not all(map(math.isfinite, odometry.pose)):
            self._end(DockingError.ODOMETRY_LOST, "odometry is not finite")
        elif last is None:
            self._move(odometry)
        else:
            step, seconds = motion_step(last, odometry), odometry.stamp - last.stamp
            trouble = self._find_trouble(step, seconds)
            if trouble:
                self._end(DockingError.ODOMETRY_LOST, trouble)
            elif seconds > 0.0:
                self._stuck.add(self._command, step.step, seconds)
                self._move(odometry)

    @abstractmethod
    def add_observation(self, observation: Observation) -> None:
        """Take the sightings in an image."""

    @property
    @abstractmethod
    def wants_images(self) -> bool:
        """Whether an image would be used now."""

    def tick(self, stamp: float) -> Command:
        """Return the command (m/s, rad/s) for now."""
        if self.result is not None:
            return STANDSTILL
        if self._started is None:
            self._started, self._now = stamp, stamp - 0.05
        seconds, self._now = min(max(stamp - self._now, 0.0), 0.2), stamp
        try:
            self._check()
            target = self._advance()
        except DockingFailureError as failure:
            self._end(failure.error, str(failure))
            return STANDSTILL
        if target is None:
            self._command = STANDSTILL
        else:
            parts = zip(self._command, target, (ACCELERATION, _TURN_ACCELERATION))
            v, w = (now + clip(aim - now, limit * seconds) for now, aim, limit in parts)
            self._command = (v, w)
        return self._command

    @abstractmethod
    def _advance(self) -> Command | None:
        """Return the command to go for, None to stop at once; may end the task."""

    def _move(self, odometry: Odometry) -> None:
        """Follow odometry that was accepted."""
        self._belief.add_odometry(odometry)

    def _find_trouble(self, step: MotionStep, seconds: float) -> str:
        """Return why a step of the odometry is impossible; empty if it is not."""
        if seconds <= 0.0:
            return "odometry went back in time" if seconds < -0.5 else ""
        distance, turn = math.hypot(step.step[0], step.step[1]), abs(step.step[2])
        spread = 6.0 * np.sqrt(np.maximum(np.diag(step.covariance), 0.0))
        farthest = 1.5 * self._settings.drive_speed * seconds + 0.08 + spread[0] + spread[1]
        if distance > farthest:
            return f"odometry jumped by {distance:.2f} m"
        if turn > 1.5 * self._settings.turn_speed * seconds + 0.12 + spread[2]:
            return f"odometry jumped by {math.degrees(turn):.0f} degrees"
        return ""

    def _check(self) -> None:
        """Raise DockingFailureError if the task cannot go on."""
        limit, last = self._settings.time_limit, self._belief.odometry.last
        if self._now - self._started > limit:
            message = f"not {self.done} after {limit:g} s"
            raise DockingFailureError(DockingError.TIMED_OUT, message)
        quiet = self._now - (self._started if last is None else last.stamp)
        if quiet > _ODOMETRY_TIMEOUT:
            raise DockingFailureError(DockingError.ODOMETRY_LOST, f"no odometry for {quiet:.1f} s")
        if self._stuck.is_stuck():
            message = "the robot does not move as commanded"
            raise DockingFailureError(DockingError.BLOCKED, message)

    def _end(self, error: DockingError, message: str) -> None:
        self.result = self._make_result(error, message)
        self._command = STANDSTILL

    def _make_result(self, error: DockingError, message: str) -> DockingResult:
        return DockingResult(error, message)


class DockingTask(WatchedTask):
    """Drives a robot into a dock whose rough pose in the odometry frame is `dock_pose`.

    `mount` is where the camera is on the robot, and `seed` that of the particles of possible docks.
    """

    def __init__(
        self,
        dock: Dock,
        dock_pose: PlanarPose,
        mount: CameraMount,
        settings: DockingSettings = USUAL,
        seed: int = 0,
    ):
        # Independent of noise that is drawn from the same seed.
        rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(1)[0])
        belief = DockBelief(dock, dock_pose, mount, settings, rng)
        super().__init__(belief)
        self._progress = DockingProgress(belief)
        self._state: State = LookForMarker()
        self._waiting: deque[Observation] = deque(maxlen=_MOST_WAITING)
        self._wanted_since = math.inf
        self._camera: PinholeCamera | None = None

    def add_observation(self, observation: Observation) -> None:
        """Take the sightings in an image; they are used once odometry has come that far.

        The first one of a camera that cannot see the marker from the dock ends the docking.
        """
        if self.result is not None:
            return
        if observation.camera != self._camera:
            self._camera = observation.camera
            trouble = misfit(self._belief.dock, self._camera, self._belief.mount)
            if trouble:
                self._end(DockingError.NOT_VALID, trouble)
                return
        self._waiting.append(observation)
        if self._belief.odometry.last is not None:
            self._observe()

    def _move(self, odometry: Odometry) -> None:
        first = self._belief.odometry.last is None
        self._belief.add_odometry(odometry)
        free = self._belief.stands_free()
        if first and not free:
            self._end(DockingError.NOT_VALID, "the robot stands where the dock's walls must be")
        else:
            self._observe()

    def _observe(self) -> None:
        """Use the images that odometry has come up to."""
        last = self._belief.odometry.last
        while self._waiting and self._waiting[0].stamp <= last.stamp + 1e-6:
            self._belief.observe(self._waiting.popleft())

    @property
    def state(self) -> DockingState:
        """The present state."""
        return self._state.state

    @property
    def retries(self) -> int:
        """How often the robot retreated to try again."""
        return self._progress.retries

    @property
    def plan(self) -> tuple[Point, ...]:
        """The points (m, m) still to be driven to, in the odometry frame."""
        return self._state.plan()

    @property
    def dock_pose(self) -> PlanarPose | None:
        """The dock's pose in the odometry frame, None before the marker was seen."""
        estimate = self._belief.estimate()
        if estimate is None:
            return None
        return tuple(se2.compose(self._belief.pose, estimate.mean).tolist())

    @property
    def place(self) -> tuple[float, float, float]:
        """Distance, lateral offset and yaw of the robot as in DockingResult; NaN: unknown."""
        estimate = self._belief.estimate()
        if estimate is None:
            return _UNKNOWN
        _, beside, turned = estimate.robot
        return self._progress.left + self._belief.dock.docked_distance, beside, turned

    @property
    def wants_images(self) -> bool:
        """Whether an image would be used now."""
        if self.result is not None or self._belief.visibility is None:
            return self.result is None
        return self._state.wants_images(self._progress)

    def tick(self, stamp: float) -> Command:
        """Return the command (m/s, rad/s) for now."""
        self._progress.now = stamp
        command = super().tick(stamp)
        if self._belief.visibility is not None:
            self._progress.note_command(command)
        return command

    def _advance(self) -> Command | None:
        if self._belief.visibility is None:
            return None
        target = self._ask_states()
        if self.state == DockingState.DOCKED:
            self._end(DockingError.NONE, "docked")
            return None
        return target

    def _ask_states(self) -> Command:
        """Ask the state, and those that follow at once, for a command (m/s, rad/s)."""
        for _ in range(_MOST_TRANSITIONS):
            result = self._state.step(self._progress)
            if not isinstance(result, Outcome):
                return result
            following = TRANSITIONS[type(self._state)][result.name]
            self._state = following(*result.arguments)
        return STANDSTILL

    def _check(self) -> None:
        super()._check()
        wanted = self.wants_images
        self._wanted_since = min(self._wanted_since, self._now) if wanted else math.inf
        quiet = self._now - max(self._wanted_since, self._belief.last_image)
        if quiet > _IMAGE_TIMEOUT:
            raise DockingFailureError(DockingError.CAMERA_LOST, f"no image for {quiet:.1f} s")

    def _make_result(self, error: DockingError, message: str) -> DockingResult:
        if self._belief.estimate() is None:
            return DockingResult(error, message, self.retries)
        learned = self._belief.best().learned()
        remarks = learned.remarks()
        message += f" (differs from nominal: {remarks})" if remarks else ""
        return DockingResult(error, message, self.retries, *self.place, learned)


class UndockingTask(WatchedTask):
    """Backs out on the dock's axis if the marker is seen, else straight by the odometry.

    The arguments are those of `DockingTask`, but:
        distance: how far, m; 0: until the robot is at the staging distance from the marker.
        mount: None: images are of no use.

    Attributes:
        remaining: how far it still is, m; NaN before it begins.
    """

    done = "undocked"

    def __init__(
        self,
        distance: float,
        dock: Dock,
        dock_pose: PlanarPose,
        mount: CameraMount | None,
        settings: DockingSettings = USUAL,
    ):
        settings = replace(settings, time_limit=_UNDOCKING_LIMIT)
        self._sees = mount is not None
        mount = mount or CameraMount(0.0, 0.0, 0.0)
        belief = DockBelief(dock, dock_pose, mount, settings, np.random.default_rng(0))
        super().__init__(belief)
        self._distance = distance
        self._docked = np.array([dock.docked_distance + mount.x, 0.0, 0.0])
        self._axis = DockAxis(belief)
        self._start: PlanarPose | None = None
        self._goal: float | None = None
        self.remaining = math.nan

    @property
    def wants_images(self) -> bool:
        """Whether an image would be used now."""
        return self.result is None and self._sees

    def add_observation(self, observation: Observation) -> None:
        """Take the sightings in an image."""
        if self.wants_images and self._belief.odometry.last is not None:
            self._belief.observe(observation)

    def _advance(self) -> Command | None:
        best, last = self._belief.best(), self._belief.odometry.last
        looking = self._sees and self._now - self._started <= _LOOK_SECONDS
        if last is None or (best is None and looking):
            return None
        if self._start is None:
            self._start = last.pose
        if best is None:
            # By odometry: it began in a dock.
            robot = (se2.between(self._start, last.pose) - self._docked).tolist()
        else:
            robot = best.estimate().robot
        if self._goal is None:
            far = self._belief.dock.staging_distance if self._distance == 0.0 else 0.0
            self._goal = far or self._distance - robot[0]
        self.remaining = self._goal + robot[0]
        if self.remaining <= _UNDOCKED:
            self.remaining = 0.0
            self._end(DockingError.NONE, "undocked")
            return None
        return self._axis.backwards(robot, self.remaining)
