"""Planner of a docking: estimates for the states to decide by, and safe paths."""

from __future__ import annotations

import math
from typing import List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.se2 import PlanarPose, wrap
from bullet_lab.docking.belief import DockBelief
from bullet_lab.docking.control import AxisTracker, Lane
from bullet_lab.docking.costmap import Costmap, along
from bullet_lab.docking.database import Dock
from bullet_lab.docking.filter import GaussianPose
from bullet_lab.docking.geometry import QUIET_ZONE, clearance, misfit, wall_boxes
from bullet_lab.docking.marker_track import MarkerTrack
from bullet_lab.docking.search import MarkerSearch, NextView
from bullet_lab.docking.types import (
    STANDSTILL,
    CameraMount,
    Command,
    DockingError,
    DockingResult,
    DockingSettings,
    Point,
    RobotShape,
)
from bullet_lab.errors import LabError

# Poses of the dock that a costmap is made of.
_SAMPLES = 120
# Share of the possible docks that a robot may touch.
_RISKY = 0.03
# Length of a drive that shows the size of a print, m.
_PROBE = 0.6
# A path is unsafe from its start if it leads nearer to a wall than the robot is, by so much, m.
_NEARER_WALL = 0.01
_MOST_PROBES = 6
# After so many doubts whether a track is real, a small probability is enough.
_MOST_DOUBTS = 3
# Least distance of the circle in which the robot turns from the walls' front edges, m.
_ROOM_TO_TURN = 0.17
# Standard deviation of the yaw, as a share of the tolerance, above which the robot drives in once
# more, and how often at most.
_UNSURE = 0.4
_MOST_ROUNDS = 2
# Last part of the approach that may be driven without seeing the marker, m.
_BLIND = 0.12
# Angle from the axis at which the marker is viewed from aside: share of the angle at which the
# walls begin to hide it, and most, rad.
_ASIDE = 0.85
_FARTHEST_ASIDE = math.radians(35.0)
# Share of the distance at which the marker was found from which it is found again.
_AS_FAR = 0.95
# Most distance of two prints on one wall along the dock's axis, m.
_SAME_PLANE = 0.2


class DockingFailureError(LabError):
    """The docking has failed; `error` is the reason."""

    def __init__(self, error: DockingError, message: str):
        super().__init__(message)
        self.error = error


class DockingPlanner:
    """Estimates, counters and safe paths of a docking, which its states share.

    Attributes:
        search: whether to look for the marker where it is not seen at once.
        max_retries: retreats before it gives up.
        now: stamp of the tick, s.
        retries: how often it retreated to try again.
        stagings: how often it went for a better start.
        unclear: how often an approach was given up as the axis was not known well enough.
        doubts: how often a track was not certain enough to follow it between the walls.
        lost_at_the_end: whether the marker was lost at the end of the approach.
        ahead: m, of the camera before the robot's middle.
    """

    def __init__(
        self,
        dock: Dock,
        belief: DockBelief,
        mount: CameraMount,
        shape: RobotShape,
        settings: DockingSettings,
        search: bool,
        max_retries: int,
    ):
        self.dock, self.belief, self.settings = dock, belief, settings
        self.shape, self.search, self.max_retries = shape, search, max_retries
        self.lane = Lane(dock, shape, settings.wall_margin, mount.x)
        self.tracker = AxisTracker(settings, mount.x)
        self.lookout = MarkerSearch(dock, belief, settings, mount.x)
        self.ahead, self._mount = mount.x, mount
        self.now = 0.0
        self._at_rest_since: Optional[float] = None
        self.retries = self.stagings = self.unclear = 0
        self.lost_at_the_end = False
        self._boxes = wall_boxes(dock)
        self._camera = np.array([mount.x, 0.0, 0.0])
        self.doubts = self._probes = 0
        self._noted: Tuple[Optional[MarkerTrack], int] = (None, 0)

    def commanded(self, command: Command) -> None:
        """Note the command (m/s, rad/s) that is in force now."""
        if command != STANDSTILL:
            self._at_rest_since = None
        elif self._at_rest_since is None:
            self._at_rest_since = self.now

    def settled(self) -> bool:
        """Return whether the robot has stood for so long that images count."""
        resting = 0.0 if self._at_rest_since is None else self.now - self._at_rest_since
        return resting >= self.settings.settle_time

    def unseen(self, track: MarkerTrack) -> float:
        """Return for how long a track was not seen, s."""
        return self.now - track.last_seen

    def left(self, robot: np.ndarray) -> float:
        """Return how far a robot at (3,) in the dock's frame has to go along the axis, in m."""
        return -float(robot[0]) - self.dock.docked_distance - self.ahead

    def marker_in_view(self, estimate: GaussianPose) -> bool:
        """Return whether the marker should be found in an image taken now."""
        seen = self.belief.visibility
        return seen is None or bool(seen.visible(se2.between(estimate.mean, self._camera)))

    def misfit(self, camera: PinholeCamera) -> str:
        """Return why a camera cannot see the marker from the dock; empty where it can."""
        return misfit(self.dock, camera, self._mount, self.belief.farthest(camera))

    def in_reach(self, robot: np.ndarray) -> bool:
        """Return whether the marker is near enough to be found, as it was from as far before."""
        visibility, track = self.belief.visibility, self.belief.best()
        if visibility is None:
            return True
        before = 0.0 if track is None else _AS_FAR * track.found_from
        reach = math.hypot(float(robot[0]) + self.ahead, float(robot[1]))
        return reach < max(visibility.farthest, before)

    def result(self, success: bool, error: DockingError, message: str) -> DockingResult:
        """Return the result with the present estimates."""
        estimate = self.estimate()
        if estimate is None:
            return DockingResult(success, error, message, self.retries)
        robot, learned = estimate.robot, self.belief.best().learned()
        remarks = learned.remarks()
        message += f" (differs from nominal: {remarks})" if message and remarks else ""
        distance = self.left(robot) + self.dock.docked_distance
        pose = distance, float(robot[1]), wrap(float(robot[2]))
        return DockingResult(success, error, message, self.retries, *pose, learned)

    def estimate(self) -> Optional[GaussianPose]:
        """Return the dock's pose in the robot's frame; None before the marker was seen."""
        return None if self.belief.odometry.last is None else self.belief.estimate()

    def is_sure(self, track: MarkerTrack) -> bool:
        """Return whether a track is certain enough to follow it between the walls.

        After a few doubts, less certainty is asked for.
        """
        if track.real >= self.settings.sure or (self.doubts >= _MOST_DOUBTS and track.real > 0.2):
            return True
        copy, walls = self.belief.copy_on_the_wall(), self.dock.walls
        if track.real > 0.5 and copy is not None and walls is not None:
            # If real, it is on the back wall, where a larger copy is.
            off = np.abs(se2.between(copy.likeliest().mean, track.likeliest().mean))
            return off[0] < _SAME_PLANE and off[1] < 0.5 * walls.opening
        return False

    def note_progress(self) -> bool:
        """Note how often the best track was seen; return whether it was since the last note."""
        track = self.belief.best()
        known, frames = self._noted
        self._noted = track, track.frames
        return track is not known or track.frames - frames >= self.settings.measure_frames

    def unsure_of_yaw(self) -> bool:
        """Return whether to drive in once more to measure the yaw better.

        Only driving with the marker in sight shows how far the camera is turned.
        """
        deviation = self.belief.best().learned().yaw.deviation
        rounds = min(self.max_retries, _MOST_ROUNDS)
        return deviation > _UNSURE * self.dock.tolerance.yaw and self.retries < rounds

    def blind(self, track: MarkerTrack, left: float) -> bool:
        """Return whether to drive the last part of the approach (m) without seeing the marker.

        It leaves the image of a camera that is pitched, or was lost there before. Odometry is good
        enough for what is left.
        """
        estimate, tolerance = self.estimate(), self.dock.tolerance
        along, across = float(estimate.deviations[0]), estimate.lateral_deviation
        certain = along < tolerance.distance and across < tolerance.lateral
        gone = self.lost_at_the_end or self.belief.cut_off(track)
        return certain and self.near(left) and gone

    def near(self, left: float) -> bool:
        """Return whether so much left to go (m) is the last part of the approach."""
        return abs(left) < _BLIND

    def in_sight(self, left: float) -> float:
        """Return so much left to go (m), or less where the marker would not be found there."""
        seen = self.belief.visibility
        return left if seen is None else min(left, 0.9 * seen.farthest - self.dock.docked_distance)

    def costmap(self) -> Costmap:
        """Return the costmap of the floor as it is believed to be now."""
        return Costmap(
            self.belief.pose[:2],
            self.belief.samples(_SAMPLES),
            self._boxes,
            self._obstacles(),
            self.shape.turning_radius + self.settings.wall_margin,
        )

    def still_safe(self, way: Sequence[Point]) -> bool:
        """Return whether the next 1.5 m of a path are safe by the present belief."""
        points = self._ahead_of_robot([self.belief.pose[:2], *way], 0.0)
        if not len(points):
            return True
        docks, radius = self.belief.samples(_SAMPLES), self.shape.turning_radius
        flat = np.column_stack([points, np.zeros(len(points))])
        away = clearance(se2.between(docks[:, None], flat[None])[..., :2], self._boxes)
        # The robot's place is free even if its circle touches; nearer to a wall may not be.
        here = clearance(
            se2.between(docks, np.array([*self.belief.pose[:2], 0.0]))[..., :2], self._boxes
        )
        touched = (away < radius) & (away < here[:, None] - _NEARER_WALL)
        if float(np.max(np.mean(touched, axis=0), initial=0.0)) > 2.0 * _RISKY:
            return False
        return not any(
            weight > 0.3 and np.any(np.hypot(*(points - (x, y)).T) < size + radius)
            for x, y, size, weight in self._obstacles()
        )

    def _obstacles(self) -> np.ndarray:
        """Return the obstacles (n, 4) of `DockBelief.obstacles` that are not where the robot is.

        A print of unknown size could otherwise be a tiny one right before the camera.
        """
        rows = self.belief.obstacles()
        away = np.hypot(*(rows[:, :2] - self.belief.pose[:2]).T) - rows[:, 2]
        return rows[away > self.shape.turning_radius + self.settings.wall_margin]

    def _ahead_of_robot(self, way, begin: float = 0.15) -> np.ndarray:
        """Return points of a path from `begin` (m) on; the robot occupies what is before."""
        pieces = [along(first, second, 0.05) for first, second in zip(way, way[1:])]
        points = np.concatenate(pieces or [np.asarray(way, dtype=float)])
        travelled = np.cumsum(np.concatenate([[0.0], np.hypot(*np.diff(points, axis=0).T)]))
        return points[(travelled > begin) & (travelled < 1.6)]

    def way_to_staging(self, estimate: GaussianPose) -> Optional[List[Point]]:
        """Return a safe path to a point on the axis before the dock; None if there is none.

        The point is near enough to find the marker, or else at the database's distance.
        """
        staging, visibility = self.dock.staging_distance, self.belief.visibility
        distances = [staging]
        if visibility is not None:
            room = self.lane.depth + self.shape.turning_radius + _ROOM_TO_TURN
            distances.insert(0, min(staging, max(room, 0.9 * visibility.farthest + self.ahead)))
        ways = (self._safe_way(estimate, (-distance, 0.0, 0.0)) for distance in distances)
        return next((way for way in ways if way is not None), None)

    def way_aside(self, estimate: GaussianPose) -> Optional[List[Point]]:
        """Return a safe path to the same distance, but beside the axis; None if there is none.

        A flat marker looks narrower with the square of the viewing angle: on its axis, that shows
        little of its yaw. Left and right side take turns.
        """
        walls, before = self.dock.walls, float(np.hypot(*estimate.robot[:2]))
        angle = _FARTHEST_ASIDE
        if walls is not None:
            free = 0.5 * walls.opening - self.dock.marker.size * (0.5 + QUIET_ZONE)
            angle = min(angle, _ASIDE * math.atan2(free, walls.depth))
        for side in (angle, -angle) if self.unclear % 2 else (-angle, angle):
            way = self._safe_way(estimate, (-before * math.cos(side), before * math.sin(side), 0.0))
            if way is not None:
                return way
        return None

    def _safe_way(self, estimate: GaussianPose, there: PlanarPose) -> Optional[List[Point]]:
        """Return a safe path to a pose in the dock's frame; None if there is none."""
        costmap = self.costmap()
        goal = se2.compose(self.belief.pose, se2.compose(estimate.mean, there))
        way = costmap.path(goal.tolist())
        safe = way is not None and costmap.risk(self._ahead_of_robot(way)) <= 2.0 * _RISKY
        return way if safe else None

    def probing_way(self) -> float:
        """Return how far (m) to drive ahead or, negative, back; 0 if not safe or often enough.

        It shows how the size of what is seen changes.
        """
        if self._probes >= _MOST_PROBES:
            return 0.0
        pose, costmap = self.belief.pose, self.costmap()
        heading = np.array([math.cos(pose[2]), math.sin(pose[2])])
        for way in (-_PROBE, _PROBE):
            points = np.asarray(pose[:2]) + np.linspace(0.2, 1.0, 9)[:, None] * way * heading
            if costmap.risk(points) < _RISKY:
                self._probes += 1
                return way
        return 0.0

    def next_view(self) -> Optional[NextView]:
        """Return where to look next; None if nothing can be seen from a safe place."""
        return self.lookout.next_view(self.costmap, self.still_safe)
