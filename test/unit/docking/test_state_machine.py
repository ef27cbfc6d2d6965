"""Tests of the table of states: where it leads, and that dockings keep to it."""

import math
from types import SimpleNamespace

import docking_standin as standin
import numpy as np
import pytest

from bullet_lab.docking import state_machine
from bullet_lab.docking.belief import DockBelief
from bullet_lab.docking.database import DockTolerance
from bullet_lab.docking.planner import DockingFailureError, DockingPlanner
from bullet_lab.docking.state_machine import (
    TRANSITIONS,
    Confirm,
    Docked,
    Outcome,
    Search,
    State,
    StateMachine,
)
from bullet_lab.docking.types import STANDSTILL, DockingSettings, RobotShape


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
        subclasses |= {state for state in below if state.step is not state_machine.Drive.step}
        waiting += below
    subclasses.discard(state_machine.Drive)
    assert set(TRANSITIONS) == subclasses == reached(Search)


@pytest.mark.parametrize("state", [state for state in TRANSITIONS if state is not Docked])
def test_the_dock_is_reached_from_every_state(state):
    assert Docked in reached(state)


def test_what_follows_gets_what_was_found_out():
    class Ended(State):
        def step(self, planner):
            return Outcome("found", ("here",))

    class Following(State):
        def __init__(self, place):
            self.place = place

        def step(self, planner):
            return (0.1, 0.0)

    machine = StateMachine(None)
    machine.state = Ended()
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(TRANSITIONS, Ended, {"found": Following})
        assert machine.step() == (0.1, 0.0)
        assert machine.state.place == "here"
        patch.setitem(TRANSITIONS, Ended, {"found": lambda place: Ended()})
        machine.state = Ended()
        assert machine.step() == STANDSTILL


def test_dockings_end_by_names_of_the_table(monkeypatch):
    seen = []
    for state in TRANSITIONS:
        if "step" in vars(state):
            monkeypatch.setattr(state, "step", recorded(state.step, seen))
    for seed in (100, 103):
        assert standin.run(standin.random_stand(seed)).result.success
    assert {name for state, name in seen if name not in TRANSITIONS[state]} == set()
    assert {state for state, _ in seen} >= {Search, state_machine.Measure, state_machine.Confirm}


def recorded(step, seen):
    def wrapper(self, planner):
        result = step(self, planner)
        if isinstance(result, Outcome):
            seen.append((type(self), result.name))
        return result

    return wrapper


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
    tolerance = DockTolerance(0.005, 0.003, math.radians(0.4))
    planner = SimpleNamespace(
        dock=SimpleNamespace(tolerance=tolerance),
        retries=retries,
        max_retries=5,
        left=lambda robot: -float(robot[0]) - 0.56,
        unsure_of_yaw=lambda: False,
    )
    robot = np.array([-0.56, beside, math.radians(turned)])
    if said is None:
        with pytest.raises(DockingFailureError, match="3.1 mm beside the axis"):
            Confirm()._judge(planner, robot)
        return
    step = Confirm()._judge(planner, robot)
    assert (step.name if isinstance(step, Outcome) else step) == said


def test_a_way_in_that_brings_nothing_new_is_not_tried_again():
    forgotten = []
    track = SimpleNamespace(frames=13)
    planner = DockingPlanner.__new__(DockingPlanner)
    planner.belief = SimpleNamespace(best=lambda: track, forget=forgotten.append, visibility=None)
    planner.settings = DockingSettings()
    planner.stagings, planner._noted = 0, (None, 0)
    assert state_machine._back_out(planner, 2.0, 0.5).name == "bad start"
    track.frames += 10
    assert state_machine._back_out(planner, 2.0, 0.5).name == "bad start"
    assert forgotten == []
    assert state_machine._back_out(planner, 2.0, 0.5).name == "lost"
    assert forgotten == [track]


@pytest.mark.parametrize(
    ("beside", "deviation", "before", "way", "said"),
    [
        (0.0, 0.3, 1, [(0.0, 0.0), (1.0, 0.0)], "unclear"),
        (0.0, 0.3, 0, [(0.0, 0.0), (1.0, 0.0)], "bad start"),
        (0.0, 0.3, 1, None, "bad start"),
        (0.6, 0.01, 1, [(0.0, 0.0), (1.0, 0.0)], "bad start"),
    ],
)
def test_a_yaw_that_a_way_in_did_not_tell_is_looked_at_from_aside(
    monkeypatch, beside, deviation, before, way, said
):
    stand = standin.Stand((0.0, 0.0, 0.0))
    dock, rng = standin.make_dock(stand), np.random.default_rng(1)
    belief = DockBelief(dock, dock.pose, standin.MOUNT, stand.settings, rng)
    planner = DockingPlanner(dock, belief, standin.MOUNT, RobotShape(), stand.settings, True, 5)
    robot = np.array([-dock.walls.depth - 0.4, beside, 0.0])
    estimate = SimpleNamespace(robot=robot, lateral_deviation=deviation)
    track = SimpleNamespace(last_seen=0.0, frames=9)
    planner.unclear = before
    for name, result in {"estimate": estimate, "way_aside": way, "blind": False}.items():
        monkeypatch.setattr(planner, name, lambda *_, result=result: result)
    monkeypatch.setattr(belief, "best", lambda: track)
    outcome = state_machine.Approach().step(planner)
    assert outcome.name == said
    assert planner.stagings == 1


def test_a_little_drive_on_which_the_marker_is_not_seen_is_not_driven_again():
    robot, track, forgotten = np.array([-3.4, 0.3, -0.1]), SimpleNamespace(frames=3), []
    planner = SimpleNamespace(
        belief=SimpleNamespace(best=lambda: track, forget=forgotten.append),
        estimate=lambda: SimpleNamespace(robot=robot, lateral_deviation=0.6),
        lane=SimpleNamespace(within_walls=lambda robot: False, holds=lambda *_: False),
        left=lambda robot: 2.9,
        stagings=0,
        settings=DockingSettings(),
        way_to_staging=lambda estimate: None,
        probing_way=lambda: -0.6,
        note_progress=lambda: True,
    )
    assert state_machine.decide(planner).name == "size unknown"
    assert forgotten == []
    planner.note_progress = lambda: False
    assert state_machine.decide(planner).name == "lost"
    assert forgotten == [track]


@pytest.mark.parametrize(("unsure", "said"), [(False, "within tolerance"), (True, "failed")])
def test_it_drives_in_once_more_where_the_camera_may_be_turned(unsure, said):
    planner = SimpleNamespace(
        dock=SimpleNamespace(tolerance=DockTolerance(0.005, 0.003, math.radians(0.4))),
        retries=0,
        max_retries=5,
        left=lambda robot: 0.0,
        unsure_of_yaw=lambda: unsure,
    )
    robot = np.array([-0.56, 0.0, 0.0])
    assert Confirm()._judge(planner, robot).name == said
    assert planner.retries == unsure


def at_the_dock(unseen, frames, blind=False):
    """A planner of a robot in the dock that waits for images, its yaw not well known."""
    track = SimpleNamespace(frames=frames)
    estimate = SimpleNamespace(robot=np.zeros(3), deviations=np.array([0.0, 0.0, 0.01]))
    return SimpleNamespace(
        belief=SimpleNamespace(best=lambda: track),
        estimate=lambda: estimate,
        settings=DockingSettings(),
        dock=SimpleNamespace(tolerance=DockTolerance(0.005, 0.003, math.radians(0.4))),
        left=lambda robot: 0.0,
        unseen=lambda track: unseen,
        blind=lambda track, left: blind,
        settled=lambda: True,
        unsure_of_yaw=lambda: False,
        in_sight=lambda left: left,
        tracker=SimpleNamespace(backwards=lambda robot, left: (-0.1, 0.0)),
        now=0.0,
        retries=0,
        max_retries=5,
        lost_at_the_end=False,
    )


@pytest.mark.parametrize(
    ("unseen", "frames", "said"),
    [(0.2, 7, "within tolerance"), (5.0, 0, "failed"), (0.2, 2, None)],
)
def test_it_waits_for_images_as_long_as_some_come(unseen, frames, said):
    planner, state = at_the_dock(unseen, 0), Confirm()
    state.step(planner)
    # Where all images come, fifteen are waited for.
    planner.now, planner.belief.best().frames = 8.0, frames
    step = state.step(planner)
    assert step == STANDSTILL if said is None else step.name == said
    assert planner.lost_at_the_end == (said == "failed")


@pytest.mark.parametrize(
    ("left", "certain", "said"),
    [(0.02, True, None), (0.02, False, "failed"), (0.5, True, "lost")],
)
def test_a_marker_that_is_lost_near_the_dock_is_not_searched_anew(left, certain, said):
    """Something has come before it; what is known of the dock is known all the same."""
    planner, state = at_the_dock(5.0, 0), state_machine.Approach()
    planner.left = lambda robot: left
    planner.in_reach = lambda robot: True
    planner.near = lambda left: left < 0.1
    planner.blind = lambda track, left: certain and planner.lost_at_the_end
    planner.lane = SimpleNamespace(
        within_walls=lambda robot: False, leads_at_an_edge=lambda robot, deviation: False
    )
    planner.estimate().lateral_deviation = 0.0
    planner.tracker.forwards = lambda robot, left: (0.05, 0.0)
    assert state.step(planner) == STANDSTILL
    planner.now = 2.0
    step = state.step(planner)
    assert step == (0.05, 0.0) if said is None else step.name == said
    assert planner.lost_at_the_end == (said != "lost")


def test_a_retreat_begins_where_the_marker_is_not_found():
    planner, state = at_the_dock(5.0, 0), state_machine.Retreat(0.6)
    assert state.step(planner) == (-0.1, 0.0)
    planner.now = 4.0
    assert state.step(planner).name == "lost"
