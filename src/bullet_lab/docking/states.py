"""States of a docking, from the search for the marker to the dock.

At each tick the state returns a command, or an outcome; `TRANSITIONS` has the state that follows.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import NamedTuple, Sequence, Tuple, Union

from bullet_lab.core import se2
from bullet_lab.core.se2 import PlanarPose, wrap
from bullet_lab.docking.filter import GaussianPose
from bullet_lab.docking.marker_track import MarkerTrack
from bullet_lab.docking.progress import MEASURE_FRAMES, DockingFailureError, DockingProgress
from bullet_lab.docking.types import DockingError, DockingState
from bullet_lab.drive import STANDSTILL, Command, clip
from bullet_lab.navigation.paths import PathFollower, Point, turn_command

_CHECK_SECONDS = 0.5
# Images of a look, and at rest for the confirmation.
_LOOK_FRAMES = 3
_FINAL_FRAMES = 5
# Without the marker while driving at it, s.
_UNSEEN = 1.2
# Share of the prior below which the marker is held to be missing.
_GIVE_UP_MASS = 0.004
_FACING = math.radians(12.0)
# Of the approach: m, left to go; and of the confirmation: m/s, rad/s, and how often.
_THERE = 0.0008
_CREEP, _FINE_TURN, _MOST_CORRECTIONS = 0.012, 0.05, 8
_LEAST_RETREAT = 0.2
# Share of the tolerances of lateral offset and yaw within which a robot holds itself to be docked.
_SURELY_WITHIN = 0.5


class Outcome(NamedTuple):
    """How a state ended: a name of `TRANSITIONS`, and the arguments of the next state."""

    name: str
    arguments: Tuple = ()


Step = Union[Command, Outcome]


class State(ABC):
    """One phase of a docking."""

    state = DockingState.SEARCHING  #: as it is reported

    @abstractmethod
    def step(self, docking: DockingProgress) -> Step:
        """Return the command for now, or how it ended; raises DockingFailureError."""

    def wants_images(self, docking: DockingProgress) -> bool:
        """Return whether an image would be used now."""
        return True

    def plan(self) -> tuple[Point, ...]:
        """Return points that are still to be driven to, in the odometry frame."""
        return ()


class LookForMarker(State):
    """Looks for the marker at rest, and decides where to look next."""

    _since: int | None = None

    def wants_images(self, docking: DockingProgress) -> bool:
        return docking.is_settled()

    def step(self, docking: DockingProgress) -> Step:
        belief = docking.belief
        if belief.best() is not None:
            return Outcome("seen")
        if self._since is None or not docking.is_settled():
            self._since = belief.images
        enough = belief.images - self._since >= (3 if belief.pending() else 1) * _LOOK_FRAMES
        return self._elsewhere(docking) if enough and docking.is_settled() else STANDSTILL

    def _elsewhere(self, docking: DockingProgress) -> Outcome:
        docking.search.add_failed_look()
        if not docking.settings.search:
            raise DockingFailureError(DockingError.NOT_DETECTED, "the marker is not in sight")
        if docking.belief.particles.mass < _GIVE_UP_MASS:
            message = "the marker is not found in the search region"
            raise DockingFailureError(DockingError.NOT_DETECTED, message)
        if docking.belief.copies_seen() and not docking.search.use_cue():
            way = docking.paths.choose_probe()
            if way:
                return Outcome("size unknown", (way,))
        view = docking.search.next_view()
        if view is None:
            message = "no safe place to look for the marker from"
            raise DockingFailureError(DockingError.NOT_DETECTED, message)
        return Outcome("not seen", view)


class DriveAlong(State):
    """Drives along a path as long as it is safe."""

    _checked = -math.inf

    def __init__(self, way: Sequence[Point]):
        self._way = PathFollower(way)

    def plan(self) -> tuple[Point, ...]:
        return self._way.left

    def step(self, docking: DockingProgress) -> Step:
        if docking.now - self._checked >= _CHECK_SECONDS:
            self._checked = docking.now
            if not docking.paths.is_safe(self._way.left):
                return Outcome("not safe")
        settings = docking.settings
        command = self._way.command(docking.belief.pose, settings.drive_speed, settings.turn_speed)
        return Outcome("arrived") if command == STANDSTILL else command


class DriveToView(DriveAlong):
    """Drives to a place, turns to a heading (rad) and looks."""

    def __init__(self, way: Sequence[Point], heading: float):
        super().__init__(way)
        self._heading = heading

    def wants_images(self, docking: DockingProgress) -> bool:
        return docking.search.chance_to_see() > 0.05

    def step(self, docking: DockingProgress) -> Step:
        if docking.belief.best() is not None:
            return Outcome("seen")
        result = super().step(docking)
        if result != Outcome("arrived"):
            return result
        left = wrap(self._heading - docking.belief.pose[2])
        command = turn_command(left, docking.settings.turn_speed)
        return Outcome("arrived") if command == STANDSTILL else command


class DriveToStaging(DriveAlong):
    """Drives to the point before the dock."""

    state = DockingState.STAGING

    def wants_images(self, docking: DockingProgress) -> bool:
        return docking.search.expects_marker()

    def step(self, docking: DockingProgress) -> Step:
        return Outcome("lost") if docking.belief.estimate() is None else super().step(docking)


class ProbeSize(State):
    """Drives a little (m; negative: back), to see how the size of a print changes.

    While `searching`, it ends as soon as the marker is found.
    """

    _start: PlanarPose | None = None

    def __init__(self, way: float, searching: bool = True):
        self._way, self._searching = way, searching

    def step(self, docking: DockingProgress) -> Step:
        self._start = self._start or docking.belief.pose
        ahead, _, turned = se2.between(self._start, docking.belief.pose).tolist()
        left = abs(self._way) - abs(ahead)
        if left <= 0.0 or (self._searching and docking.belief.best() is not None):
            return Outcome("done")
        speed = math.copysign(min(0.2, 0.05 + left), self._way)
        return speed, clip(-2.0 * turned, 0.3)


class TrackedState(State):
    """A phase in which the marker is seen, or was lately; without a track of it, it is lost."""

    def step(self, docking: DockingProgress) -> Step:
        estimate = docking.belief.estimate()
        if estimate is None:
            return Outcome("lost")
        return self.follow(docking, docking.belief.best(), estimate)

    @abstractmethod
    def follow(self, docking: DockingProgress, track: MarkerTrack, estimate: GaussianPose) -> Step:
        """Do as `step`, with the dock's pose by the best track."""


class Measure(TrackedState):
    """Turns to the marker, measures at rest and decides what to do."""

    state = DockingState.MEASURING

    _track: MarkerTrack | None = None
    _frames, _waited, _turned = 0, 0.0, False

    def wants_images(self, docking: DockingProgress) -> bool:
        return docking.is_settled()

    def follow(self, docking: DockingProgress, track: MarkerTrack, estimate: GaussianPose) -> Step:
        x, y, _ = estimate.mean
        off = math.atan2(y, x - docking.belief.mount.x)
        if not self._turned and abs(off) > _FACING:
            return turn_command(off, docking.settings.turn_speed, 0.0)
        self._turned = True
        if track is not self._track or not docking.is_settled():
            self._track, self._frames, self._waited = track, track.frames, docking.now
            return STANDSTILL
        if track.frames - self._frames >= MEASURE_FRAMES:
            return decide(docking)
        # Images came, but none with the marker.
        missing = docking.belief.last_image - max(track.last_seen, self._waited) > _UNSEEN
        if docking.now - self._waited <= 2.0 * _UNSEEN or not missing:
            return STANDSTILL
        if not docking.is_in_reach(estimate.robot):
            return decide(docking)
        docking.belief.forget(track)
        return Outcome("lost")


def decide(docking: DockingProgress) -> Outcome:
    """Return what follows from a measurement at rest."""
    estimate, track = docking.belief.estimate(), docking.belief.best()
    robot = estimate.robot
    within = docking.axis.is_within_walls(robot)
    if within and docking.reject_track(track):
        return _back_out(docking, 0.35)
    if docking.axis.is_in_lane(robot, estimate.lateral_deviation):
        return Outcome("in the lane")
    if within:
        return _back_out(docking, 0.30)
    docking.count_staging("the point before the dock is not reached")
    way = docking.paths.way_to_staging(estimate)
    if way is not None:
        return Outcome("off the lane", (way,))
    if not docking.note_images():
        # It was not seen on the last such drive: search for a place that sees it.
        docking.belief.forget(track)
        return Outcome("lost")
    # A print of unknown size may be anywhere on the line of sight, and so an obstacle; a little
    # drive shows where it is.
    probe = docking.paths.choose_probe()
    if not probe:
        message = "no safe way to the point before the dock"
        raise DockingFailureError(DockingError.STAGING_FAILED, message)
    return Outcome("size unknown", (probe, False))


def _back_out(docking: DockingProgress, further: float) -> Outcome:
    """Return the way back on the axis for a better start; it costs one drive to the staging point.

    It leaves the range of a small marker if it must: a larger copy needs the distance.
    """
    docking.count_staging("no way into the dock is found")
    if not docking.note_images():
        # The same again would end the same: search for a better place.
        docking.belief.forget(docking.belief.best())
        return Outcome("lost")
    target = docking.left + further
    in_sight = docking.limit_to_sight(target) > docking.left + _LEAST_RETREAT
    return Outcome("bad start", (target, in_sight))


def _look_aside(docking: DockingProgress, estimate: GaussianPose) -> Outcome | None:
    """Return the drive to a place beside the axis; None if another approach may do.

    An approach has shown before that the yaw is not visible from the axis.
    """
    if docking.axis.leads_at_an_edge(estimate.robot, 0.0):
        return None
    docking.unclear += 1
    if docking.unclear <= 1:
        return None
    # Left and right side take turns.
    way = docking.paths.way_aside(estimate, docking.unclear % 2 == 1)
    if way is None:
        return None
    docking.count_staging("no way into the dock is found")
    return Outcome("unclear", (way,))


def _retry(docking: DockingProgress, trouble: str) -> Outcome:
    """Return the way back for another try; fails when it was the last one."""
    docking.count_retry(trouble)
    return Outcome("failed", (max(docking.left, 0.0) + 0.6,))


class Approach(TrackedState):
    """Drives in on the axis, measuring all the way."""

    state = DockingState.APPROACHING

    _held, _entered = math.inf, False

    def follow(self, docking: DockingProgress, track: MarkerTrack, estimate: GaussianPose) -> Step:
        robot = estimate.robot
        missing = docking.unseen(track) > _UNSEEN and docking.is_in_reach(robot)
        if missing and not docking.may_drive_blind(track):
            # Wait at rest for it to be seen again.
            self._held = min(self._held, docking.now)
            if docking.now - self._held <= _UNSEEN:
                return STANDSTILL
            if not docking.is_near:
                return Outcome("lost")
            # Something hides it, or it is not found from here only.
            docking.lost_at_the_end = True
            if not docking.may_drive_blind(track):
                return _retry(docking, "the marker is lost before the dock")
        self._held = math.inf
        if docking.left <= _THERE:
            return Outcome("arrived")
        trouble = docking.axis.check_gate(robot)
        if trouble:
            return _retry(docking, trouble)
        if docking.axis.leads_at_an_edge(robot, estimate.lateral_deviation):
            return _look_aside(docking, estimate) or _back_out(docking, 0.5)
        if docking.axis.is_within_walls(robot) and not self._entered:
            self._entered = True
            if docking.reject_track(track):
                return _back_out(docking, 0.35)
        return docking.axis.forwards(robot)


class Retreat(TrackedState):
    """Drives straight back on the axis until so much is left to go (m), for another try.

    `in_sight`: only as far as the marker can be found.
    """

    state = DockingState.RETREATING

    _since = math.inf

    def __init__(self, left: float, in_sight: bool = True):
        self._target, self._in_sight = left, in_sight

    def follow(self, docking: DockingProgress, track: MarkerTrack, estimate: GaussianPose) -> Step:
        target = docking.limit_to_sight(self._target) if self._in_sight else self._target
        left = target - docking.left
        self._since = min(self._since, docking.now)
        # It may not be found from the place of the start only.
        unseen = min(docking.unseen(track), docking.now - self._since)
        if left <= 0.0:
            return Outcome("arrived")
        if self._in_sight and unseen > 2.0 * _UNSEEN:
            return Outcome("lost")
        return docking.axis.backwards(estimate.robot, left)


class BackOut(Retreat):
    """Drives straight back on the axis for a better start, which is no retry."""

    state = DockingState.STAGING


class Confirm(TrackedState):
    """Stands before the marker, measures, corrects what can be corrected there."""

    state = DockingState.MEASURING

    _frames: int | None = None
    _correction: Command | None = None
    _since, _corrections = 0.0, 0

    def follow(self, docking: DockingProgress, track: MarkerTrack, estimate: GaussianPose) -> Step:
        _, _, turned = estimate.robot
        if self._correction is not None:
            # Turn or creep until the estimate is there.
            v, w = self._correction
            done = turned * w >= -1e-4 if w else docking.left * v <= 0.0
            if not done and docking.now - self._since <= 6.0:
                return v, w
            self._correction, self._frames = None, None
            return STANDSTILL
        if self._frames is None or not docking.is_settled():
            self._frames, self._since = track.frames, docking.now
            return STANDSTILL
        uncertain = estimate.deviations[2] > 0.3 * docking.belief.dock.tolerance.yaw
        waited, seen = docking.now - self._since, track.frames - self._frames
        if min(waited, docking.unseen(track)) > _UNSEEN and docking.may_drive_blind(track):
            return self._judge(docking, estimate.robot)
        # In poor light, or when images get lost, it does not wait for all of them.
        late = waited > 5.0 * _UNSEEN
        if seen >= _FINAL_FRAMES * (3 if uncertain and not late else 1):
            return self._judge(docking, estimate.robot)
        if late and (docking.unseen(track) > 2.0 * _UNSEEN or waited > 10.0 * _UNSEEN):
            docking.lost_at_the_end = True
            return _retry(docking, "the marker is lost before the dock")
        return STANDSTILL

    def _judge(self, docking: DockingProgress, robot: PlanarPose) -> Step:
        tolerance = docking.belief.dock.tolerance
        _, beside, turned = robot
        # The true error may be larger than the measured one: in glare all images from one place
        # are off together. The last try takes the risk.
        share = 1.0 if docking.retries >= docking.settings.max_retries else _SURELY_WITHIN
        if abs(beside) > share * tolerance.lateral:
            return _retry(docking, f"{1e3 * abs(beside):.1f} mm beside the axis")
        straight = abs(turned) <= share * tolerance.yaw
        if straight and abs(docking.left) <= tolerance.distance:
            if docking.is_yaw_unsure():
                return _retry(docking, "the yaw is not known well enough")
            return Outcome("within tolerance")
        self._corrections += 1
        if self._corrections > _MOST_CORRECTIONS:
            return _retry(docking, "distance and yaw do not settle")
        if not straight:
            self._correction = (0.0, -math.copysign(_FINE_TURN, turned))
        else:
            self._correction = (math.copysign(_CREEP, docking.left), 0.0)
        return STANDSTILL


class Docked(State):
    """Stands in the dock."""

    state = DockingState.DOCKED

    def step(self, docking: DockingProgress) -> Step:
        return STANDSTILL


TRANSITIONS: dict[type[State], dict[str, type[State]]] = {
    LookForMarker: {"seen": Measure, "not seen": DriveToView, "size unknown": ProbeSize},
    DriveToView: {"seen": Measure, "arrived": LookForMarker, "not safe": LookForMarker},
    ProbeSize: {"done": LookForMarker},
    Measure: {
        "in the lane": Approach,
        "off the lane": DriveToStaging,
        "bad start": BackOut,
        "size unknown": ProbeSize,
        "lost": LookForMarker,
    },
    DriveToStaging: {"arrived": Measure, "not safe": Measure, "lost": LookForMarker},
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
"""The state that follows each one, by its outcome. The first is `LookForMarker`."""
