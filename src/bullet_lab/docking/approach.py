"""On the dock's axis: in, out again, the check at the end, and what follows from a measurement."""

from __future__ import annotations

import math
from typing import Optional, Tuple

import numpy as np

from bullet_lab.core.angles import wrap
from bullet_lab.docking.drive import FollowWay
from bullet_lab.docking.phases import Measure, Phase, Stage, probe_size
from bullet_lab.docking.pilot import Pilot
from bullet_lab.docking.types import STANDSTILL, Command, DockingError, DockingState

_THERE = 0.0008
_CREEP = 0.012
_FINE_TURN = 0.05
_MOST_CORRECTIONS = 8
_LEAST_RETREAT = 0.2


class Approach(Phase):
    """Drives in on the axis, measuring all the way."""

    state = DockingState.APPROACHING
    detail = "approaching"

    def __init__(self):
        self._held: Optional[float] = None
        self._entered = False

    def step(self, pilot: Pilot) -> Tuple[Command, Optional[Phase]]:  # noqa: D102 - inherited
        candidate, estimate = pilot.knowledge.best(), pilot.estimate()
        if estimate is None:
            return STANDSTILL, Measure()
        robot = pilot.robot(estimate)
        left = pilot.left(robot)
        unseen = pilot.now - pilot.knowledge.last_seen(candidate)
        if unseen > pilot.settings.unseen_timeout and pilot.in_reach(robot):
            return STANDSTILL, self._hold(pilot)
        self._held = None
        if left <= _THERE:
            return STANDSTILL, Confirm()
        trouble = gate(pilot, robot, left)
        if trouble:
            return STANDSTILL, retreat(pilot, left, trouble)
        if pilot.lane.leads_at_an_edge(robot, pilot.deviation(estimate)):
            return STANDSTILL, back_out(pilot, left, 0.5)
        if pilot.lane.within_walls(robot) and not self._entered:
            self._entered = True
            if not pilot.sure(candidate):
                return STANDSTILL, back_out(pilot, left, 0.35)
        return pilot.tracker.forwards(robot, left), None

    def _hold(self, pilot: Pilot) -> Optional[Phase]:
        """Wait at rest for the marker to be seen again, then look at what is the matter."""
        if self._held is None:
            self._held = pilot.now
        return Measure() if pilot.now - self._held > pilot.settings.unseen_timeout else None


def back_out(pilot: Pilot, left: float, further: float) -> Phase:
    """Return the way back on the axis for a better start.

    It goes out of sight of a small marker where it must: what a larger copy tells needs the way.
    It costs one of the drives to the staging point, so that it does not go on for ever.
    """
    pilot.stagings += 1
    if pilot.stagings > pilot.settings.max_stagings:
        pilot.fail(DockingError.STAGING_FAILED, "no way into the dock is found")
    target = left + further
    in_sight = pilot.in_sight(target) > left + _LEAST_RETREAT
    return Retreat(target, counts=False, in_sight=in_sight)


def gate(pilot: Pilot, robot: np.ndarray, left: float) -> str:
    """Say why an approach has to be given up; empty if it goes well."""
    settings = pilot.settings
    beside, turned = abs(float(robot[1])), abs(wrap(float(robot[2])))
    if left < settings.gate_distance and beside > settings.gate_lateral:
        return f"{1e3 * beside:.0f} mm beside the axis"
    if left < 0.6 * settings.gate_distance and turned > settings.gate_yaw:
        return f"{math.degrees(turned):.1f} degrees against the axis"
    if pilot.lane.within_walls(robot) and beside > pilot.lane.corridor:
        return "too near the walls"
    return ""


def retreat(pilot: Pilot, left: float, trouble: str) -> Phase:
    """Return the way back for another try; fails when it was the last one."""
    if pilot.retries >= pilot.max_retries:
        pilot.fail(DockingError.CONTROL_FAILED, f"gave up: {trouble}")
    pilot.retries += 1
    return Retreat(max(left, 0.0) + 0.6, counts=True)


class Retreat(Phase):
    """Drives straight back on the axis until so much is left to go.

    Args:
        left: m, to go at least when it has ended.
        counts: it is a retry, not a way to get a better start.
        in_sight: go only as far as the marker can be found.
    """

    state = DockingState.RETREATING
    detail = "backing out"

    def __init__(self, left: float, counts: bool, in_sight: bool = True):
        self._target, self._in_sight = left, in_sight
        if not counts:
            self.state = DockingState.STAGING

    def step(self, pilot: Pilot) -> Tuple[Command, Optional[Phase]]:  # noqa: D102 - inherited
        estimate = pilot.estimate()
        if estimate is None:
            return STANDSTILL, Measure()
        robot = pilot.robot(estimate)
        target = pilot.in_sight(self._target) if self._in_sight else self._target
        left = target - pilot.left(robot)
        unseen = pilot.now - pilot.knowledge.last_seen(pilot.knowledge.best())
        lost = unseen > 2.0 * pilot.settings.unseen_timeout and self._in_sight
        if left <= 0.0 or lost:
            return STANDSTILL, Measure()
        return pilot.tracker.backwards(robot, left), None


class Confirm(Phase):
    """Stands before the marker, measures, corrects what can be corrected there."""

    state = DockingState.MEASURING
    detail = "measuring where it stands"

    def __init__(self):
        self._frames: Optional[int] = None
        self._since = 0.0
        self._correct: Optional[Command] = None
        self._corrections = 0

    def step(self, pilot: Pilot) -> Tuple[Command, Optional[Phase]]:  # noqa: D102 - inherited
        candidate, estimate = pilot.knowledge.best(), pilot.estimate()
        if estimate is None:
            return STANDSTILL, Measure()
        robot = pilot.robot(estimate)
        left, turned = pilot.left(robot), wrap(float(robot[2]))
        if self._correct is not None:
            return self._corrected(pilot, left, turned), None
        if pilot.resting() < pilot.settings.settle_time or self._frames is None:
            self._frames, self._since = candidate.frames, pilot.now
            return STANDSTILL, None
        wanted = pilot.settings.final_frames
        if float(estimate.deviations[2]) > 0.3 * pilot.dock.tolerance.yaw:
            wanted *= 3
        if candidate.frames - self._frames < wanted:
            if pilot.now - self._since > 5.0 * pilot.settings.unseen_timeout:
                return STANDSTILL, retreat(pilot, left, "the marker is lost before the dock")
            return STANDSTILL, None
        return self._judge(pilot, robot, left, turned)

    def _judge(self, pilot: Pilot, robot, left: float, turned: float):
        tolerance = pilot.dock.tolerance
        beside = float(robot[1])
        if abs(beside) > tolerance.lateral:
            return STANDSTILL, retreat(pilot, left, f"{1e3 * abs(beside):.1f} mm beside the axis")
        if abs(left) <= tolerance.distance and abs(turned) <= tolerance.yaw:
            return STANDSTILL, Docked()
        self._corrections += 1
        if self._corrections > _MOST_CORRECTIONS:
            return STANDSTILL, retreat(pilot, left, "distance and yaw do not settle")
        if abs(turned) > tolerance.yaw:
            self._correct = (0.0, -math.copysign(_FINE_TURN, turned))
        else:
            self._correct = (math.copysign(_CREEP, left), 0.0)
        return STANDSTILL, None

    def _corrected(self, pilot: Pilot, left: float, turned: float) -> Command:
        """Turn or creep until the estimate says that it is done."""
        v, w = self._correct
        done = turned * w >= -1e-4 if w else left * v <= 0.0
        if done or pilot.now - self._since > 6.0:
            self._correct, self._frames = None, None
            return STANDSTILL
        return v, w


class Docked(Phase):
    """Stands in the dock."""

    state = DockingState.DOCKED
    detail = "docked"

    def wants_images(self, pilot: Pilot) -> bool:  # noqa: D102 - inherited
        return False

    def step(self, pilot: Pilot) -> Tuple[Command, Optional[Phase]]:  # noqa: D102 - inherited
        return STANDSTILL, None


def decide(pilot: Pilot) -> Phase:
    """Return what to do about a marker that was measured at rest."""
    estimate, candidate = pilot.estimate(), pilot.knowledge.best()
    robot = pilot.robot(estimate)
    if pilot.lane.within_walls(robot):
        if not pilot.sure(candidate):
            return back_out(pilot, pilot.left(robot), 0.35)
        if pilot.in_lane(estimate):
            return Approach()
        return back_out(pilot, pilot.left(robot), 0.30)
    if pilot.in_lane(estimate):
        return Approach()
    return go_to_staging(pilot)


def go_to_staging(pilot: Pilot) -> Phase:
    """Return the drive to the staging point; fails after too many, or without a way.

    What shows the marker and is of unknown size may be anywhere on the line of sight, and so in
    the way; a little drive tells where it is.
    """
    estimate = pilot.estimate()
    pilot.stagings += 1
    if pilot.stagings > pilot.settings.max_stagings:
        pilot.fail(DockingError.STAGING_FAILED, "the point before the dock is not reached")
    found = pilot.way_to_staging(estimate)
    if found is None:
        probe = probe_size(pilot, searching=False)
        if probe is not None:
            return probe
        pilot.fail(DockingError.STAGING_FAILED, "no safe way to the point before the dock")
    way, heading = found
    return Stage(FollowWay(way, pilot.settings), heading)
