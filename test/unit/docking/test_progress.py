"""Tests of where a docking lets a robot go and look."""

import math
from pathlib import Path
from types import SimpleNamespace

import docking_standin as standin
import numpy as np
import pytest
from alike import assert_as_before, lines_of

from bullet_lab.docking.belief import DockBelief
from bullet_lab.docking.database import DockMarker
from bullet_lab.docking.filter import GaussianPose
from bullet_lab.docking.geometry import clearance, wall_boxes
from bullet_lab.docking.progress import DockingProgress
from bullet_lab.docking.types import TURNING_RADIUS, Observation, Odometry, Sighting

# Too high for the marker: a copy, small and right before the camera or large and far away. As it
# does not hang where the robot stands, the smallest do not count.
SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
COPY, MARKER = (320.0, 180.0) + 60.0 * SQUARE, (319.5, 233.3) + 10.4 * SQUARE
KNOWN = GaussianPose(np.array([5.0, 0.0, 0.0]), 1e-6 * np.eye(3))


def docking_at_the_origin(marker_size, corners=None, walls=True):
    """A docking that has taken a few images, of a print or of nothing."""
    marker = DockMarker(standin.DICTIONARY, 0, marker_size, 0.5)
    stand = standin.Stand((0.0, 0.0, 0.0), dock=(5.0, 0.0, 0.0), marker=marker, walls=walls)
    dock, rng = standin.make_dock(stand), np.random.default_rng(1)
    belief = DockBelief(dock, dock.pose, standin.MOUNT, stand.settings, rng)
    seen = () if corners is None else (Sighting(0, standin.DICTIONARY, corners),)
    for stamp in 0.2 * np.arange(5):
        belief.add_odometry(Odometry(stamp, (0.0, 0.0, 0.0)))
        belief.observe(Observation(stamp, standin.CAMERA, seen))
    return DockingProgress(belief)


def test_a_marker_that_was_found_from_afar_is_missed_from_as_far(monkeypatch):
    # Small as it is, it should be found from 2.1 m on.
    docking, robot = docking_at_the_origin(0.075), np.array([-2.6, 0.0, 0.0])
    assert not docking.is_in_reach(robot)
    monkeypatch.setattr(docking.belief, "best", lambda: SimpleNamespace(found_from=2.9))
    assert docking.is_in_reach(robot)
    assert not docking.is_in_reach(np.array([-3.2, 0.0, 0.0]))


def test_no_way_creeps_towards_a_wall_however_short_it_is(monkeypatch):
    docking = docking_at_the_origin(0.2)
    aside = standin.make_dock(standin.Stand((0.0, 0.0, 0.0))).walls.opening / 2.0 + 0.05
    boxes, radius = wall_boxes(docking.belief.dock), TURNING_RADIUS
    front = float(clearance(np.array([[-5.0, aside]]), boxes)[0])
    dock = np.array([5.0 - front + radius + 0.03, -aside, 0.0])
    monkeypatch.setattr(docking.belief, "samples", lambda count: np.tile(dock, (count, 1)))
    assert not docking.paths.is_safe(((0.1, 0.0),))
    assert docking.paths.is_safe(((-0.1, 0.0), (-1.0, 0.0)))


@pytest.mark.parametrize(
    "name, size, corners, walls",
    [
        ("nothing is seen", 0.075, None, True),
        # Looks for a larger print from nearer each time once one was seen.
        ("a copy is seen", 0.075, COPY, True),
        ("no walls", 0.2, COPY, False),
        ("the marker is seen", 0.2, MARKER, True),
    ],
)
def test_ways_and_views_are_as_before(name, size, corners, walls):
    docking = docking_at_the_origin(size, corners, walls)
    belief, paths, search = docking.belief, docking.paths, docking.search
    aside = [paths.way_aside(KNOWN, to_the_left) for to_the_left in (True, False)]
    ways, costmap = [paths.way_to_staging(KNOWN), *aside], paths.costmap()
    found = {
        "ways": tuple(map(np.array, ways)),
        "costs": (costmap.touch.sum(axis=0), costmap.costs[::7, ::9]),
        "sight": [search.expects_marker(), search.use_cue(), search.chance_to_see()],
        "belief": (belief.samples(20), belief.obstacles()),
    }
    found["probes"] = [paths.choose_probe() for _ in range(7)]
    for number in range(3):
        view = search.next_view()
        found[number] = view and (np.array(view.way), [view.heading])
        search.add_failed_look()
        found[f"left {number}"] = belief.particles.mass, search.chance_to_see()
    text = Path(__file__).with_name(f"{name.replace(' ', '_')}.txt")
    assert_as_before(lines_of(found, ""), text)


def test_looks_from_where_it_will_drive_to_and_nowhere_else(monkeypatch):
    docking, refused = docking_at_the_origin(0.075), []
    best = docking.search.next_view()
    assert len(best.way) > 1
    there = best.way[-1]
    monkeypatch.setattr(docking.paths, "is_safe", lambda way: math.dist(way[-1], there) > 0.5)
    assert math.dist(docking.search.next_view().way[-1], there) > 0.5
    monkeypatch.setattr(docking.paths, "is_safe", refused.append)
    assert docking.search.next_view() is None
    ends = [tuple(way[-1]) for way in refused]
    # Those that are left of fourteen looks for a larger print.
    assert len(ends) == 12 * 40
    # One after the other, each place is asked for once, whatever the headings there.
    assert len(set(ends[:40])) == 40


@pytest.mark.parametrize("walls", [True, False])
def test_the_axis_is_as_before(walls):
    axis = docking_at_the_origin(0.2, walls=walls).axis
    robots = np.random.default_rng(3).normal((-1.2, 0.0, 0.0), (0.8, 0.12, 0.2), (300, 3))
    robots[::2, 1:] *= 0.1
    found = []
    for robot in robots.tolist():
        deviation = 0.1 * abs(robot[2])
        flags = axis.leads_at_an_edge(robot, deviation), axis.is_in_lane(robot, deviation)
        commands = *axis.forwards(robot), *axis.backwards(robot, -robot[0])
        found += lines_of([*commands, axis.left(robot), *flags], axis.check_gate(robot))
        found[-1] += " within" * axis.is_within_walls(robot)
    assert_as_before(found, Path(__file__).with_name(f"axis_{walls}.txt"))
