"""Progress of a docking: what its states share. And the axis of its dock, which they drive along.

Poses of the robot against the dock are (x m, y m, yaw rad) in the dock's frame.
"""

from __future__ import annotations

import math

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.se2 import PlanarPose, wrap
from bullet_lab.docking.belief import DockBelief
from bullet_lab.docking.marker_track import MarkerTrack
from bullet_lab.docking.paths import WALL_MARGIN, MarkerSearch, PathPlanner
from bullet_lab.docking.types import TURNING_RADIUS, DockingError
from bullet_lab.drive import STANDSTILL, Command, clip
from bullet_lab.errors import LabError

_MARKER_ANGLE = math.radians(24.0)
# Distance before the walls' front edges, m, from which on the robot counts as between them, and
# from which on a course towards an edge is noticed, with so much tolerance.
_ENTRANCE = 0.35
_BEFORE_ENTRANCE = 0.55
_EDGE_TOLERANCE = 0.08
# Half width of the lane where the robot stops, m; from so much left to go on, it widens by so much
# for each metre, and more outside of the walls.
_NARROWEST = 0.006
_STRAIGHT = 0.25
_WIDENING = 0.22
_WIDENING_OUTSIDE = 0.3
# Least and most distance left to go at which an approach begins, m.
_LEAST_LEFT = 0.05
_LONGEST = 4.5
# Distance left to go below which the gate counts; distance from the axis, m, and yaw against it,
# rad, at which it aborts the approach.
_GATE = 0.40
_GATE_BESIDE = 0.025
_GATE_TURNED = math.radians(6.0)
# From standstill to the first image that counts, s.
_SETTLE_SECONDS = 0.3
MEASURE_FRAMES = 4
"""Images at rest before a decision."""

# Drives to the staging point.
_MOST_STAGINGS = 10
# Probability of being the real marker that is needed to drive in.
_SURE = 0.9
# After so many rejected tracks, a small probability of being real is enough.
_MOST_REJECTIONS = 3
# Standard deviation of the yaw, as a share of the tolerance, above which the robot drives in once
# more, and how often at most.
_UNSURE = 0.4
_MOST_ROUNDS = 2
# Last part of the approach that may be driven without seeing the marker, m.
_BLIND = 0.12
# Share of the distance at which the marker was found from which it is found again.
_AS_FAR = 0.95
# Most distance of two prints on one wall along the dock's axis, m.
_SAME_PLANE = 0.2


class DockingFailureError(LabError):
    """The docking has failed; `error` is the reason."""

    def __init__(self, error: DockingError, message: str):
        super().__init__(message)
        self.error = error


class DockAxis:
    """The axis of a dock, and the lane around it, which narrows towards the dock."""

    def __init__(self, belief: DockBelief):
        self._dock, self._walls = belief.dock, belief.dock.walls
        self._settings, self._ahead = belief.settings, belief.mount.x
        # How far off the axis (m) the robot may be between the walls, turned or not.
        self._corridor = math.inf
        if self._walls is not None:
            free = 0.5 * self._walls.opening - WALL_MARGIN
            self._corridor = max(free - TURNING_RADIUS, 0.02)

    def left(self, robot: PlanarPose) -> float:
        """Return how far a robot has to go along the axis, m."""
        return -robot[0] - self._dock.docked_distance - self._ahead

    def forwards(self, robot: PlanarPose) -> Command:
        """Return the command of an approach."""
        left = self.left(robot)
        length = min(max(0.3 * left, 0.10), 0.6)
        most = math.radians(25.0 if left > 0.5 else 5.0 + 40.0 * max(left - 0.1, 0.0))
        target = -clip(math.atan(robot[1] / length), most)
        target *= min(1.0, max(left, 0.0) / 0.04)
        braking = math.sqrt(2.0 * 0.08 * max(left, 0.0))
        speed = min(self._settings.approach_speed, braking, 0.8 * left + 0.008)
        return self._steer(robot, target, speed)

    def backwards(self, robot: PlanarPose, left: float) -> Command:
        """Return the command of a retreat by what is left (m)."""
        target = clip(math.atan(robot[1] / 0.5), math.radians(15.0))
        braking = math.sqrt(2.0 * 0.2 * max(left, 0.0))
        return self._steer(robot, target, -min(self._settings.approach_speed, braking + 0.02))

    def _steer(self, robot: PlanarPose, target: float, speed: float) -> Command:
        """Return the command at a speed (m/s) to the heading nearest a target.

        The heading keeps the marker in the image.
        """
        x = robot[0] + self._ahead * math.cos(robot[2])
        y = robot[1] + self._ahead * math.sin(robot[2])
        bearing = math.atan2(-y, -x)
        heading = bearing + clip(wrap(target - bearing), _MARKER_ANGLE)
        off = wrap(heading - robot[2])
        return speed * max(0.0, 1.0 - abs(off) / 0.35), clip(2.0 * off, 0.5)

    def is_within_walls(self, robot: PlanarPose) -> bool:
        """Return whether a robot is between the walls or just before them."""
        walls = self._walls
        if walls is None:
            return False
        return -robot[0] < walls.depth + _ENTRANCE and abs(robot[1]) < 0.5 * walls.opening

    def leads_at_an_edge(self, robot: PlanarPose, deviation: float) -> bool:
        """Return whether going on from a pose would lead to a wall's front edge.

        `deviation` is the standard deviation of its distance from the axis, m.
        """
        walls, before = self._walls, -robot[0]
        if walls is None or not walls.depth < before < walls.depth + _BEFORE_ENTRANCE:
            return False
        beside = abs(robot[1]) + 2.0 * deviation
        return beside > self._corridor + _EDGE_TOLERANCE + 0.4 * (before - walls.depth)

    def is_in_lane(self, robot: PlanarPose, deviation: float) -> bool:
        """Return whether a robot can approach from where it is; see `leads_at_an_edge`."""
        left = self.left(robot)
        lane = _NARROWEST + _WIDENING * max(left - _STRAIGHT, 0.0)
        if self._walls is not None:
            entrance = self._walls.depth + _ENTRANCE - self._dock.docked_distance - self._ahead
            lane = min(lane, self._corridor + _WIDENING_OUTSIDE * max(left - entrance, 0.0))
        # The estimate improves during the approach; the gate aborts it if it does not.
        beside = abs(robot[1]) + min(2.0 * deviation, 0.4 * lane)
        return _LEAST_LEFT < left < _LONGEST and beside < lane

    def check_gate(self, robot: PlanarPose) -> str:
        """Return why an approach has to be given up; empty if it goes well."""
        left = self.left(robot)
        beside, turned = abs(robot[1]), abs(robot[2])
        if left < _GATE and beside > _GATE_BESIDE:
            return f"{1e3 * beside:.0f} mm beside the axis"
        if left < 0.6 * _GATE and turned > _GATE_TURNED:
            return f"{math.degrees(turned):.1f} degrees against the axis"
        if self.is_within_walls(robot) and beside > self._corridor:
            return "too near the walls"
        return ""


class DockingProgress:
    """Estimates and counters of a docking.

    Attributes:
        now: stamp of the tick, s.
        retries: how often it retreated to try again.
        unclear: how often an approach was given up as the axis was not known well enough.
        lost_at_the_end: whether the marker was lost at the end of the approach.
    """

    def __init__(self, belief: DockBelief):
        self.belief, self.settings = belief, belief.settings
        self.axis, self.paths = DockAxis(belief), PathPlanner(belief)
        self.search = MarkerSearch(belief, self.paths)
        self.now = 0.0
        self.retries = self.unclear = self._stagings = self._rejections = 0
        self.lost_at_the_end = False
        self._at_rest_since = math.inf
        self._noted: tuple[MarkerTrack | None, int] = (None, 0)

    def note_command(self, command: Command) -> None:
        """Note the command (m/s, rad/s) that is in force now."""
        is_rest = command == STANDSTILL
        self._at_rest_since = min(self._at_rest_since, self.now) if is_rest else math.inf

    def is_settled(self) -> bool:
        """Return whether the robot has stood for so long that images count."""
        return self.now - self._at_rest_since >= _SETTLE_SECONDS

    @property
    def left(self) -> float:
        """How far the robot has to go along the axis, m; the marker was seen."""
        return self.axis.left(self.belief.estimate().robot)

    @property
    def is_near(self) -> bool:
        """Whether it is on the last part of the approach."""
        return abs(self.left) < _BLIND

    def unseen(self, track: MarkerTrack) -> float:
        """Return for how long a track was not seen, s."""
        return self.now - track.last_seen

    def is_in_reach(self, robot: PlanarPose) -> bool:
        """Return whether the marker is near enough to be found, as it was from as far before."""
        track = self.belief.best()
        before = 0.0 if track is None else _AS_FAR * track.found_from
        reach = math.hypot(robot[0] + self.belief.mount.x, robot[1])
        return reach < max(self.belief.visibility.farthest, before)

    def reject_track(self, track: MarkerTrack) -> bool:
        """Return whether a track is too uncertain to follow it between the walls, and count that.

        After a few rejections, less certainty is needed.
        """
        if track.real >= _SURE or (self._rejections >= _MOST_REJECTIONS and track.real > 0.2):
            return False
        copy = self.belief.copy
        if track.real > 0.5 and copy is not None:
            # If real, it is on the back wall, where a larger copy is.
            off = np.abs(se2.between(copy.likeliest().mean, track.likeliest().mean))
            if off[0] < _SAME_PLANE and off[1] < 0.5 * self.belief.dock.walls.opening:
                return False
        self._rejections += 1
        return True

    def note_images(self) -> bool:
        """Note how often the best track was seen; return whether it was since the last note."""
        track = self.belief.best()
        known, frames = self._noted
        self._noted = track, track.frames
        return track is not known or track.frames - frames >= MEASURE_FRAMES

    def count_staging(self, message: str) -> None:
        """Count a drive for a better start; after the last one, raise DockingFailureError."""
        self._stagings += 1
        if self._stagings > _MOST_STAGINGS:
            raise DockingFailureError(DockingError.STAGING_FAILED, message)

    def count_retry(self, trouble: str) -> None:
        """Count a retreat for another try; after the last one, raise DockingFailureError."""
        if self.retries >= self.settings.max_retries:
            raise DockingFailureError(DockingError.CONTROL_FAILED, f"gave up: {trouble}")
        self.retries += 1

    def is_yaw_unsure(self) -> bool:
        """Return whether to drive in once more to measure the yaw better.

        Only driving with the marker in sight shows how far the camera is turned.
        """
        deviation = self.belief.best().learned().yaw.deviation
        rounds = min(self.settings.max_retries, _MOST_ROUNDS)
        return deviation > _UNSURE * self.belief.dock.tolerance.yaw and self.retries < rounds

    def may_drive_blind(self, track: MarkerTrack) -> bool:
        """Return whether to drive the last part of the approach without seeing the marker.

        It leaves the image of a camera that is pitched, or was lost there before. Odometry is good
        enough for what is left.
        """
        estimate, tolerance = self.belief.estimate(), self.belief.dock.tolerance
        along, across = estimate.deviations[0], estimate.lateral_deviation
        certain = along < tolerance.distance and across < tolerance.lateral
        return certain and self.is_near and (self.lost_at_the_end or self.belief.cut_off(track))

    def limit_to_sight(self, left: float) -> float:
        """Return so much left to go (m), or less where the marker would not be found there."""
        return min(left, 0.9 * self.belief.visibility.farthest - self.belief.dock.docked_distance)
