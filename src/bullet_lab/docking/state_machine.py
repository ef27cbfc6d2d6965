"""State machine of a docking, from the search for the marker to the dock.

At each tick the state returns a command, or an outcome; `TRANSITIONS` has the state that follows.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Dict, NamedTuple, Optional, Tuple, Type, Union

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.se2 import wrap
from bullet_lab.docking.control import PathFollower, clip, turn_command
from bullet_lab.docking.filter import GaussianPose
from bullet_lab.docking.marker_track import MarkerTrack
from bullet_lab.docking.planner import DockingFailureError, DockingPlanner
from bullet_lab.docking.types import STANDSTILL, Command, DockingError, DockingState, Point

_CHECK_SECONDS = 0.5
_FACING = math.radians(12.0)
# Of the approach: m, left to go; and of the confirmation: m/s, rad/s, and how often.
_THERE = 0.0008
_CREEP, _FINE_TURN, _MOST_CORRECTIONS = 0.012, 0.05, 8
_LEAST_RETREAT = 0.2
# Share of the tolerances of lateral offset and yaw within which a robot holds itself to be docked.
_SURELY_WITHIN = 0.5
# States that may follow each other in one tick.
_MOST_TRANSITIONS = 3


class Outcome(NamedTuple):
    """How a state ended: a name of `TRANSITIONS`, and the arguments of the next state."""

    name: str
    arguments: Tuple = ()


Step = Union[Command, Outcome]


class State(ABC):
    """One phase of a docking."""

    state = DockingState.SEARCHING  #: as it is reported
    detail = ""  #: one line for humans

    @abstractmethod
    def step(self, planner: DockingPlanner) -> Step:
        """Return the command for now, or how it ended; raises DockingFailureError."""

    def wants_images(self, planner: DockingPlanner) -> bool:
        """Return whether an image would be used now."""
        return True

    def plan(self) -> Tuple[Point, ...]:
        """Return points that are still to be driven to, in the odometry frame."""
        return ()


class Search(State):
    """Looks for the marker at rest, and decides where to look next."""

    detail = "looking for the marker"

    def __init__(self):
        self._since: Optional[int] = None

    def wants_images(self, planner: DockingPlanner) -> bool:  # noqa: D102 - inherited
        return planner.settled()

    def step(self, planner: DockingPlanner) -> Step:  # noqa: D102 - inherited
        belief, frames = planner.belief, planner.settings.look_frames
        if belief.best() is not None:
            return Outcome("seen")
        if self._since is None or not planner.settled():
            self._since = belief.images
        enough = belief.images - self._since >= (3 * frames if belief.pending() else frames)
        return self._elsewhere(planner) if enough and planner.settled() else STANDSTILL

    def _elsewhere(self, planner: DockingPlanner) -> Outcome:
        planner.lookout.add_miss()
        if not planner.search:
            raise DockingFailureError(DockingError.NOT_DETECTED, "the marker is not in sight")
        if planner.belief.particles.mass < planner.settings.give_up_mass:
            message = "the marker is not found in the search region"
            raise DockingFailureError(DockingError.NOT_DETECTED, message)
        if planner.belief.copies_seen() and not planner.lookout.use_cue():
            way = planner.probing_way()
            if way:
                return Outcome("size unknown", (way,))
        view = planner.next_view()
        if view is None:
            message = "no safe place to look for the marker from"
            raise DockingFailureError(DockingError.NOT_DETECTED, message)
        return Outcome("not seen", (PathFollower(view.way, planner.settings), view.heading))


class Drive(State):
    """Drives along a path as long as it is safe."""

    def __init__(self, way: PathFollower):
        self._way = way
        self._checked = -math.inf

    def plan(self) -> Tuple[Point, ...]:  # noqa: D102 - inherited
        return self._way.left

    def step(self, planner: DockingPlanner) -> Step:  # noqa: D102 - inherited
        if planner.now - self._checked >= _CHECK_SECONDS:
            self._checked = planner.now
            if not planner.still_safe(self._way.left):
                return Outcome("not safe")
        command = self._way.command(planner.belief.pose)
        return Outcome("arrived") if command == STANDSTILL else command


class DriveToView(Drive):
    """Drives to a place, turns to a heading (rad) and looks."""

    detail = "going to where the marker may be seen"

    def __init__(self, way: PathFollower, heading: float):
        super().__init__(way)
        self._heading = heading

    def wants_images(self, planner: DockingPlanner) -> bool:  # noqa: D102 - inherited
        return planner.lookout.chance_to_see() > 0.05

    def step(self, planner: DockingPlanner) -> Step:  # noqa: D102 - inherited
        if planner.belief.best() is not None:
            return Outcome("seen")
        result = super().step(planner)
        if result != Outcome("arrived"):
            return result
        left = wrap(self._heading - planner.belief.pose[2])
        command = turn_command(left, planner.settings.turn_speed)
        return Outcome("arrived") if command == STANDSTILL else command


class DriveToStaging(Drive):
    """Drives to the point before the dock."""

    state = DockingState.STAGING
    detail = "going to the point before the dock"

    def wants_images(self, planner: DockingPlanner) -> bool:  # noqa: D102 - inherited
        estimate = planner.estimate()
        return estimate is not None and planner.marker_in_view(estimate)

    def step(self, planner: DockingPlanner) -> Step:  # noqa: D102 - inherited
        return Outcome("lost") if planner.estimate() is None else super().step(planner)


class Probe(State):
    """Drives a little (m; negative: back), to see how the size of a print changes.

    While `searching`, it ends as soon as the marker is found.
    """

    detail = "measuring the size of a print"

    def __init__(self, way: float, searching: bool = True):
        self._way, self._searching = way, searching
        self._start: Optional[np.ndarray] = None

    def step(self, planner: DockingPlanner) -> Step:  # noqa: D102 - inherited
        pose = np.asarray(planner.belief.pose)
        if self._start is None:
            self._start = pose
        moved = se2.between(self._start, pose)
        left = abs(self._way) - abs(float(moved[0]))
        if left <= 0.0 or (self._searching and planner.belief.best() is not None):
            return Outcome("done")
        speed = math.copysign(min(0.2, 0.05 + left), self._way)
        return speed, clip(-2.0 * float(moved[2]), 0.3)


class Measure(State):
    """Turns to the marker, measures at rest and decides what to do."""

    state = DockingState.MEASURING
    detail = "measuring"

    def __init__(self):
        self._track: Optional[MarkerTrack] = None
        self._frames = 0
        self._turned = False
        self._waited = 0.0

    def wants_images(self, planner: DockingPlanner) -> bool:  # noqa: D102 - inherited
        return planner.settled()

    def step(self, planner: DockingPlanner) -> Step:  # noqa: D102 - inherited
        track, estimate = planner.belief.best(), planner.estimate()
        if track is None or estimate is None:
            return Outcome("lost")
        x, y, _ = estimate.mean
        off = math.atan2(y, x - planner.ahead)
        if not self._turned and abs(off) > _FACING:
            return turn_command(off, planner.settings.turn_speed, 0.0)
        self._turned = True
        if track is not self._track or not planner.settled():
            self._track, self._frames, self._waited = track, track.frames, planner.now
            return STANDSTILL
        if track.frames - self._frames >= planner.settings.measure_frames:
            return decide(planner)
        patience = planner.settings.unseen_timeout
        # Images came, but none with the marker.
        missing = planner.belief.last_image - max(track.last_seen, self._waited) > patience
        if planner.now - self._waited <= 2.0 * patience or not missing:
            return STANDSTILL
        if not planner.in_reach(estimate.robot):
            return decide(planner)
        planner.belief.forget(track)
        return Outcome("lost")


def decide(planner: DockingPlanner) -> Outcome:
    """Return what follows from a measurement at rest."""
    estimate, track = planner.estimate(), planner.belief.best()
    robot = estimate.robot
    within = planner.lane.within_walls(robot)
    left = planner.left(robot)
    if within and _is_doubtful(planner, track):
        return _back_out(planner, left, 0.35)
    if planner.lane.holds(robot, left, estimate.lateral_deviation):
        return Outcome("in the lane")
    if within:
        return _back_out(planner, left, 0.30)
    _count_staging(planner, "the point before the dock is not reached")
    way = planner.way_to_staging(estimate)
    if way is not None:
        return Outcome("off the lane", (PathFollower(way, planner.settings),))
    if not planner.note_progress():
        # It was not seen on the last such drive: search for a place that sees it.
        planner.belief.forget(track)
        return Outcome("lost")
    # A print of unknown size may be anywhere on the line of sight, and so an obstacle; a little
    # drive shows where it is.
    probe = planner.probing_way()
    if not probe:
        message = "no safe way to the point before the dock"
        raise DockingFailureError(DockingError.STAGING_FAILED, message)
    return Outcome("size unknown", (probe, False))


def _is_doubtful(planner: DockingPlanner, track: MarkerTrack) -> bool:
    """Return whether a track may not be followed between the walls, and count the doubt."""
    if planner.is_sure(track):
        return False
    planner.doubts += 1
    return True


def _back_out(planner: DockingPlanner, left: float, further: float) -> Outcome:
    """Return the way back on the axis for a better start; it costs one drive to the staging point.

    It leaves the range of a small marker if it must: a larger copy needs the distance.
    """
    _count_staging(planner, "no way into the dock is found")
    if not planner.note_progress():
        # The same again would end the same: search for a better place.
        planner.belief.forget(planner.belief.best())
        return Outcome("lost")
    target = left + further
    return Outcome("bad start", (target, planner.in_sight(target) > left + _LEAST_RETREAT))


def _look_aside(planner: DockingPlanner, estimate: GaussianPose) -> Optional[Outcome]:
    """Return the drive to a place beside the axis; None if another approach may do.

    An approach has shown before that the yaw is not visible from the axis.
    """
    if planner.lane.leads_at_an_edge(estimate.robot, 0.0):
        return None
    planner.unclear += 1
    way = planner.way_aside(estimate) if planner.unclear > 1 else None
    if way is None:
        return None
    _count_staging(planner, "no way into the dock is found")
    return Outcome("unclear", (PathFollower(way, planner.settings),))


def _count_staging(planner: DockingPlanner, message: str) -> None:
    planner.stagings += 1
    if planner.stagings > planner.settings.max_stagings:
        raise DockingFailureError(DockingError.STAGING_FAILED, message)


def _retry(planner: DockingPlanner, left: float, trouble: str) -> Outcome:
    """Return the way back for another try; fails when it was the last one."""
    if planner.retries >= planner.max_retries:
        raise DockingFailureError(DockingError.CONTROL_FAILED, f"gave up: {trouble}")
    planner.retries += 1
    return Outcome("failed", (max(left, 0.0) + 0.6,))


class Approach(State):
    """Drives in on the axis, measuring all the way."""

    state = DockingState.APPROACHING
    detail = "approaching"

    def __init__(self):
        self._held: Optional[float] = None
        self._entered = False

    def step(self, planner: DockingPlanner) -> Step:  # noqa: D102 - inherited
        track, estimate = planner.belief.best(), planner.estimate()
        if estimate is None:
            return Outcome("lost")
        robot = estimate.robot
        left = planner.left(robot)
        patience = planner.settings.unseen_timeout
        missing = planner.unseen(track) > patience and planner.in_reach(robot)
        if missing and not planner.blind(track, left):
            # Wait at rest for it to be seen again.
            self._held = planner.now if self._held is None else self._held
            if planner.now - self._held <= patience:
                return STANDSTILL
            if not planner.near(left):
                return Outcome("lost")
            # Something hides it, or it is not found from here only.
            planner.lost_at_the_end = True
            if not planner.blind(track, left):
                return _retry(planner, left, "the marker is lost before the dock")
        self._held = None
        if left <= _THERE:
            return Outcome("arrived")
        trouble = gate(planner, robot, left)
        if trouble:
            return _retry(planner, left, trouble)
        if planner.lane.leads_at_an_edge(robot, estimate.lateral_deviation):
            return _look_aside(planner, estimate) or _back_out(planner, left, 0.5)
        if planner.lane.within_walls(robot) and not self._entered:
            self._entered = True
            if _is_doubtful(planner, track):
                return _back_out(planner, left, 0.35)
        return planner.tracker.forwards(robot, left)


def gate(planner: DockingPlanner, robot: np.ndarray, left: float) -> str:
    """Return why an approach has to be given up with m left to go; empty if it goes well."""
    settings = planner.settings
    beside, turned = abs(float(robot[1])), abs(wrap(float(robot[2])))
    if left < settings.gate_distance and beside > settings.gate_lateral:
        return f"{1e3 * beside:.0f} mm beside the axis"
    if left < 0.6 * settings.gate_distance and turned > settings.gate_yaw:
        return f"{math.degrees(turned):.1f} degrees against the axis"
    if planner.lane.within_walls(robot) and beside > planner.lane.corridor:
        return "too near the walls"
    return ""


class Retreat(State):
    """Drives straight back on the axis until so much is left to go (m), for another try.

    `in_sight`: only as far as the marker can be found.
    """

    state = DockingState.RETREATING
    detail = "backing out"

    def __init__(self, left: float, in_sight: bool = True):
        self._target, self._in_sight = left, in_sight
        self._since: Optional[float] = None

    def step(self, planner: DockingPlanner) -> Step:  # noqa: D102 - inherited
        estimate = planner.estimate()
        if estimate is None:
            return Outcome("lost")
        target = planner.in_sight(self._target) if self._in_sight else self._target
        left = target - planner.left(estimate.robot)
        self._since = planner.now if self._since is None else self._since
        # It may not be found from the place of the start only.
        unseen = min(planner.unseen(planner.belief.best()), planner.now - self._since)
        if left <= 0.0:
            return Outcome("arrived")
        if self._in_sight and unseen > 2.0 * planner.settings.unseen_timeout:
            return Outcome("lost")
        return planner.tracker.backwards(estimate.robot, left)


class BackOut(Retreat):
    """Drives straight back on the axis for a better start, which is no retry."""

    state = DockingState.STAGING


class Confirm(State):
    """Stands before the marker, measures, corrects what can be corrected there."""

    state = DockingState.MEASURING
    detail = "measuring where it stands"

    def __init__(self):
        self._frames: Optional[int] = None
        self._since = 0.0
        self._correction: Optional[Command] = None
        self._corrections = 0

    def step(self, planner: DockingPlanner) -> Step:  # noqa: D102 - inherited
        track, estimate = planner.belief.best(), planner.estimate()
        if estimate is None:
            return Outcome("lost")
        robot, settings = estimate.robot, planner.settings
        left, turned = planner.left(robot), wrap(float(robot[2]))
        if self._correction is not None:
            # Turn or creep until the estimate is there.
            v, w = self._correction
            done = turned * w >= -1e-4 if w else left * v <= 0.0
            if not done and planner.now - self._since <= 6.0:
                return v, w
            self._correction, self._frames = None, None
            return STANDSTILL
        if self._frames is None or not planner.settled():
            self._frames, self._since = track.frames, planner.now
            return STANDSTILL
        uncertain = float(estimate.deviations[2]) > 0.3 * planner.dock.tolerance.yaw
        patience = settings.unseen_timeout
        waited, seen = planner.now - self._since, track.frames - self._frames
        if min(waited, planner.unseen(track)) > patience and planner.blind(track, left):
            return self._judge(planner, robot)
        # In poor light, or when images get lost, it does not wait for all of them.
        late = waited > 5.0 * patience
        if seen >= settings.final_frames * (3 if uncertain and not late else 1):
            return self._judge(planner, robot)
        if late and (planner.unseen(track) > 2.0 * patience or waited > 10.0 * patience):
            planner.lost_at_the_end = True
            return _retry(planner, left, "the marker is lost before the dock")
        return STANDSTILL

    def _judge(self, planner: DockingPlanner, robot: np.ndarray) -> Step:
        tolerance = planner.dock.tolerance
        left, beside, turned = planner.left(robot), float(robot[1]), wrap(float(robot[2]))
        # The true error may be larger than the measured one: in glare all images from one place
        # are off together. The last try takes the risk.
        share = 1.0 if planner.retries >= planner.max_retries else _SURELY_WITHIN
        if abs(beside) > share * tolerance.lateral:
            return _retry(planner, left, f"{1e3 * abs(beside):.1f} mm beside the axis")
        straight = abs(turned) <= share * tolerance.yaw
        if straight and abs(left) <= tolerance.distance:
            if planner.unsure_of_yaw():
                return _retry(planner, left, "the yaw is not known well enough")
            return Outcome("within tolerance")
        self._corrections += 1
        if self._corrections > _MOST_CORRECTIONS:
            return _retry(planner, left, "distance and yaw do not settle")
        if not straight:
            self._correction = (0.0, -math.copysign(_FINE_TURN, turned))
        else:
            self._correction = (math.copysign(_CREEP, left), 0.0)
        return STANDSTILL


class Docked(State):
    """Stands in the dock."""

    state = DockingState.DOCKED
    detail = "docked"

    def step(self, planner: DockingPlanner) -> Step:  # noqa: D102 - inherited
        return STANDSTILL


TRANSITIONS: Dict[Type[State], Dict[str, Type[State]]] = {
    Search: {"seen": Measure, "not seen": DriveToView, "size unknown": Probe},
    DriveToView: {"seen": Measure, "arrived": Search, "not safe": Search},
    Probe: {"done": Search},
    Measure: {
        "in the lane": Approach,
        "off the lane": DriveToStaging,
        "bad start": BackOut,
        "size unknown": Probe,
        "lost": Search,
    },
    DriveToStaging: {"arrived": Measure, "not safe": Measure, "lost": Search},
    Approach: {
        "arrived": Confirm,
        "failed": Retreat,
        "bad start": BackOut,
        "unclear": DriveToStaging,
        "lost": Measure,
    },
    BackOut: {"arrived": Measure, "lost": Measure},
    Retreat: {"arrived": Measure, "lost": Measure},
    Confirm: {"within tolerance": Docked, "failed": Retreat, "lost": Measure},
    Docked: {},
}
"""The state that follows each one, by its outcome. The first is `Search`."""


class StateMachine:
    """Runs the states of one docking, which share a planner; `state` is the present one."""

    def __init__(self, planner: DockingPlanner):
        self._planner = planner
        self.state: State = Search()

    def step(self) -> Command:
        """Ask the state, and those that follow at once, for a command (m/s, rad/s)."""
        for _ in range(_MOST_TRANSITIONS):
            result = self.state.step(self._planner)
            if not isinstance(result, Outcome):
                return result
            following = TRANSITIONS[type(self.state)][result.name]
            self.state = following(*result.arguments)
        return STANDSTILL
