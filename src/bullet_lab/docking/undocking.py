"""Driving backwards out of a dock."""

from __future__ import annotations

import math
from typing import Optional

import numpy as np

from bullet_lab.core import se2
from bullet_lab.docking.database import Dock
from bullet_lab.docking.drive import AxisTracker, CommandRamp
from bullet_lab.docking.knowledge import DockKnowledge
from bullet_lab.docking.lane import StuckWatch
from bullet_lab.docking.motion import OdometryTrack, jump, motion_step
from bullet_lab.docking.settings import DockingSettings
from bullet_lab.docking.types import (
    CameraMount,
    Command,
    DockingError,
    DockingResult,
    Observation,
    Odometry,
    PlanarPose,
)
from bullet_lab.errors import LabError

_LOOK_SECONDS = 1.5
_THERE = 0.003


class UndockingTaskError(LabError):
    """What undocking is asked for makes no sense."""


class UndockingTask:
    """Backs out on the dock's axis if the marker is seen, else straight by the odometry.

    Fed and ticked as a `DockingTask`.

    Args:
        distance: how far, m; 0: until the robot is at the staging distance from the marker.
        dock: what is known of the dock; None: nothing.
        dock_pose: its rough pose in the odometry frame; needed with a dock.
        mount: where the camera is on the robot; None: images are of no use.
        settings: speeds and patience.
        time_limit: s.

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
        self._settings = settings or DockingSettings()
        self._distance, self._dock = distance, dock
        self._ahead = 0.0 if mount is None else mount.x
        self._knowledge: Optional[DockKnowledge] = None
        if dock is not None and mount is not None:
            rng = np.random.default_rng(0)
            self._knowledge = DockKnowledge(dock, dock_pose, mount, self._settings, rng)
        self._track = OdometryTrack()
        self._tracker = AxisTracker(self._settings, self._ahead)
        self._ramp = CommandRamp(self._settings)
        self._stuck = StuckWatch()
        self._time_limit = time_limit
        self._start: Optional[PlanarPose] = None
        self._started: Optional[float] = None
        self._last_tick: Optional[float] = None
        self._goal: Optional[float] = None
        self.result: Optional[DockingResult] = None
        self.remaining = math.nan

    @property
    def wants_images(self) -> bool:
        """Whether an image would be used now."""
        return self.result is None and self._knowledge is not None

    def add_odometry(self, odometry: Odometry) -> None:
        """Take the next message of odometry; what cannot be ends the undocking."""
        before = self._track.last
        if self.result is not None or (before is not None and odometry.stamp <= before.stamp):
            return
        if not all(map(math.isfinite, odometry.pose)):
            self._end(DockingError.ODOMETRY_LOST, "odometry is not finite")
            return
        if before is not None:
            step, seconds = motion_step(before, odometry), odometry.stamp - before.stamp
            trouble = jump(step, seconds, self._settings.drive_speed, self._settings.turn_speed)
            if trouble:
                self._end(DockingError.ODOMETRY_LOST, trouble)
                return
            self._stuck.moved(step.step, seconds)
        self._track.add(odometry)
        if self._knowledge is not None:
            self._knowledge.add_odometry(odometry)

    def add_observation(self, observation: Observation) -> None:
        """Take what was seen in an image."""
        knowledge = self._knowledge
        if self.result is None and knowledge is not None and knowledge.track.last is not None:
            knowledge.observe(observation)

    def preempt(self) -> None:
        """Stop at once."""
        self._end(DockingError.PREEMPTED, "stopped on request")

    def tick(self, stamp: float) -> Command:
        """Return the command (m/s, rad/s) for now."""
        seconds = 0.05 if self._last_tick is None else stamp - self._last_tick
        self._last_tick = stamp
        if self._started is None:
            self._started = stamp
        self._check(stamp)
        if self.result is not None:
            return self._ramp.stop()
        if self._track.last is None or not self._looked(stamp):
            return self._ramp.stop()
        if self._start is None:
            self._start = self._track.last.pose
        robot = self._robot()
        self.remaining = self._left(robot)
        if self.remaining <= _THERE:
            self.remaining = 0.0
            self._end(DockingError.NONE, "undocked")
            return self._ramp.stop()
        wanted = self._tracker.backwards(robot, self.remaining)
        command = self._ramp.towards(wanted, min(max(seconds, 0.0), 0.2))
        self._stuck.commanded(command)
        return command

    def _looked(self, stamp: float) -> bool:
        """Say whether the marker was seen, or long enough looked for."""
        if self._knowledge is None or self._knowledge.best() is not None:
            return True
        return stamp - self._started > _LOOK_SECONDS

    def _robot(self) -> np.ndarray:
        """Return the robot's pose in the dock's frame; without one, as if it stood in a dock."""
        best = None if self._knowledge is None else self._knowledge.best()
        if best is not None:
            return se2.inverse(best.estimate().mean)
        docked = 0.4 if self._dock is None else self._dock.docked_distance
        moved = se2.between(self._start, self._track.last.pose)
        return moved - np.array([docked + self._ahead, 0.0, 0.0])

    def _left(self, robot: np.ndarray) -> float:
        if self._goal is None:
            far = self._dock.staging_distance if self._distance == 0.0 else 0.0
            self._goal = far or self._distance - float(robot[0])
        return self._goal + float(robot[0])

    def _check(self, stamp: float) -> None:
        last = self._track.last
        heard = self._started if last is None else last.stamp
        if stamp - self._started > self._time_limit:
            self._end(DockingError.TIMED_OUT, f"not undocked after {self._time_limit:g} s")
        elif stamp - heard > self._settings.odometry_timeout:
            self._end(DockingError.ODOMETRY_LOST, f"no odometry for {stamp - heard:.1f} s")
        elif self._stuck.stuck:
            self._end(DockingError.BLOCKED, "the robot does not move as it is told to")

    def _end(self, error: DockingError, message: str) -> None:
        if self.result is None:
            self.result = DockingResult(error == DockingError.NONE, error, message)
        self._ramp.stop()
