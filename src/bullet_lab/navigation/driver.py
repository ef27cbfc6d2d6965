"""Drives to a goal on a map, around what the laser sees in the way."""

from __future__ import annotations

import math

from bullet_lab.core.se2 import PlanarPose, hypot, wrap
from bullet_lab.drive import STANDSTILL, Command, DrivePhase, GoalDriver, GoalLimits
from bullet_lab.navigation.occupancy import RobotCostmap
from bullet_lab.navigation.paths import PathFollower, Point

USUAL = GoalLimits()
"""The limits by default."""

# m to the goal within which the robot drives at it, beyond along the plan.
STRAIGHT_ON = 0.25
# Seconds between two attempts to plan if there is no way.
RETRY = 1.0
# A robot that moves less (m, rad) in so many seconds although it should move is stuck.
MOVED, TURNED, STUCK = 0.03, 0.1, 4.0
# It then drives back: m/s and s; after so many times at one place it gives up.
BACK_SPEED, BACK_SECONDS = 0.1, 2.0
# m of floor behind that must be free.
BEHIND = 0.2
MOST_RECOVERIES = 3
# m that it has driven by when that count starts anew.
ON_THE_WAY = 0.5


class MapDriver(GoalDriver):
    """Computes the velocity towards one goal on a map, in whose frame all poses are.

    It gives up after `wait` s without a way.

    Attributes:
        costmap: the robot's, to which its user passes on the scans; it may be replaced.
        failure: why the goal cannot be reached; empty while it may be.
        plans: number of plans so far.
    """

    def __init__(
        self,
        goal: PlanarPose,
        costmap: RobotCostmap,
        limits: GoalLimits = USUAL,
        wait: float = 15.0,
        command: Command = STANDSTILL,
    ):
        super().__init__(goal, limits, command)
        self.costmap, self._wait = costmap, wait
        self.failure, self.plans = "", 0
        self._follower: PathFollower | None = None
        self._now = self._next_try = self._back_until = 0.0
        self._since = math.inf
        self._cleared = False
        # Where and when the robot was last seen to move, and where it drove back first.
        self._moved: tuple[PlanarPose, float] | None = None
        self._first_stuck: PlanarPose | None = None
        self._times_here = 0

    @property
    def plan(self) -> tuple[Point, ...]:
        """The points that are left of the plan; empty without one."""
        return () if self._follower is None else self._follower.left

    def command(self, pose: PlanarPose, seconds: float) -> Command:
        """Return the velocity (m/s, rad/s) for the present pose; see `failure`."""
        self._now += seconds
        if self.phase is DrivePhase.DRIVING and self._now >= self._back_until:
            self._plan(pose)
            self._look_whether_stuck(pose)
        return super().command(pose, seconds)

    def _plan(self, pose: PlanarPose) -> None:
        """Plan if there is no plan, it is driven to its end, or something is in its way."""
        if self.plan and self.costmap.is_free(self.plan, pose):
            return
        if self._now < self._next_try:
            return
        way = self.costmap.plan(pose, self.goal)
        if way is not None:
            self._follower, self._since, self._cleared = PathFollower(way), math.inf, False
            self.plans += 1
            return
        self._follower, self._next_try = None, self._now + RETRY
        self._since = min(self._since, self._now)
        waited = self._now - self._since
        if waited >= 0.5 * self._wait and not self._cleared:
            # What the laser saw before may be gone.
            self._cleared = True
            self.costmap.clear()
        elif waited >= self._wait:
            self.failure = self.costmap.why_not(self.goal)

    def _look_whether_stuck(self, pose: PlanarPose) -> None:
        """Drive back if the robot should move and does not, and give up in the end."""
        if self._moved is None or self._follower is None:
            self._moved = (pose, self._now)
        before, since = self._moved
        away = hypot(pose[0] - before[0], pose[1] - before[1])
        if away > MOVED or abs(wrap(pose[2] - before[2])) > TURNED:
            self._moved = (pose, self._now)
        elif self._now - since >= STUCK:
            self._recover(pose)

    def _recover(self, pose: PlanarPose) -> None:
        place = self._first_stuck
        if place is None or hypot(pose[0] - place[0], pose[1] - place[1]) > ON_THE_WAY:
            self._first_stuck, self._times_here = pose, 0
        if self._times_here >= MOST_RECOVERIES:
            self.failure = (
                f"the robot is stuck at ({pose[0]:.2f}, {pose[1]:.2f}) m: something holds it that "
                "the laser does not see"
            )
            return
        self._times_here += 1
        self.costmap.clear()
        self._follower, self._moved = None, None
        self._back_until = self._now + BACK_SECONDS

    def _drive(self, pose: PlanarPose, left: float) -> Command:
        if self._now < self._back_until:
            x, y, yaw = pose
            behind = (x - BEHIND * math.cos(yaw), y - BEHIND * math.sin(yaw))
            may = self.costmap.is_free([behind], pose)
            return (-BACK_SPEED, 0.0) if may else STANDSTILL
        if self._follower is None:
            return STANDSTILL
        limits = self._limits
        if left > STRAIGHT_ON or len(self._follower.left) > 1:
            v, w = self._follower.command(pose, limits.speed, limits.turn_speed)
            if v == 0.0 and w != 0.0:
                # Friction may hold a robot that turns slowly.
                slowest = min(limits.turn_speed, self._slowest_turn.now(pose[2]))
                return 0.0, math.copysign(max(abs(w), slowest), w)
            if v != 0.0:
                return v, w
        return super()._drive(pose, left)
