"""Docking as a machine that is fed with odometry and images and gives commands."""

from __future__ import annotations

import math
from collections import deque
from typing import Deque, Optional, Tuple

import numpy as np

from bullet_lab.core import se2
from bullet_lab.docking.approach import Docked, decide
from bullet_lab.docking.database import Dock
from bullet_lab.docking.drive import CommandRamp
from bullet_lab.docking.geometry import clearance
from bullet_lab.docking.knowledge import DockKnowledge
from bullet_lab.docking.lane import StuckWatch
from bullet_lab.docking.motion import jump, motion_step
from bullet_lab.docking.phases import Look, Phase
from bullet_lab.docking.pilot import DockingFailureError, Pilot
from bullet_lab.docking.settings import DockingSettings
from bullet_lab.docking.types import (
    STANDSTILL,
    CameraMount,
    Command,
    DockingError,
    DockingResult,
    DockingState,
    DockingStatus,
    Observation,
    Odometry,
    PlanarPose,
    RobotShape,
)
from bullet_lab.docking.undocking import UndockingTask
from bullet_lab.errors import LabError

__all__ = ["DockingTask", "DockingTaskError", "UndockingTask"]

_MOST_WAITING = 50


class DockingTaskError(LabError):
    """What docking is asked for makes no sense."""


class DockingTask:
    """Drives a robot into a dock.

    Give it all odometry and one observation for each image, and ask it for a command at a steady
    rate (20 Hz). Everything is stamped in seconds of one clock.

    Args:
        dock: what is known of the dock.
        dock_pose: its rough pose in the odometry frame.
        mount: where the camera is on the robot.
        settings: speeds and patience.
        shape: of the robot.
        search: look for the marker where it is not seen at once.
        max_retries: retreats before it gives up; None or less than 0: as in the settings.
        time_limit: s; None: as in the settings.
        seed: of the cloud of thinkable docks.

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
        self._settings = settings
        rng = np.random.default_rng(seed)
        self._knowledge = DockKnowledge(dock, dock_pose, mount, settings, rng)
        retries = settings.max_retries if max_retries is None or max_retries < 0 else max_retries
        self._pilot = Pilot(dock, self._knowledge, mount, shape, settings, search, retries, decide)
        self._time_limit = settings.time_limit if time_limit is None else time_limit
        self._waiting: Deque[Observation] = deque(maxlen=_MOST_WAITING)
        self._ramp = CommandRamp(settings)
        self._stuck = StuckWatch()
        self._phase: Phase = Look()
        self._started: Optional[float] = None
        self._wanted_since: Optional[float] = None
        self._last_tick: Optional[float] = None
        self.result: Optional[DockingResult] = None

    # What it is fed with ----------------------------------------------------------------------

    def add_odometry(self, odometry: Odometry) -> None:
        """Take the next message of odometry; what cannot be ends the docking."""
        if self.result is not None:
            return
        before = self._knowledge.track.last
        if not all(map(math.isfinite, odometry.pose)):
            self._end(DockingError.ODOMETRY_LOST, "odometry is not finite")
            return
        if before is not None:
            seconds = odometry.stamp - before.stamp
            if seconds <= 0.0:
                if seconds < -0.5:
                    self._end(DockingError.ODOMETRY_LOST, "odometry went back in time")
                return
            step = motion_step(before, odometry)
            trouble = jump(step, seconds, self._settings.drive_speed, self._settings.turn_speed)
            if trouble:
                self._end(DockingError.ODOMETRY_LOST, trouble)
                return
            self._stuck.moved(step.step, seconds)
        self._knowledge.add_odometry(odometry)
        free = self._knowledge.cloud.stands_free(self._pilot.shape.inner_radius)
        if before is None and not free:
            self._end(DockingError.NOT_VALID, "the robot stands where the dock's walls must be")
            return
        while self._waiting and self._waiting[0].stamp <= odometry.stamp + 1e-6:
            self._knowledge.observe(self._waiting.popleft())

    def add_observation(self, observation: Observation) -> None:
        """Take what was seen in an image; it is used once odometry has come that far."""
        if self.result is not None:
            return
        last = self._knowledge.track.last
        if last is not None and observation.stamp <= last.stamp + 1e-6:
            self._knowledge.observe(observation)
        else:
            self._waiting.append(observation)

    def preempt(self) -> None:
        """Stop at once."""
        self._end(DockingError.PREEMPTED, "stopped on request")

    # What it gives ----------------------------------------------------------------------------

    def tick(self, stamp: float) -> Command:
        """Return the command (m/s, rad/s) for now."""
        if self.result is not None:
            return self._ramp.stop()
        seconds = 0.05 if self._last_tick is None else stamp - self._last_tick
        self._last_tick = stamp
        if self._started is None:
            self._started = stamp
        self._pilot.now = stamp
        try:
            self._check(stamp)
            if self._knowledge.view is None:
                return self._ramp.stop()
            wanted = self._advance()
        except DockingFailureError as failure:
            self._end(failure.error, str(failure))
            return self._ramp.stop()
        if isinstance(self._phase, Docked):
            self._end(DockingError.NONE, "docked")
            return self._ramp.stop()
        command = self._ramp.towards(wanted, min(max(seconds, 0.0), 0.2))
        self._stuck.commanded(command)
        if command != STANDSTILL:
            self._pilot.at_rest_since = None
        elif self._pilot.at_rest_since is None:
            self._pilot.at_rest_since = stamp
        return command

    @property
    def status(self) -> DockingStatus:
        """How it goes."""
        pilot = self._pilot
        rough = pilot.result(False, DockingError.NONE, "")
        estimate = pilot.estimate() if self._knowledge.track.last is not None else None
        pose = None
        if estimate is not None:
            pose = tuple(se2.compose(self._knowledge.pose, estimate.mean).tolist())
        return DockingStatus(
            self._phase.state,
            rough.distance,
            rough.lateral,
            rough.yaw,
            pilot.retries,
            self.wants_images,
            pose,
            self._phase.plan(),
            self._phase.detail,
        )

    @property
    def state(self) -> DockingState:
        """What is being done."""
        return self._phase.state

    @property
    def wants_images(self) -> bool:
        """Whether an image would be used now."""
        if self.result is not None:
            return False
        return self._knowledge.view is None or self._phase.wants_images(self._pilot)

    def estimated_robot(self) -> Optional[Tuple[float, float, float]]:
        """Return the robot's pose in the dock's frame, None before the marker was seen."""
        estimate = self._pilot.estimate() if self._knowledge.track.last is not None else None
        return None if estimate is None else tuple(self._pilot.robot(estimate).tolist())

    # Inside -----------------------------------------------------------------------------------

    def _advance(self) -> Command:
        """Ask the phase, and those that follow at once, for a command."""
        if self._pilot.at_rest_since is None and self._ramp.command == STANDSTILL:
            self._pilot.at_rest_since = self._pilot.now
        for _ in range(3):
            command, following = self._phase.step(self._pilot)
            if following is None:
                return command
            self._phase = following
        return STANDSTILL

    def _check(self, stamp: float) -> None:
        """Raise DockingFailureError where docking cannot go on."""
        settings, fail = self._settings, self._pilot.fail
        if stamp - self._started > self._time_limit:
            fail(DockingError.TIMED_OUT, f"not docked after {self._time_limit:g} s")
        last = self._knowledge.track.last
        heard = self._started if last is None else last.stamp
        if stamp - heard > settings.odometry_timeout:
            fail(DockingError.ODOMETRY_LOST, f"no odometry for {stamp - heard:.1f} s")
        if self._stuck.stuck:
            fail(DockingError.BLOCKED, "the robot does not move as it is told to")
        if not self.wants_images:
            self._wanted_since = None
            return
        if self._wanted_since is None:
            self._wanted_since = stamp
        quiet = stamp - max(self._wanted_since, self._knowledge.last_image)
        if quiet > settings.image_timeout:
            fail(DockingError.CAMERA_LOST, f"no image for {quiet:.1f} s")

    def clearance(self) -> float:
        """Return how far the robot's middle is from the dock's walls, as estimated; inf if not."""
        robot = self.estimated_robot()
        return math.inf if robot is None else float(clearance(robot[:2], self._pilot.boxes))

    def _end(self, error: DockingError, message: str) -> None:
        if self.result is None:
            success = error == DockingError.NONE
            self.result = self._pilot.result(success, error, message)
        self._ramp.stop()
