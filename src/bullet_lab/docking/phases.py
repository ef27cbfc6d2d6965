"""What is done in turn: look, go and look elsewhere, measure, go to staging.

A phase is asked for a command at each tick and says which phase is next.
"""

from __future__ import annotations

import math
from typing import Optional, Tuple

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.angles import wrap
from bullet_lab.docking.candidate import Candidate
from bullet_lab.docking.drive import FollowWay, clip, turn_command
from bullet_lab.docking.floor_map import Point
from bullet_lab.docking.pilot import FAR_MISSED, Pilot
from bullet_lab.docking.types import STANDSTILL, Command, DockingError, DockingState

_CHECK_SECONDS = 0.5
_MOST_PROBES = 6
_FACING = math.radians(12.0)


class Phase:
    """One thing that is done.

    Attributes:
        state: what it is called to the outside.
        detail: one line for humans.
    """

    state = DockingState.SEARCHING
    detail = ""

    def step(self, pilot: Pilot) -> Tuple[Command, Optional[Phase]]:
        """Return the command and the phase that follows, None to go on; may raise a failure."""
        raise NotImplementedError

    def wants_images(self, pilot: Pilot) -> bool:
        """Say whether an image would be used now."""
        return True

    def plan(self) -> Tuple[Point, ...]:
        """Return points that are still to be driven to, in the odometry frame."""
        return ()


class Look(Phase):
    """Stands and looks, and decides where to look next."""

    detail = "looking for the marker"

    def __init__(self):
        self._images = 0
        self._since: Optional[int] = None

    def wants_images(self, pilot: Pilot) -> bool:  # noqa: D102 - inherited
        return pilot.resting() >= pilot.settings.settle_time

    def step(self, pilot: Pilot) -> Tuple[Command, Optional[Phase]]:  # noqa: D102 - inherited
        knowledge, settings = pilot.knowledge, pilot.settings
        if knowledge.best() is not None:
            return STANDSTILL, Measure()
        if pilot.resting() < settings.settle_time:
            self._since = knowledge.images
            return STANDSTILL, None
        if self._since is None:
            self._since = knowledge.images
        images = knowledge.images - self._since
        patience = 3 * settings.look_frames if knowledge.pending() else settings.look_frames
        if images < patience:
            return STANDSTILL, None
        return STANDSTILL, self._go_on(pilot)

    def _go_on(self, pilot: Pilot) -> Phase:
        knowledge, settings = pilot.knowledge, pilot.settings
        cloud = knowledge.cloud
        camera = np.array([pilot.ahead, 0.0, 0.0])
        expected = knowledge.view.chance(se2.between(cloud.poses, camera))
        cloud.not_seen(expected, settings.missed)
        if pilot.far_view is not None and not knowledge.copies_seen():
            seen_far = pilot.far_view.chance(se2.between(cloud.poses, camera))
            cloud.not_seen(seen_far, FAR_MISSED, counts=False)
        if not pilot.search:
            pilot.fail(DockingError.NOT_DETECTED, "the marker is not in sight")
        if cloud.mass < settings.give_up_mass:
            pilot.fail(DockingError.NOT_DETECTED, "the marker is not where the dock may be")
        if knowledge.copies_seen() and not pilot.use_cue():
            probe = probe_size(pilot, searching=True)
            if probe is not None:
                return probe
        outlook = pilot.outlook() or pilot.far_outlook()
        if outlook is None:
            pilot.fail(DockingError.NOT_DETECTED, "no safe place to look for the marker from")
        return Travel(FollowWay(outlook.way, settings), outlook.heading)


class Travel(Phase):
    """Drives to a place, turns to a heading and looks."""

    detail = "going to where the marker may be seen"

    def __init__(self, way: FollowWay, heading: float):
        self._way, self._heading = way, heading
        self._checked = -math.inf

    def plan(self) -> Tuple[Point, ...]:  # noqa: D102 - inherited
        return self._way.left

    def wants_images(self, pilot: Pilot) -> bool:  # noqa: D102 - inherited
        cloud, view = pilot.knowledge.cloud, pilot.far_view or pilot.knowledge.view
        camera = np.array([pilot.ahead, 0.0, 0.0])
        return float(cloud.weights @ view.seen(se2.between(cloud.poses, camera))) > 0.05

    def step(self, pilot: Pilot) -> Tuple[Command, Optional[Phase]]:  # noqa: D102 - inherited
        if pilot.knowledge.best() is not None:
            return STANDSTILL, Measure()
        if pilot.now - self._checked >= _CHECK_SECONDS:
            self._checked = pilot.now
            if not pilot.still_safe(self._way.left):
                return STANDSTILL, Look()
        command = self._way.command(pilot.knowledge.pose)
        if command != STANDSTILL:
            return command, None
        left = wrap(self._heading - pilot.knowledge.pose[2])
        command = turn_command(left, pilot.settings.turn_speed)
        return command, Look() if command == STANDSTILL else None


class Probe(Phase):
    """Drives a little way back or ahead, to see how the size of what is seen changes.

    Args:
        way: m, ahead; negative: back.
        searching: it ends as soon as the marker is found.
    """

    detail = "finding out how large it is what shows the marker"

    def __init__(self, way: float, searching: bool = True):
        self._way = way
        self._searching = searching
        self._start: Optional[np.ndarray] = None

    def step(self, pilot: Pilot) -> Tuple[Command, Optional[Phase]]:  # noqa: D102 - inherited
        pose = np.asarray(pilot.knowledge.pose)
        if self._start is None:
            self._start = pose
        moved = se2.between(self._start, pose)
        left = abs(self._way) - abs(float(moved[0]))
        if left <= 0.0 or (self._searching and pilot.knowledge.best() is not None):
            return STANDSTILL, Look()
        speed = math.copysign(min(0.2, 0.05 + left), self._way)
        return (speed, clip(-2.0 * float(moved[2]), 0.3)), None


class Measure(Phase):
    """Turns to the marker, measures at rest and decides what to do."""

    state = DockingState.MEASURING
    detail = "measuring"

    def __init__(self):
        self._candidate: Optional[Candidate] = None
        self._frames = 0
        self._turned = False
        self._waited = 0.0

    def wants_images(self, pilot: Pilot) -> bool:  # noqa: D102 - inherited
        return pilot.resting() >= pilot.settings.settle_time

    def step(self, pilot: Pilot) -> Tuple[Command, Optional[Phase]]:  # noqa: D102 - inherited
        candidate, estimate = pilot.knowledge.best(), pilot.estimate()
        if candidate is None or estimate is None:
            return STANDSTILL, Look()
        off = pilot.bearing(estimate)
        if not self._turned and abs(off) > _FACING:
            return turn_command(off, pilot.settings.turn_speed, 0.0), None
        self._turned = True
        if candidate is not self._candidate or pilot.resting() < pilot.settings.settle_time:
            self._candidate, self._frames = candidate, candidate.frames
            self._waited = pilot.now
            return STANDSTILL, None
        if candidate.frames - self._frames >= pilot.settings.measure_frames:
            return STANDSTILL, pilot.decide(pilot)
        if pilot.now - self._waited > 2.0 * pilot.settings.unseen_timeout and self._missing(pilot):
            if not pilot.in_reach(pilot.robot(estimate)):
                return STANDSTILL, pilot.decide(pilot)
            pilot.knowledge.forget(candidate)
            return STANDSTILL, Look()
        return STANDSTILL, None

    def _missing(self, pilot: Pilot) -> bool:
        """Say whether images came, but none with the marker."""
        seen = pilot.knowledge.last_seen(self._candidate)
        return pilot.knowledge.last_image - max(seen, self._waited) > pilot.settings.unseen_timeout


class Stage(Phase):
    """Drives to the point before the dock."""

    state = DockingState.STAGING
    detail = "going to the point before the dock"

    def __init__(self, way: FollowWay, heading: float):
        self._way, self._heading = way, heading
        self._checked = -math.inf

    def plan(self) -> Tuple[Point, ...]:  # noqa: D102 - inherited
        return self._way.left

    def wants_images(self, pilot: Pilot) -> bool:  # noqa: D102 - inherited
        estimate = pilot.estimate()
        return estimate is not None and pilot.marker_in_view(estimate)

    def step(self, pilot: Pilot) -> Tuple[Command, Optional[Phase]]:  # noqa: D102 - inherited
        estimate = pilot.estimate()
        if estimate is None:
            return STANDSTILL, Look()
        if pilot.now - self._checked >= _CHECK_SECONDS:
            self._checked = pilot.now
            if not pilot.still_safe(self._way.left):
                return STANDSTILL, Measure()
        command = self._way.command(pilot.knowledge.pose)
        if command != STANDSTILL:
            return command, None
        return STANDSTILL, Measure()


def probe_size(pilot: Pilot, searching: bool) -> Optional[Phase]:
    """Return a little drive that tells the sizes of what is seen; None if there were enough."""
    if pilot.probes >= _MOST_PROBES:
        return None
    way = pilot.probing_way()
    if not way:
        return None
    pilot.probes += 1
    return Probe(way, searching)
