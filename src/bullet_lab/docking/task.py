"""Docking and undocking as tasks: they take odometry and images, and return commands."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from typing import Deque, Optional

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.docking.belief import DockBelief
from bullet_lab.docking.control import AxisTracker, CommandRamp
from bullet_lab.docking.database import Dock
from bullet_lab.docking.odometry import OdometryBuffer, StuckWatch, jump, motion_step
from bullet_lab.docking.planner import DockingFailureError, DockingPlanner
from bullet_lab.docking.state_machine import StateMachine
from bullet_lab.docking.types import (
    STANDSTILL,
    CameraMount,
    Command,
    DockingError,
    DockingResult,
    DockingSettings,
    DockingState,
    DockingStatus,
    Observation,
    Odometry,
    RobotShape,
)
from bullet_lab.errors import LabError

_MOST_WAITING = 50
# Seconds to look for the marker before undocking, and m from the goal at which it is reached.
_LOOK_SECONDS = 1.5
_UNDOCKED = 0.003


class DockingTaskError(LabError):
    """Invalid arguments of a docking."""


class UndockingTaskError(LabError):
    """Invalid arguments of an undocking."""


class WatchedTask(ABC):
    """Base of all tasks: limits of time, odometry and acceleration, and stuck wheels."""

    def __init__(
        self, done: str, odometry: OdometryBuffer, settings: DockingSettings, time_limit: float
    ):
        self._done, self._odometry = done, odometry
        self._settings, self._time_limit = settings, time_limit
        self._ramp, self._stuck = CommandRamp(settings), StuckWatch()
        self._started: Optional[float] = None
        self._last_tick: Optional[float] = None
        self.result: Optional[DockingResult] = None

    def tick(self, stamp: float) -> Command:
        """Return the command (m/s, rad/s) for now."""
        if self.result is not None:
            return self._ramp.stop()
        if self._started is None:
            self._started, self._last_tick = stamp, stamp - 0.05
        seconds, self._last_tick = stamp - self._last_tick, stamp
        try:
            self._check(stamp)
            target = self._advance(stamp)
        except DockingFailureError as failure:
            self._end(failure.error, str(failure))
            return STANDSTILL
        if target is None:
            return self._ramp.stop()
        command = self._ramp.towards(target, min(max(seconds, 0.0), 0.2))
        self._stuck.commanded(command)
        return command

    @abstractmethod
    def _advance(self, stamp: float) -> Optional[Command]:
        """Return the command to go for, None to stop at once; may end the task."""

    def _accept(self, odometry: Odometry) -> bool:
        """Return whether a message of odometry is usable; an impossible one ends the task."""
        before = self._odometry.last
        if not all(map(math.isfinite, odometry.pose)):
            self._end(DockingError.ODOMETRY_LOST, "odometry is not finite")
            return False
        if before is None:
            return True
        seconds = odometry.stamp - before.stamp
        if seconds <= 0.0:
            if seconds < -0.5:
                self._end(DockingError.ODOMETRY_LOST, "odometry went back in time")
            return False
        step = motion_step(before, odometry)
        trouble = jump(step, seconds, self._settings.drive_speed, self._settings.turn_speed)
        if trouble:
            self._end(DockingError.ODOMETRY_LOST, trouble)
            return False
        self._stuck.moved(step.step, seconds)
        return True

    def _check(self, stamp: float) -> None:
        """Raise DockingFailureError if the task cannot go on."""
        if stamp - self._started > self._time_limit:
            message = f"not {self._done} after {self._time_limit:g} s"
            raise DockingFailureError(DockingError.TIMED_OUT, message)
        last = self._odometry.last
        quiet = stamp - (self._started if last is None else last.stamp)
        if quiet > self._settings.odometry_timeout:
            raise DockingFailureError(DockingError.ODOMETRY_LOST, f"no odometry for {quiet:.1f} s")
        if self._stuck.stuck:
            message = "the robot does not move as commanded"
            raise DockingFailureError(DockingError.BLOCKED, message)

    def _end(self, error: DockingError, message: str) -> None:
        if self.result is None:
            self.result = self._make_result(error == DockingError.NONE, error, message)
        self._ramp.stop()

    def _make_result(self, success: bool, error: DockingError, message: str) -> DockingResult:
        return DockingResult(success, error, message)


class DockingTask(WatchedTask):
    """Drives a robot into a dock.

    Pass it all odometry and one observation for each image, and call `tick` at a steady rate
    (20 Hz). All stamps are in seconds of one clock.

    Args:
        dock: what is known of the dock.
        dock_pose: its rough pose in the odometry frame.
        mount: where the camera is on the robot.
        settings: speeds and patience.
        shape: of the robot.
        search: search for the marker if it is not seen at once.
        max_retries: retreats before it gives up; None or less than 0: as in the settings.
        time_limit: s; None: as in the settings.
        seed: of the particles of possible docks.

    Attributes:
        result: how it ended; None before.

    Raises:
        DockingTaskError: the pose is not finite.
    """

    def __init__(
        self,
        dock: Dock,
        dock_pose: PlanarPose,
        mount: CameraMount,
        settings: Optional[DockingSettings] = None,
        *,
        shape: Optional[RobotShape] = None,
        search: bool = True,
        max_retries: Optional[int] = None,
        time_limit: Optional[float] = None,
        seed: int = 0,
    ):
        if len(dock_pose) != 3 or not all(map(math.isfinite, dock_pose)):
            raise DockingTaskError(f"the pose {dock_pose} of dock '{dock.name}' is not finite")
        settings = settings or DockingSettings()
        shape = shape or RobotShape()
        # Independent of noise that is drawn from the same seed.
        rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(1)[0])
        self._belief = DockBelief(dock, dock_pose, mount, settings, rng)
        limit = settings.time_limit if time_limit is None else time_limit
        super().__init__("docked", self._belief.odometry, settings, limit)
        retries = settings.max_retries if max_retries is None or max_retries < 0 else max_retries
        self._planner = DockingPlanner(dock, self._belief, mount, shape, settings, search, retries)
        self._machine = StateMachine(self._planner)
        self._waiting: Deque[Observation] = deque(maxlen=_MOST_WAITING)
        self._wanted_since: Optional[float] = None
        self._camera: Optional[PinholeCamera] = None

    def add_odometry(self, odometry: Odometry) -> None:
        """Take the next message of odometry; an impossible one ends the docking."""
        first = self._odometry.last is None
        if self.result is not None or not self._accept(odometry):
            return
        self._belief.add_odometry(odometry)
        shape = self._planner.shape
        filled = min(shape.front, shape.rear, shape.half_width)
        free = self._belief.stands_free(filled)
        if first and not free:
            self._end(DockingError.NOT_VALID, "the robot stands where the dock's walls must be")
            return
        while self._waiting and self._waiting[0].stamp <= odometry.stamp + 1e-6:
            self._belief.observe(self._waiting.popleft())

    def add_observation(self, observation: Observation) -> None:
        """Take the sightings in an image; they are used once odometry has come that far.

        The first one of a camera that cannot see the marker from the dock ends the docking.
        """
        if self.result is not None:
            return
        if observation.camera != self._camera:
            self._camera = observation.camera
            trouble = self._planner.misfit(self._camera)
            if trouble:
                self._end(DockingError.NOT_VALID, trouble)
                return
        last = self._odometry.last
        if last is not None and observation.stamp <= last.stamp + 1e-6:
            self._belief.observe(observation)
        else:
            self._waiting.append(observation)

    @property
    def status(self) -> DockingStatus:
        """The present status."""
        planner, state = self._planner, self._machine.state
        rough = planner.result(False, DockingError.NONE, "")
        estimate = planner.estimate()
        pose = None
        if estimate is not None:
            pose = tuple(se2.compose(self._belief.pose, estimate.mean).tolist())
        seen = rough.distance, rough.lateral, rough.yaw, planner.retries
        return DockingStatus(
            state.state, *seen, self.wants_images, pose, state.plan(), state.detail
        )

    @property
    def state(self) -> DockingState:
        """The present state."""
        return self._machine.state.state

    @property
    def wants_images(self) -> bool:
        """Whether an image would be used now."""
        if self.result is not None or self._belief.visibility is None:
            return self.result is None
        return self._machine.state.wants_images(self._planner)

    def tick(self, stamp: float) -> Command:
        """Return the command (m/s, rad/s) for now."""
        self._planner.now = stamp
        command = super().tick(stamp)
        if self._belief.visibility is not None:
            self._planner.commanded(command)
        return command

    def _advance(self, stamp: float) -> Optional[Command]:
        if self._belief.visibility is None:
            return None
        self._planner.commanded(self._ramp.command)
        target = self._machine.step()
        if self.state == DockingState.DOCKED:
            self._end(DockingError.NONE, "docked")
            return None
        return target

    def _check(self, stamp: float) -> None:
        super()._check(stamp)
        if not self.wants_images:
            self._wanted_since = None
            return
        if self._wanted_since is None:
            self._wanted_since = stamp
        quiet = stamp - max(self._wanted_since, self._belief.last_image)
        if quiet > self._settings.image_timeout:
            raise DockingFailureError(DockingError.CAMERA_LOST, f"no image for {quiet:.1f} s")

    def _make_result(self, success: bool, error: DockingError, message: str) -> DockingResult:
        return self._planner.result(success, error, message)


class UndockingTask(WatchedTask):
    """Backs out on the dock's axis if the marker is seen, else straight by the odometry.

    Fed and ticked as a `DockingTask`.

    Args:
        distance: how far, m; 0: until the robot is at the staging distance from the marker.
        dock: what is known of the dock; None: nothing.
        dock_pose: its rough pose in the odometry frame; needed with a dock.
        mount: where the camera is on the robot; None: images are of no use.
        settings: speeds and patience.
        time_limit: s.

    Attributes:
        result: how it ended; None before.
        remaining: how far it still is, m; NaN before it begins.

    Raises:
        UndockingTaskError: the distance is negative or not finite, or 0 without a dock.
    """

    def __init__(
        self,
        distance: float,
        *,
        dock: Optional[Dock] = None,
        dock_pose: Optional[PlanarPose] = None,
        mount: Optional[CameraMount] = None,
        settings: Optional[DockingSettings] = None,
        time_limit: float = 60.0,
    ):
        if not math.isfinite(distance) or distance < 0.0 or (distance == 0.0 and dock is None):
            raise UndockingTaskError(f"cannot undock by {distance:g} m")
        if dock is not None and (dock_pose is None or not all(map(math.isfinite, dock_pose))):
            raise UndockingTaskError(f"the pose of dock '{dock.name}' is not finite")
        settings = settings or DockingSettings()
        super().__init__("undocked", OdometryBuffer(), settings, time_limit)
        self._distance, self._dock = distance, dock
        self._ahead = 0.0 if mount is None else mount.x
        self._belief: Optional[DockBelief] = None
        if dock is not None and mount is not None:
            rng = np.random.default_rng(0)
            self._belief = DockBelief(dock, dock_pose, mount, settings, rng)
        self._tracker = AxisTracker(settings, self._ahead)
        self._start: Optional[PlanarPose] = None
        self._goal: Optional[float] = None
        self.remaining = math.nan

    @property
    def wants_images(self) -> bool:
        """Whether an image would be used now."""
        return self.result is None and self._belief is not None

    def add_odometry(self, odometry: Odometry) -> None:
        """Take the next message of odometry; an impossible one ends the undocking."""
        last = self._odometry.last
        if self.result is not None or (last is not None and odometry.stamp <= last.stamp):
            return
        if self._accept(odometry):
            self._odometry.add(odometry)
            if self._belief is not None:
                self._belief.add_odometry(odometry)

    def add_observation(self, observation: Observation) -> None:
        """Take the sightings in an image."""
        if self.wants_images and self._odometry.last is not None:
            self._belief.observe(observation)

    def _advance(self, stamp: float) -> Optional[Command]:
        best = None if self._belief is None else self._belief.best()
        looking = self._belief is not None and stamp - self._started <= _LOOK_SECONDS
        if self._odometry.last is None or (best is None and looking):
            return None
        if self._start is None:
            self._start = self._odometry.last.pose
        robot = self._robot() if best is None else best.estimate().robot
        if self._goal is None:
            far = self._dock.staging_distance if self._distance == 0.0 else 0.0
            self._goal = far or self._distance - float(robot[0])
        self.remaining = self._goal + float(robot[0])
        if self.remaining <= _UNDOCKED:
            self.remaining = 0.0
            self._end(DockingError.NONE, "undocked")
            return None
        return self._tracker.backwards(robot, self.remaining)

    def _robot(self) -> np.ndarray:
        """Return the robot's pose (3,) in the dock's frame by odometry: it began in a dock."""
        docked = 0.4 if self._dock is None else self._dock.docked_distance
        moved = se2.between(self._start, self._odometry.last.pose)
        return moved - np.array([docked + self._ahead, 0.0, 0.0])
