"""What the phases of a docking share: knowledge, plans and how to end."""

from __future__ import annotations

import math
from typing import Any, Callable, List, Optional, Tuple

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.angles import wrap
from bullet_lab.docking.candidate import Candidate
from bullet_lab.docking.database import Dock
from bullet_lab.docking.drive import AxisTracker
from bullet_lab.docking.floor_map import FloorMap, Point, sample_way
from bullet_lab.docking.geometry import View, clearance, wall_boxes
from bullet_lab.docking.knowledge import SAME_WALL, DockKnowledge
from bullet_lab.docking.lane import Lane
from bullet_lab.docking.motion import DockEstimate
from bullet_lab.docking.settings import DockingSettings
from bullet_lab.docking.types import (
    CameraMount,
    DockingError,
    DockingResult,
    PlanarPose,
    RobotShape,
)
from bullet_lab.docking.viewpoints import Outlook, next_outlook
from bullet_lab.errors import LabError

_SAMPLES = 120
_RISKY = 0.03
_PROBE = 0.6
# Between the walls' front edges and the circle in which the robot turns, at the least, in m.
_ROOM_TO_TURN = 0.17
# How far apart, in m along the dock's axis, two prints on one wall may seem.
_SAME_PLANE = 0.2
# Looks for a larger print, where the marker itself is too small to be found from outside: how
# many, how wide that may be (half, by the opening), and the share of such looks that miss it.
_MOST_FAR_LOOKS = 14
_WIDEST_PRINT = 0.42
FAR_MISSED = 0.3


class DockingFailureError(LabError):
    """The docking ends here, for a reason with a name."""

    def __init__(self, error: DockingError, message: str):
        super().__init__(message)
        self.error = error


class Pilot:
    """Knows the dock as far as it is known, and which ways are safe.

    Args:
        dock: what the database says.
        knowledge: what was seen.
        mount: of the camera.
        shape: of the robot.
        settings: see `DockingSettings`.
        search: whether to look for the marker where it is not seen at once.
        max_retries: retreats before it gives up.
        decide: returns the phase that follows a measurement at rest.
    """

    def __init__(
        self,
        dock: Dock,
        knowledge: DockKnowledge,
        mount: CameraMount,
        shape: RobotShape,
        settings: DockingSettings,
        search: bool,
        max_retries: int,
        decide: Callable[[Pilot], Any],
    ):
        self.dock, self.knowledge, self.settings = dock, knowledge, settings
        self.shape, self.search, self.max_retries = shape, search, max_retries
        self.decide = decide
        self.boxes = wall_boxes(dock)
        self.lane = Lane(dock, shape, settings.wall_margin, mount.x)
        self.tracker = AxisTracker(settings, mount.x)
        self.ahead = mount.x
        self.now = 0.0
        self.at_rest_since: Optional[float] = None
        self.retries = 0
        self.stagings = 0
        self.doubts = 0
        self.far_looks = 0
        self.probes = 0
        self.far_range = 4.5
        self.far_view: Optional[View] = None
        self.cue_used: Optional[Tuple[Candidate, int]] = None

    # Where the robot is -----------------------------------------------------------------------

    def resting(self) -> float:
        """Return for how long the robot has been told to stand, in s."""
        return 0.0 if self.at_rest_since is None else self.now - self.at_rest_since

    def estimate(self) -> Optional[DockEstimate]:
        """Return the dock's pose in the robot's frame; None before the marker was seen.

        A small marker tells little of its yaw; a larger copy on the same wall tells more.
        """
        best = self.knowledge.best()
        estimate = None if best is None else best.estimate()
        copy = self.knowledge.copy_on_the_wall()
        if estimate is None or copy is None:
            return estimate
        other = copy.likeliest()
        variance = float(other.covariance[2, 2]) + SAME_WALL**2
        return estimate.turned_to(float(other.mean[2]), variance)

    def robot(self, estimate: DockEstimate) -> np.ndarray:
        """Return the robot's pose (3,) in the dock's frame."""
        return se2.inverse(estimate.mean)

    def left(self, robot: np.ndarray) -> float:
        """Return how far it is to go along the axis, in m."""
        return -float(robot[0]) - self.dock.docked_distance - self.ahead

    def deviation(self, estimate: DockEstimate) -> float:
        """Return the standard deviation of the robot's distance from the axis, in m."""
        x, y, yaw = estimate.mean
        away = np.array([math.sin(yaw), -math.cos(yaw), -(x * math.cos(yaw) + y * math.sin(yaw))])
        return math.sqrt(max(float(away @ estimate.covariance @ away), 0.0))

    def bearing(self, estimate: DockEstimate) -> float:
        """Return the direction of the marker as the camera sees it, in rad."""
        return math.atan2(float(estimate.mean[1]), float(estimate.mean[0]) - self.ahead)

    def marker_in_view(self, estimate: DockEstimate) -> bool:
        """Say whether the marker should be found in an image taken now."""
        view = self.knowledge.view
        if view is None:
            return True
        camera = np.array([self.ahead, 0.0, 0.0])
        return bool(view.seen(se2.between(estimate.mean, camera)))

    def in_reach(self, robot: np.ndarray) -> bool:
        """Say whether the marker is near enough to be found."""
        view = self.knowledge.view
        reach = math.hypot(float(robot[0]) + self.ahead, float(robot[1]))
        return view is None or reach < view.farthest

    # What is allowed --------------------------------------------------------------------------

    def in_lane(self, estimate: DockEstimate) -> bool:
        """Say whether the robot can approach from where it is."""
        robot = self.robot(estimate)
        return self.lane.holds(robot, self.left(robot), self.deviation(estimate))

    def sure(self, candidate: Candidate) -> bool:
        """Say whether a candidate may be driven at between the walls; asked for, it counts."""
        if candidate.real >= self.settings.sure or (self.doubts >= 3 and candidate.real > 0.2):
            return True
        if candidate.real > 0.5 and self._on_the_copys_wall(candidate):
            return True
        self.doubts += 1
        return False

    def _on_the_copys_wall(self, candidate: Candidate) -> bool:
        """Say whether it is, if real, where a larger copy says that the dock's back wall is."""
        copy, walls = self.knowledge.copy_on_the_wall(), self.dock.walls
        if copy is None or walls is None:
            return False
        off = se2.between(copy.likeliest().mean, candidate.likeliest().mean)
        return abs(float(off[0])) < _SAME_PLANE and abs(float(off[1])) < 0.5 * walls.opening

    def in_sight(self, left: float) -> float:
        """Return how much may be left to go (m), so much wanted, with the marker still found."""
        view = self.knowledge.view
        return left if view is None else min(left, 0.9 * view.farthest - self.dock.docked_distance)

    # Ways -------------------------------------------------------------------------------------

    def floor(self) -> FloorMap:
        """Return the map of the floor as it is believed to be now."""
        knowledge = self.knowledge
        return FloorMap(
            knowledge.pose[:2],
            knowledge.samples(_SAMPLES),
            self.boxes,
            self._obstacles(),
            self.shape.turning_radius + self.settings.wall_margin,
        )

    def way_to(self, goal: PlanarPose) -> Optional[List[Point]]:
        """Return a safe way to a place in the odometry frame, None if there is none."""
        floor = self.floor()
        way = floor.path(goal)
        if way is None or floor.risk(self._ahead_of_robot(way)) > 2.0 * _RISKY:
            return None
        return way

    def still_safe(self, way: Tuple[Point, ...]) -> bool:
        """Say whether the next metre and a half of a way is safe by what is known now."""
        points = self._ahead_of_robot([self.knowledge.pose[:2], *way])
        if not len(points):
            return True
        docks = self.knowledge.samples(_SAMPLES)
        radius = self.shape.turning_radius
        flat = np.column_stack([points, np.zeros(len(points))])
        there = se2.between(docks[:, None], flat[None])[..., :2]
        touched = clearance(there, self.boxes) < radius
        if float(np.max(np.mean(touched, axis=0), initial=0.0)) > 2.0 * _RISKY:
            return False
        for x, y, size, weight in self._obstacles():
            near = np.hypot(points[:, 0] - x, points[:, 1] - y) < size + radius
            if weight > 0.3 and np.any(near):
                return False
        return True

    def _obstacles(self) -> np.ndarray:
        """Return (n, 4) what bears copies, without what cannot be: where the robot stands is free.

        A print of unknown size could otherwise be a tiny one right before the camera.
        """
        rows = self.knowledge.obstacles()
        away = np.hypot(*(rows[:, :2] - self.knowledge.pose[:2]).T) - rows[:, 2]
        return rows[away > self.shape.turning_radius + self.settings.wall_margin]

    def _ahead_of_robot(self, way) -> np.ndarray:
        """Return points of a way without its first decimetres, where the robot stands anyway."""
        points = sample_way(way, 0.05)
        travelled = np.cumsum(np.concatenate([[0.0], np.hypot(*np.diff(points, axis=0).T)]))
        return points[(travelled > 0.15) & (travelled < 1.6)]

    def outlook(self) -> Optional[Outlook]:
        """Return where to look next; None if the marker cannot be seen from a safe place."""
        return self._outlook(self.knowledge.view)

    def far_outlook(self) -> Optional[Outlook]:
        """Return where to look, from too far, for what else may tell where the dock is.

        A larger print on the back wall is hidden by the walls sooner than the marker. Once
        something was seen, each look is nearer than the one before: its size shows on the way.
        None after some looks.
        """
        walls = self.dock.walls
        half = 0.0 if walls is None else _WIDEST_PRINT * walls.opening
        while self.far_looks < _MOST_FAR_LOOKS:
            self.far_looks += 1
            if self.knowledge.copies_seen():
                self.far_range = max(0.87 * self.far_range, 2.6)
            self.far_view = self.knowledge.view.up_to(self.far_range, half)
            outlook = self._outlook(self.far_view)
            if outlook is not None:
                return outlook
            self.far_range = 4.5
        return None

    def _outlook(self, view: View) -> Optional[Outlook]:
        knowledge, settings = self.knowledge, self.settings
        return next_outlook(
            knowledge.pose,
            self.floor(),
            knowledge.samples(_SAMPLES),
            view,
            self.ahead,
            settings.drive_speed,
            settings.turn_speed,
        )

    def way_to_staging(self, estimate: DockEstimate) -> Optional[Tuple[List[Point], float]]:
        """Return a safe way to a point before the dock, and its heading in the odometry frame.

        That is where the marker is found, if need be nearer than the database says, or else there.
        """
        wanted, view = self.dock.staging_distance, self.knowledge.view
        distances = [wanted]
        if view is not None:
            room = self.lane.depth + self.shape.turning_radius + _ROOM_TO_TURN
            distances.insert(0, min(wanted, max(room, 0.9 * view.farthest + self.ahead)))
        for distance in distances:
            there = se2.compose(estimate.mean, (-distance, 0.0, 0.0))
            x, y, heading = se2.compose(self.knowledge.pose, there).tolist()
            way = self.way_to((x, y, heading))
            if way is not None:
                return way, heading
        return None

    def use_cue(self) -> bool:
        """Narrow the cloud by a copy that can only be on the dock's back wall; say if there is.

        A copy within the thinkable docks cannot be elsewhere: the dock fills that place.
        """
        found = self.knowledge.copy_on_the_wall()
        if found is None:
            return False
        if (
            self.cue_used is None
            or self.cue_used[0] is not found
            or (found.frames > 1.3 * self.cue_used[1])
        ):
            self.cue_used = (found, found.frames)
            walls = self.dock.walls
            play = 0.1 if walls is None else 0.5 * (walls.opening - found.likeliest_size())
            self.knowledge.narrow(found.likeliest(), max(play, 0.03))
        return True

    def probing_way(self) -> float:
        """Return how far (m) to drive ahead or, negative, back, where that is safe; 0 if not."""
        pose, floor = self.knowledge.pose, self.floor()
        heading = np.array([math.cos(pose[2]), math.sin(pose[2])])
        for way in (-_PROBE, _PROBE):
            points = np.asarray(pose[:2]) + np.linspace(0.2, 1.0, 9)[:, None] * way * heading
            if floor.risk(points) < _RISKY:
                return way
        return 0.0

    def fail(self, error: DockingError, message: str) -> None:
        """End the docking; raises DockingFailureError."""
        raise DockingFailureError(error, message)

    def result(self, success: bool, error: DockingError, message: str) -> DockingResult:
        """Return the result with the present estimates."""
        estimate = self.estimate() if self.knowledge.track.last is not None else None
        if estimate is None:
            return DockingResult(success, error, message, self.retries)
        robot = self.robot(estimate)
        return DockingResult(
            success,
            error,
            message,
            self.retries,
            self.left(robot) + self.dock.docked_distance,
            float(robot[1]),
            wrap(float(robot[2])),
        )
