"""What is done about a marker that was measured at rest: in, back out, or to another start."""

from __future__ import annotations

from bullet_lab.docking.approach import Approach, back_out
from bullet_lab.docking.drive import FollowWay
from bullet_lab.docking.phases import Phase, Stage, probe_size
from bullet_lab.docking.pilot import Pilot
from bullet_lab.docking.types import DockingError


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
