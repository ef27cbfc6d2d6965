"""Tests of the table of states: where it leads, and what each state decides."""

import math
from dataclasses import replace
from types import SimpleNamespace

import docking_standin as standin
import numpy as np
import pytest
from shared import cases

from bullet_lab.docking import states
from bullet_lab.docking.database import DockTolerance
from bullet_lab.docking.progress import DockingFailureError, DockingProgress
from bullet_lab.docking.states import TRANSITIONS, Confirm, Docked, LookForMarker, Outcome
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
# m, of a docked robot from the marker.
DOCKED = 0.56


def docking_at(robot):
    """A docking of a robot whose pose in the dock's frame is known, and its `track`.

    What it forgets is noted in `forgotten`.
    """
    dock = replace(standin.make_dock(standin.Stand((0.0, 0.0, 0.0))), tolerance=TOLERANCE)
    estimate = SimpleNamespace(
        robot=np.array(robot), deviations=np.array([0.0, 0.0, 0.01]), lateral_deviation=0.0
    )
    track = SimpleNamespace(frames=13, last_seen=0.0, found_from=3.0)
    forgotten = []
    known = SimpleNamespace(
        dock=dock,
        mount=standin.MOUNT,
        settings=DockingSettings(),
        estimate=lambda: estimate,
        visibility=SimpleNamespace(farthest=5.0),
        best=lambda: track,
        forget=forgotten.append,
    )
    docking = DockingProgress(known)
    docking.track, docking.forgotten = track, forgotten
    return docking


def name_of(step):
    """The name of an outcome, or the command of a state that goes on, but for standing."""
    if step == STANDSTILL:
        return "stands"
    return step.name if isinstance(step, Outcome) else step


@cases("""
beside, turned, retries, unsure, said:
  - [0.0014, 0.19, 0, false, within tolerance]
  - [0.0014, 0.19, 0, true, failed]
  - [-0.0016, 0.0, 0, false, failed]
  - [-0.0016, 0.0, 5, false, within tolerance]
  - [0.0031, 0.0, 5, false, null]
  - [0.0, -0.21, 0, false, stands]
  - [0.0, -0.21, 5, false, within tolerance]
""")
def test_docked_is_what_is_within_tolerance_with_half_of_it_to_spare(
    beside, turned, retries, unsure, said
):
    """And where the yaw is known: otherwise it drives in once more."""
    robot = np.array([-DOCKED, beside, math.radians(turned)])
    docking = docking_at(robot)
    docking.retries, docking.is_yaw_unsure = retries, lambda: unsure
    if said is None:
        with pytest.raises(DockingFailureError, match="3.1 mm beside the axis"):
            Confirm()._judge(docking, robot)
        return
    assert name_of(Confirm()._judge(docking, robot)) == said
    assert docking.retries == retries + (said == "failed")


def test_eight_corrections_have_to_do():
    robot = np.array([-DOCKED, 0.0, math.radians(0.3)])
    docking, state = docking_at(robot), Confirm()
    said = [name_of(state._judge(docking, robot)) for _ in range(9)]
    assert said == ["stands"] * 8 + ["failed"]


def test_a_correction_takes_six_seconds_at_most():
    docking, state = docking_at((-DOCKED, 0.0, math.radians(0.3))), Confirm()
    docking.is_settled = lambda: True
    # It begins to measure, has measured, corrects, and measures again.
    for now, said in ((0.0, STANDSTILL), (0.0, STANDSTILL), (5.9, (0.0, -0.05)), (6.1, STANDSTILL)):
        docking.now = now
        docking.track.frames += 15
        assert state.step(docking) == said


def test_a_way_in_that_brings_nothing_new_is_not_tried_again():
    docking = docking_at((-2.56, 0.0, 0.0))
    assert states._back_out(docking, 0.5).name == "bad start"
    docking.track.frames += 10
    assert states._back_out(docking, 0.5).name == "bad start"
    assert docking.forgotten == []
    assert states._back_out(docking, 0.5).name == "lost"
    assert docking.forgotten == [docking.track]


def test_a_little_drive_on_which_the_marker_is_not_seen_is_not_driven_again(monkeypatch):
    docking = docking_at((-3.4, 0.3, -0.1))
    monkeypatch.setattr(docking.axis, "is_in_lane", lambda *_: False)
    monkeypatch.setattr(docking.paths, "way_to_staging", lambda estimate: None)
    monkeypatch.setattr(docking.paths, "choose_probe", lambda: -0.6)
    assert states.decide(docking).name == "size unknown"
    assert docking.forgotten == []
    assert states.decide(docking).name == "lost"
    assert docking.forgotten == [docking.track]


@cases("""
beside, deviation, before, way, said:
  - [0.0, 0.3, 1, [a way], unclear]
  - [0.0, 0.3, 0, [a way], bad start]
  - [0.0, 0.3, 1, null, bad start]
  - [0.6, 0.01, 1, [a way], bad start]
""")
def test_a_yaw_that_a_way_in_did_not_tell_is_looked_at_from_aside(
    monkeypatch, beside, deviation, before, way, said
):
    docking = docking_at((-2.4, beside, 0.0))
    docking.belief.estimate().lateral_deviation = deviation
    docking.unclear = before
    monkeypatch.setattr(docking.paths, "way_aside", lambda *_: way)
    assert states.Approach().step(docking).name == said
    assert docking._stagings == 1


@cases("""
along, beside, degrees, said:
  - [-0.95, 0.024, 0.0, ""]
  - [-0.95, -0.026, 0.0, 26 mm beside the axis]
  - [-0.97, 0.026, 0.0, ""]
  - [-0.79, 0.0, -6.1, 6.1 degrees against the axis]
  - [-0.81, 0.0, 6.1, ""]
  - [-2.3, 0.19, 0.0, too near the walls]
""")
def test_an_approach_is_given_up_where_it_would_not_end_well(along, beside, degrees, said):
    robot = along, beside, math.radians(degrees)
    docking = docking_at(robot)
    docking.reject_track = lambda *_: False
    assert docking.axis.check_gate(robot) == said
    step = states.Approach().step(docking)
    assert (name_of(step) == "failed") == bool(said)
    # Back to 0.6 m before where it was.
    assert not said or step.arguments == pytest.approx((-robot[0] - DOCKED + 0.6,))


def at_the_dock(unseen, left=0.0):
    """A docking of a robot in the dock that waits for images, its yaw not well known."""
    docking = docking_at((-DOCKED - left, 0.0, 0.0))
    docking.unseen = lambda track: unseen
    docking.is_settled = lambda: True
    docking.is_yaw_unsure = docking.may_drive_blind = docking.reject_track = lambda *_: False
    return docking


@cases("""
unseen, frames, said:
  - [0.2, 7, within tolerance]
  - [5.0, 0, failed]
  - [0.2, 2, stands]
""")
def test_it_waits_for_images_as_long_as_some_come(unseen, frames, said):
    docking, state = at_the_dock(unseen), Confirm()
    state.step(docking)
    # Where all images come, fifteen are waited for.
    docking.now = 8.0
    docking.track.frames += frames
    assert name_of(state.step(docking)) == said
    assert docking.lost_at_the_end == (said == "failed")


@cases("left, certain, said: [[0.02, true, null], [0.02, false, failed], [0.5, true, lost]]")
def test_a_marker_that_is_lost_near_the_dock_is_not_searched_anew(left, certain, said):
    """Something has come before it; what is known of the dock is known all the same."""
    docking, state = at_the_dock(5.0, left), states.Approach()
    docking.may_drive_blind = lambda track: certain and docking.lost_at_the_end
    assert state.step(docking) == STANDSTILL
    docking.now = 2.0
    step = state.step(docking)
    assert step[0] > 0.0 if said is None else step.name == said
    assert docking.lost_at_the_end == (said != "lost")


@cases("""
left, along, beside, lost, cut_off, blind:
  - [0.11, 0.004, 0.002, true, false, true]
  - [0.11, 0.004, 0.002, false, true, true]
  - [0.11, 0.004, 0.002, false, false, false]
  - [0.11, 0.006, 0.002, true, true, false]
  - [0.11, 0.004, 0.004, true, true, false]
  - [0.13, 0.004, 0.002, true, true, false]
""")
def test_the_last_part_is_driven_blind_where_the_place_is_known(
    left, along, beside, lost, cut_off, blind
):
    docking = docking_at((-DOCKED - left, 0.0, 0.0))
    estimate = docking.belief.estimate()
    estimate.deviations[0], estimate.lateral_deviation = along, beside
    docking.lost_at_the_end, docking.belief.cut_off = lost, lambda track: cut_off
    assert docking.may_drive_blind(docking.track) == blind


def test_a_retreat_begins_where_the_marker_is_not_found():
    docking, state = at_the_dock(5.0), states.Retreat(0.6)
    assert state.step(docking)[0] < -0.05
    docking.now = 2.3
    assert state.step(docking)[0] < -0.05
    docking.now = 2.5
    assert state.step(docking).name == "lost"
