"""Tests of the table of states: where it leads, and that dockings keep to it."""

import math
from dataclasses import replace
from types import SimpleNamespace

import docking_standin as standin
import numpy as np
import pytest

from bullet_lab.docking import states
from bullet_lab.docking.database import DockTolerance
from bullet_lab.docking.progress import DockingFailureError, DockingProgress
from bullet_lab.docking.states import TRANSITIONS, Confirm, Docked, LookForMarker, Outcome, State
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


def test_every_state_is_in_the_table_and_reached():
    subclasses, waiting = set(), [State]
    while waiting:
        below = waiting.pop().__subclasses__()
        subclasses |= {state for state in below if state.step is not states.DriveAlong.step}
        waiting += below
    subclasses -= {states.DriveAlong, states.TrackedState}
    assert set(TRANSITIONS) == subclasses == reached(LookForMarker)


@pytest.mark.parametrize("state", [state for state in TRANSITIONS if state is not Docked])
def test_the_dock_is_reached_from_every_state(state):
    assert Docked in reached(state)


def test_what_follows_gets_what_was_found_out(monkeypatch):
    class Ended(State):
        def step(self, docking):
            return Outcome("found", ("here",))

    class Following(State):
        def __init__(self, place):
            self.place = place

        def step(self, docking):
            return (0.1, 0.0)

    dock = standin.make_dock(standin.Stand((0.0, 0.0, 0.0)))
    task = DockingTask(dock, dock.pose, standin.MOUNT)
    task._state = Ended()
    monkeypatch.setitem(TRANSITIONS, Ended, {"found": Following})
    assert task._ask_states() == (0.1, 0.0)
    assert task._state.place == "here"
    monkeypatch.setitem(TRANSITIONS, Ended, {"found": lambda place: Ended()})
    task._state = Ended()
    assert task._ask_states() == STANDSTILL


def test_dockings_end_by_names_of_the_table(monkeypatch):
    seen = []
    for state in TRANSITIONS:
        for method in {"step", "follow"} & set(vars(state)):
            monkeypatch.setattr(state, method, recorded(getattr(state, method), seen))
    assert standin.run(standin.Stand((1.2, 1.5, 2.0), (0.2, -0.1, 0.1))).task.result.success
    assert {name for state, name in seen if name not in TRANSITIONS[state]} == set()
    assert {state for state, _ in seen} >= {LookForMarker, states.Measure, states.Confirm}


def recorded(step, seen):
    def wrapper(self, *arguments):
        result = step(self, *arguments)
        if isinstance(result, Outcome):
            seen.append((type(self), result.name))
        return result

    return wrapper


TOLERANCE = DockTolerance(0.005, 0.003, math.radians(0.4))
# m, of a docked robot from the marker.
DOCKED = 0.56


def docking_at(robot, **belief):
    """A docking of a robot whose pose in the dock's frame is known; `belief` has what else is."""
    dock = replace(standin.make_dock(standin.Stand((0.0, 0.0, 0.0))), tolerance=TOLERANCE)
    estimate = SimpleNamespace(
        robot=np.array(robot), deviations=np.array([0.0, 0.0, 0.01]), lateral_deviation=0.0
    )
    known = SimpleNamespace(
        dock=dock,
        mount=standin.MOUNT,
        settings=DockingSettings(),
        estimate=lambda: estimate,
        visibility=SimpleNamespace(farthest=5.0),
        **belief,
    )
    return DockingProgress(known)


@pytest.mark.parametrize(
    ("beside", "turned", "retries", "said"),
    [
        (0.0014, 0.19, 0, "within tolerance"),
        (-0.0016, 0.0, 0, "failed"),
        (-0.0016, 0.0, 5, "within tolerance"),
        (0.0031, 0.0, 5, None),
        (0.0, -0.21, 0, STANDSTILL),
        (0.0, -0.21, 5, "within tolerance"),
    ],
)
def test_docked_is_what_is_within_tolerance_with_half_of_it_to_spare(beside, turned, retries, said):
    robot = np.array([-DOCKED, beside, math.radians(turned)])
    docking = docking_at(robot)
    docking.retries, docking.is_yaw_unsure = retries, lambda: False
    if said is None:
        with pytest.raises(DockingFailureError, match="3.1 mm beside the axis"):
            Confirm()._judge(docking, robot)
        return
    step = Confirm()._judge(docking, robot)
    assert (step.name if isinstance(step, Outcome) else step) == said


def test_a_way_in_that_brings_nothing_new_is_not_tried_again():
    forgotten = []
    track = SimpleNamespace(frames=13)
    docking = docking_at((-2.56, 0.0, 0.0), best=lambda: track, forget=forgotten.append)
    assert states._back_out(docking, 0.5).name == "bad start"
    track.frames += 10
    assert states._back_out(docking, 0.5).name == "bad start"
    assert forgotten == []
    assert states._back_out(docking, 0.5).name == "lost"
    assert forgotten == [track]


@pytest.mark.parametrize(
    ("beside", "deviation", "before", "way", "said"),
    [
        (0.0, 0.3, 1, ["a way"], "unclear"),
        (0.0, 0.3, 0, ["a way"], "bad start"),
        (0.0, 0.3, 1, None, "bad start"),
        (0.6, 0.01, 1, ["a way"], "bad start"),
    ],
)
def test_a_yaw_that_a_way_in_did_not_tell_is_looked_at_from_aside(
    monkeypatch, beside, deviation, before, way, said
):
    track = SimpleNamespace(last_seen=0.0, frames=9)
    docking = docking_at((-2.4, beside, 0.0), best=lambda: track)
    docking.belief.estimate().lateral_deviation = deviation
    docking.unclear = before
    monkeypatch.setattr(docking.paths, "way_aside", lambda *_: way)
    outcome = states.Approach().step(docking)
    assert outcome.name == said
    assert docking._stagings == 1


def test_a_little_drive_on_which_the_marker_is_not_seen_is_not_driven_again(monkeypatch):
    track, forgotten = SimpleNamespace(frames=13), []
    docking = docking_at((-3.4, 0.3, -0.1), best=lambda: track, forget=forgotten.append)
    monkeypatch.setattr(docking.axis, "is_in_lane", lambda *_: False)
    monkeypatch.setattr(docking.paths, "way_to_staging", lambda estimate: None)
    monkeypatch.setattr(docking.paths, "choose_probe", lambda: -0.6)
    assert states.decide(docking).name == "size unknown"
    assert forgotten == []
    assert states.decide(docking).name == "lost"
    assert forgotten == [track]


@pytest.mark.parametrize(("unsure", "said"), [(False, "within tolerance"), (True, "failed")])
def test_it_drives_in_once_more_where_the_camera_may_be_turned(unsure, said):
    robot = np.array([-DOCKED, 0.0, 0.0])
    docking = docking_at(robot)
    docking.is_yaw_unsure = lambda: unsure
    assert Confirm()._judge(docking, robot).name == said
    assert docking.retries == unsure


def at_the_dock(unseen, left=0.0):
    """A docking of a robot in the dock that waits for images, its yaw not well known."""
    track = SimpleNamespace(frames=0, last_seen=0.0, found_from=3.0)
    docking = docking_at((-DOCKED - left, 0.0, 0.0), best=lambda: track)
    docking.unseen = lambda track: unseen
    docking.is_settled = lambda: True
    docking.is_yaw_unsure = docking.may_drive_blind = lambda *_: False
    return docking


@pytest.mark.parametrize(
    ("unseen", "frames", "said"),
    [(0.2, 7, "within tolerance"), (5.0, 0, "failed"), (0.2, 2, None)],
)
def test_it_waits_for_images_as_long_as_some_come(unseen, frames, said):
    docking, state = at_the_dock(unseen), Confirm()
    state.step(docking)
    # Where all images come, fifteen are waited for.
    docking.now, docking.belief.best().frames = 8.0, frames
    step = state.step(docking)
    assert step == STANDSTILL if said is None else step.name == said
    assert docking.lost_at_the_end == (said == "failed")


@pytest.mark.parametrize(
    ("left", "certain", "said"),
    [(0.02, True, None), (0.02, False, "failed"), (0.5, True, "lost")],
)
def test_a_marker_that_is_lost_near_the_dock_is_not_searched_anew(left, certain, said):
    """Something has come before it; what is known of the dock is known all the same."""
    docking, state = at_the_dock(5.0, left), states.Approach()
    docking.may_drive_blind = lambda track: certain and docking.lost_at_the_end
    docking.reject_track = lambda track: False
    assert state.step(docking) == STANDSTILL
    docking.now = 2.0
    step = state.step(docking)
    assert step[0] > 0.0 if said is None else step.name == said
    assert docking.lost_at_the_end == (said != "lost")


def test_a_retreat_begins_where_the_marker_is_not_found():
    docking, state = at_the_dock(5.0), states.Retreat(0.6)
    assert state.step(docking)[0] < -0.05
    docking.now = 4.0
    assert state.step(docking).name == "lost"
