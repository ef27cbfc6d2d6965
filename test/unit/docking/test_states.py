"""Tests of the table of states: where it leads, and what each state decides."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import docking_standin as standin
import numpy as np
import yaml
from alike import assert_as_before, lines_of
from shared import cases

from bullet_lab.core import se2
from bullet_lab.docking import states
from bullet_lab.docking.database import DockTolerance
from bullet_lab.docking.progress import DockingFailureError, DockingProgress
from bullet_lab.docking.states import TRANSITIONS, Docked, LookForMarker, Outcome
from bullet_lab.docking.task import DockingTask
from bullet_lab.docking.types import DockingSettings
from bullet_lab.drive import STANDSTILL


def reached(start):
    """All states that may follow one, itself included."""
    found, waiting = {start}, [start]
    while waiting:
        new = set(TRANSITIONS[waiting.pop()].values()) - found
        found |= new
        waiting += new
    return found


def test_every_state_is_in_the_table_is_reached_and_leads_to_the_dock():
    bases = {states.DriveAlong, states.TrackedState, states.State}
    every = {one for one in vars(states).values() if isinstance(one, type)}
    assert set(TRANSITIONS) == {s for s in every if issubclass(s, states.State)} - bases
    assert set(TRANSITIONS) == reached(LookForMarker)
    assert all(Docked in reached(state) for state in TRANSITIONS)


def test_states_that_follow_each_other_without_end_stand_still(monkeypatch):
    dock = standin.make_dock(standin.Stand((0.0, 0.0, 0.0)))
    task = DockingTask(dock, dock.pose, standin.MOUNT)
    monkeypatch.setattr(LookForMarker, "step", lambda *_: Outcome("found"))
    monkeypatch.setitem(TRANSITIONS, LookForMarker, {"found": LookForMarker})
    assert task._ask_states() == STANDSTILL
    # Nothing is known of the place yet, nor planned.
    assert (task.dock_pose, task.plan) == (None, ())
    assert all(map(math.isnan, task.place))
    task._state = states.DriveAlong([(0.0, 0.0), (1.0, 2.0)])
    assert task.plan == ((1.0, 2.0),)


TOLERANCE = DockTolerance(0.005, 0.003, math.radians(0.4))


def estimate_of(robot, deviations=(0.0, 0.0, 0.01), lateral=0.0):
    x, y, degrees = robot
    robot = np.array([x, y, math.radians(degrees)])
    return SimpleNamespace(
        robot=robot,
        mean=se2.inverse(robot),
        deviations=np.array(deviations),
        lateral_deviation=lateral,
    )


def docking_at(best=True, answers=(), **changes):
    """A docking that knows of its dock what `tell` tells it, and of the rest gives answers."""
    dock = replace(standin.make_dock(standin.Stand((0.0, 0.0, 0.0))), tolerance=TOLERANCE)
    track = SimpleNamespace(frames=13, last_seen=0.0, found_from=3.0, real=1.0)
    track.learned = lambda: SimpleNamespace(yaw=track.yaw)
    track.yaw = SimpleNamespace(deviation=0.0)
    known = SimpleNamespace(
        dock=dock,
        mount=standin.MOUNT,
        settings=DockingSettings(),
        visibility=SimpleNamespace(farthest=5.0),
        particles=SimpleNamespace(mass=1.0),
        pose=(0.0, 0.0, 0.0),
        images=0,
        last_image=0.0,
        track=track,
        forgotten=0,
        estimate=lambda: known.estimated if best else None,
        best=lambda: track if best else None,
        forget=lambda track: vars(known).update(forgotten=known.forgotten + 1),
    )
    docking = DockingProgress(known)
    usual = {"belief.cut_off": False, "belief.copies_seen": False, "belief.pending": False}
    usual.update({"paths.is_safe": True, "paths.way_to_staging": "a way"}, **dict(answers))
    for place, value in usual.items():
        *owner, name = place.split(".")
        there = getattr(docking, owner[0]) if owner else docking
        setattr(there, name, lambda *_, value=value: value)
    for name, value in changes.items():
        setattr(docking, name, value)
    return docking


def said_in(docking, act):
    """What is done, and what is counted."""
    try:
        step = act(docking)
    except DockingFailureError as failure:
        return [failure.error.name, str(failure)]
    command = STANDSTILL if isinstance(step, Outcome) else step
    docking.note_command(command)
    counts = docking.retries, docking.unclear, docking._stagings, docking._rejections
    named = [step.name, *map(str, step.arguments)] if isinstance(step, Outcome) else step
    return [*named, "|", *counts, docking.belief.forgotten, docking.lost_at_the_end]


def told(do, robot, ticks, deviations=(0.0, 0.0, 0.01), lateral=0.0, yaw=0.0, mass=1.0, **more):
    """Yield what a state, or a function of the module, says tick by tick.

    A tick is s since the one before, more images, and how many of them showed the marker; and where
    the robot is against the dock and by odometry, if it is elsewhere (m, m, degrees).
    """
    kind, docking = getattr(states, do[0]), docking_at(**more)
    is_state = isinstance(kind, type)
    state = kind(*do[1:]) if is_state else None
    belief, track = docking.belief, docking.belief.track
    track.yaw.deviation, belief.particles.mass = yaw, mass
    docking.note_command(STANDSTILL)
    for seconds, images, frames, *places in ticks:
        docking.now += seconds
        belief.images += images
        belief.last_image = docking.now if images else belief.last_image
        track.frames += frames
        track.last_seen = docking.now if frames else track.last_seen
        if places:
            robot, belief.pose = places
        belief.estimated = estimate_of(robot, deviations, lateral)
        act = state.step if is_state else lambda docking: kind(docking, *do[1:])
        yield said_in(docking, act)


# The places are against the dock, where a docked robot is at x = -0.56.
CASES = """
within half of the tolerances:
  {do: [Confirm], robot: [-0.56, 0.0014, 0.19], ticks: &measured [[0.4, 0, 0], [0.1, 15, 15]]}
its yaw is not known: {do: [Confirm], robot: [-0.56, 0.0014, 0.19], ticks: *measured, yaw: 0.0028}
known just well enough: {do: [Confirm], robot: [-0.56, 0.0, 0.0], ticks: *measured, yaw: 0.00279}
twice was enough:
  {do: [Confirm], robot: [-0.56, 0.0, 0.0], ticks: *measured, yaw: 0.1, retries: 2}
beside, with half of it to spare: {do: [Confirm], robot: [-0.56, -0.0016, 0.0], ticks: *measured}
beside, the last time:
  {do: [Confirm], robot: [-0.56, -0.0016, 0.0], ticks: *measured, retries: 5}
too far beside, the last time:
  {do: [Confirm], robot: [-0.56, 0.0031, 0.0], ticks: *measured, retries: 5}
turned, the last time: {do: [Confirm], robot: [-0.56, 0.0, -0.21], ticks: *measured, retries: 5}
a correction takes six seconds at most:
  do: [Confirm]
  robot: [-0.56, 0.0, -0.21]
  ticks: [[0.4, 0, 0], [0.1, 15, 15], [5.8, 15, 15], [0.3, 15, 15], [0.4, 0, 0], [0.1, 15, 15]]
a correction ends where it is straight:
  do: [Confirm]
  robot: [-0.56, 0.0, 0.21]
  ticks:
  - [0.4, 0, 0]
  - [0.1, 15, 15]
  - [0.1, 0, 0, [-0.56, 0.0, 0.01], [0.0, 0.0, 0.0]]
  - [0.1, 0, 0, [-0.56, 0.0, 0.005], [0.0, 0.0, 0.0]]
creeps back:
  do: [Confirm]
  robot: [-0.5549, 0.0, 0.0]
  ticks: [[0.4, 0, 0], [0.1, 15, 15], [0.1, 0, 0], [0.1, 0, 0, [-0.5601, 0, 0], [0, 0, 0]]]
creeps ahead:
  do: [Confirm]
  robot: [-0.5651, 0.0, 0.0]
  ticks: [[0.4, 0, 0], [0.1, 15, 15], [0.1, 0, 0], [0.1, 0, 0, [-0.5599, 0, 0], [0, 0, 0]]]
eight corrections have to do:
  do: [Confirm]
  robot: [-0.56, 0.0, 0.3]
  ticks: [
    [0.4, 0, 0], [0.1, 15, 15], [6.1, 0, 0], [0.4, 0, 0], [0.1, 15, 15], [6.1, 0, 0], [0.4, 0, 0],
    [0.1, 15, 15], [6.1, 0, 0], [0.4, 0, 0], [0.1, 15, 15], [6.1, 0, 0], [0.4, 0, 0], [0.1, 15, 15],
    [6.1, 0, 0], [0.4, 0, 0], [0.1, 15, 15], [6.1, 0, 0], [0.4, 0, 0], [0.1, 15, 15], [6.1, 0, 0],
    [0.4, 0, 0], [0.1, 15, 15], [6.1, 0, 0], [0.4, 0, 0], [0.1, 15, 15]]
waits for fifteen images where the yaw is unsure, and later for five:
  do: [Confirm]
  robot: [-0.56, 0.0, 0.0]
  ticks: [[0.4, 0, 0], [0.1, 14, 14], [5.8, 0, 0], [0.2, 0, 0]]
five are enough where it is sure:
  do: [Confirm]
  robot: [-0.56, 0.0, 0.0]
  deviations: [0.0, 0.0, 0.00209]
  ticks: [[0.4, 0, 0], [0.1, 4, 4], [0.1, 1, 1]]
waits for images as long as some come:
  do: [Confirm]
  robot: [-0.56, 0.0, 0.0]
  ticks: [[0.4, 0, 0], [8.0, 2, 2], [3.9, 1, 1], [0.2, 1, 1]]
no more come:
  {do: [Confirm], robot: [-0.56, 0.0, 0.0], ticks: [[0.4, 0, 0], [5.9, 0, 0], [0.3, 0, 0]]}
the image cuts it off:
  do: [Confirm]
  robot: [-0.56, 0.0, 0.0]
  deviations: [0.004, 0.0, 0.01]
  answers: {belief.cut_off: true}
  ticks: [[0.4, 0, 0], [1.1, 0, 0], [0.2, 0, 0]]
no track: {do: [Confirm], robot: [-0.56, 0.0, 0.0], ticks: [[0.4, 0, 0]], best: false}
a way in that brings nothing new is not tried again:
  {do: [_back_out, 0.5], robot: [-2.56, 0.0, 0.0], ticks: [[0, 0, 0], [0, 4, 4], [0, 3, 3]]}
out of sight: {do: [_back_out, 0.5], robot: [-4.47, 0.0, 0.0], ticks: [[0, 0, 0]]}
just in sight: {do: [_back_out, 0.5], robot: [-4.45, 0.0, 0.0], ticks: [[0, 0, 0]]}
eleven stagings are too many:
  do: [_back_out, 0.5]
  robot: [-2.56, 0.0, 0.0]
  ticks: [
    [0, 4, 4], [0, 4, 4], [0, 4, 4], [0, 4, 4], [0, 4, 4], [0, 4, 4], [0, 4, 4], [0, 4, 4],
    [0, 4, 4], [0, 4, 4], [0, 4, 4]]
a little drive on which the marker is not seen is not driven again:
  do: [decide]
  robot: [-3.4, 0.3, -6.0]
  answers: {axis.is_in_lane: false, paths.way_to_staging: null, paths.choose_probe: -0.6}
  ticks: [[0, 0, 0], [0, 0, 0]]
nowhere to drive:
  do: [decide]
  robot: [-3.4, 0.3, -6.0]
  answers: {axis.is_in_lane: false, paths.way_to_staging: null, paths.choose_probe: 0.0}
  ticks: [[0, 0, 0]]
off the lane:
  do: [decide]
  robot: [-3.4, 0.6, -6.0]
  answers: {paths.way_to_staging: a way}
  ticks: [[0, 0, 0]]
in the lane: {do: [decide], robot: [-3.0, 0.01, 0.0], ticks: [[0, 0, 0]]}
within the walls, doubtful:
  {do: [decide], robot: [-2.0, 0.0, 0.0], ticks: [[0, 0, 0]], answers: {reject_track: true}}
within the walls, off the lane: {do: [decide], robot: [-1.0, 0.1, 0.0], ticks: [[0, 0, 0]]}
a yaw that a way in did not tell is looked at from aside:
  do: [Approach]
  robot: [-2.4, 0.0, 0.0]
  lateral: 0.3
  answers: &aside {paths.way_aside: a way}
  ticks: [[0, 0, 0], [0, 4, 4], [0, 4, 4]]
there is no way aside:
  do: [Approach]
  robot: [-2.4, 0.0, 0.0]
  lateral: 0.3
  answers: {paths.way_aside: null}
  ticks: [[0, 0, 0], [0, 4, 4]]
at an edge for sure:
  do: [Approach]
  robot: [-2.4, 0.6, 0.0]
  lateral: 0.01
  answers: *aside
  ticks: [[0, 0, 0], [0, 4, 4]]
an approach is given up beside the axis:
  {do: [Approach], robot: [-0.95, -0.026, 0.0], ticks: [[0, 0, 0]]}
farther away it goes on: {do: [Approach], robot: [-0.97, 0.026, 0.0], ticks: [[0, 0, 0]]}
nearer it goes on: {do: [Approach], robot: [-0.95, 0.024, 0.0], ticks: [[0, 0, 0]]}
turned: {do: [Approach], robot: [-0.79, 0.0, -6.1], ticks: [[0, 0, 0]]}
turned, farther away: {do: [Approach], robot: [-0.81, 0.0, 6.1], ticks: [[0, 0, 0]]}
too near the walls: {do: [Approach], robot: [-2.3, 0.19, 0.0], ticks: [[0, 0, 0]]}
arrives: {do: [Approach], robot: [-0.5605, 0.0, 0.0], ticks: [[0, 0, 0]]}
nearly arrives: {do: [Approach], robot: [-0.561, 0.0, 0.0], ticks: [[0, 0, 0]]}
enters in doubt:
  {do: [Approach], robot: [-2.3, 0.0, 0.0], ticks: [[0, 0, 0]], answers: {reject_track: true}}
# Something has come before it; what is known of the dock is known all the same.
lost near the dock, where the place is known:
  do: [Approach]
  robot: [-0.58, 0.0, 0.0]
  deviations: [0.0049, 0.0, 0.01]
  lateral: 0.0029
  ticks: &lost [[1.1, 0, 0], [0.2, 0, 0], [1.1, 0, 0], [0.2, 0, 0]]
how far it is is not known:
  {do: [Approach], robot: [-0.58, 0.0, 0.0], deviations: [0.0051, 0.0, 0.01], ticks: *lost}
how far beside it is is not known:
  {do: [Approach], robot: [-0.58, 0.0, 0.0], lateral: 0.0031, ticks: *lost}
lost farther away: {do: [Approach], robot: [-0.69, 0.0, 0.0], ticks: *lost}
lost near enough: {do: [Approach], robot: [-0.67, 0.0, 0.0], ticks: *lost}
cut off near the dock:
  do: [Approach]
  robot: [-0.67, 0.0, 0.0]
  answers: {belief.cut_off: true}
  ticks: *lost
seen again:
  do: [Approach]
  robot: [-1.06, 0.0, 0.0]
  ticks: [[1.3, 0, 0], [0.1, 1, 1], [1.3, 0, 0], [1.1, 0, 0]]
a retreat begins where the marker is not found:
  do: [Retreat, 0.6]
  robot: [-0.56, 0.0, 0.0]
  ticks: [[5.0, 0, 0], [2.3, 0, 0], [0.2, 0, 0]]
a retreat out of sight:
  {do: [Retreat, 0.6, false], robot: [-0.56, 0.0, 0.0], ticks: [[5.0, 0, 0], [2.5, 0, 0]]}
a retreat ends:
  do: [BackOut, 0.6]
  robot: [-1.15, 0.01, 1.0]
  ticks: [[0.1, 1, 1], [0.1, 1, 1, [-1.17, 0.01, 1.0], [0.0, 0.0, 0.0]]]
turns to the marker and measures:
  do: [Measure]
  robot: [-2.5, 0.0, 11.3]
  ticks: [
    [0.1, 1, 1], [0.1, 1, 1, [-2.5, 0.0, 11.2], [0, 0, 0]], [0.4, 1, 1], [0.1, 3, 3], [0.1, 1, 1]]
measures, but the marker is missing: {do: [Measure], robot: [-2.5, 0.0, 0.0], ticks: &missing
  [[0.4, 0, 0], [1.1, 1, 0], [1.2, 1, 0], [0.2, 1, 0]]}
measures out of reach: {do: [Measure], robot: [-5.2, 0.0, 0.0], ticks: *missing}
measures, but no images come:
  {do: [Measure], robot: [-2.5, 0.0, 0.0], ticks: [[0.4, 0, 0], [2.3, 0, 0], [0.3, 0, 0]]}
looks and sees: {do: [LookForMarker], robot: [0, 0, 0], ticks: [[0.4, 0, 0]]}
looks and sees nothing:
  do: [LookForMarker]
  robot: [0.0, 0.0, 0.0]
  best: false
  answers: &nothing {search.add_failed_look: null, search.next_view: [a way, 1.0]}
  ticks: &look [[0.2, 5, 0], [0.2, 2, 0], [0.1, 1, 0]]
looks longer where something may be a track:
  do: [LookForMarker]
  robot: [0.0, 0.0, 0.0]
  best: false
  answers: {belief.pending: true, search.add_failed_look: null, search.next_view: [a way, 1.0]}
  ticks: [[0.4, 5, 0], [0.1, 8, 0], [0.1, 1, 0]]
looks nowhere else:
  do: [LookForMarker]
  robot: [0.0, 0.0, 0.0]
  best: false
  answers: {search.add_failed_look: null, search.next_view: null}
  ticks: *look
it is nowhere:
  do: [LookForMarker]
  robot: [0.0, 0.0, 0.0]
  best: false
  answers: *nothing
  mass: 0.0039
  ticks: *look
hardly anywhere is left:
  do: [LookForMarker]
  robot: [0.0, 0.0, 0.0]
  best: false
  answers: *nothing
  mass: 0.0041
  ticks: *look
sees a copy:
  do: [LookForMarker]
  robot: [0.0, 0.0, 0.0]
  best: false
  answers: &copy
    search.add_failed_look: null
    search.next_view: [a way, 1.0]
    search.use_cue: false
    belief.copies_seen: true
    paths.choose_probe: -0.6
  ticks: *look
sees a copy on the dock's wall:
  do: [LookForMarker]
  robot: [0.0, 0.0, 0.0]
  best: false
  answers: {<<: *copy, search.use_cue: true}
  ticks: *look
sees a copy, but cannot drive:
  do: [LookForMarker]
  robot: [0.0, 0.0, 0.0]
  best: false
  answers: {<<: *copy, paths.choose_probe: 0.0}
  ticks: *look
probes the size:
  do: &probe [ProbeSize, -0.6, false]
  robot: [0.0, 0.0, 0.0]
  ticks: &probed [
    [0.1, 0, 0], [0.1, 0, 0, [0, 0, 0], [-0.5, 0.0, 0.1]],
    [0.1, 0, 0, [0, 0, 0], [-0.59, 0.0, -0.2]], [0.1, 0, 0, [0, 0, 0], [-0.61, 0.0, 0.0]]]
probes the size until something is seen: {do: [ProbeSize, 0.6], robot: [0, 0, 0], ticks: *probed}
probes the size and sees nothing:
  {do: [ProbeSize, 0.6], robot: [0, 0, 0], ticks: *probed, best: false}
drives to a view:
  do: [DriveToView, [[0, 0], [1.0, 0.0]], 1.0]
  robot: [0.0, 0.0, 0.0]
  best: false
  ticks: [
    [0.1, 0, 0], [0.1, 0, 0, [0, 0, 0], [0.5, 0.02, 0.0]], [0.1, 0, 0, [0, 0, 0], [1.0, 0.0, 0.0]],
    [0.1, 0, 0, [0, 0, 0], [1.0, 0.0, 0.9]], [0.1, 0, 0, [0, 0, 0], [1.0, 0.0, 1.0]]]
sees it on the way:
  {do: [DriveToView, [[0, 0], [1.0, 0.0]], 1.0], robot: [0, 0, 0], ticks: [[0.1, 0, 0]]}
a way is not safe:
  do: [DriveToStaging, [[0, 0], [1.0, 0.0]]]
  robot: [0.0, 0.0, 0.0]
  answers: {paths.is_safe: false}
  ticks: [[0.1, 0, 0]]
drives to the staging point:
  {do: [DriveToStaging, [[0, 0], [1.0, 0.0]]], robot: [0, 0, 0], ticks: [[0.1, 0, 0]]}
loses it on the way:
  {do: [DriveToStaging, [[0, 0], [1.0, 0.0]]], robot: [0, 0, 0], ticks: [[0.1, 0, 0]], best: false}
"""


def test_what_each_state_does_is_as_before():
    found = []
    for name, case in yaml.safe_load(CASES).items():
        for number, said in enumerate(told(**case)):
            found += lines_of(said, f"{name} {number}")
    assert_as_before(found, Path(__file__).with_name("states.txt"))


@cases("""
real, off, before, rejected:
  - [0.91, null, 0, false]
  - [0.89, null, 2, true]
  - [0.21, null, 3, false]
  - [0.19, null, 3, true]
  # A copy is on the same wall.
  - [0.51, [0.19, 0.49, 0.0], 0, false]
  - [0.49, [0.19, 0.49, 0.0], 0, true]
  - [0.51, [-0.21, 0.0, 0.0], 0, true]
  - [0.51, [0.0, -0.51, 0.0], 0, true]
""")
def test_a_doubtful_track_is_rejected(real, off, before, rejected):
    docking = docking_at()
    track = docking.belief.track
    track.real, docking._rejections = real, before
    track.likeliest = lambda: SimpleNamespace(mean=np.zeros(3))
    wall = SimpleNamespace(mean=off and se2.inverse(off))
    docking.belief.copy = off and SimpleNamespace(likeliest=lambda: wall)
    assert docking.reject_track(track) == rejected
    assert docking._rejections == before + rejected
