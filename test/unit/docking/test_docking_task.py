"""Tests of whole dockings in the stand-in, and of what goes wrong."""

import math
from dataclasses import replace

import docking_standin as standin
import numpy as np
import pytest
from shared import cases

from bullet_lab.core import se2
from bullet_lab.docking.database import DockUncertainty
from bullet_lab.docking.task import DockingTask, StuckWatch, UndockingTask
from bullet_lab.docking.types import DockingError, DockingSettings, DockingState, MotionStep

PLAIN = standin.Stand((1.0, 0.3, 0.4), (0.1, -0.15, 0.1))
DECOY = standin.Print((-0.7, 1.65, 0.0), 0.5, 0.35)
BESIDE_DECOY = replace(
    PLAIN, prints=(standin.Print(), DECOY), obstacles=((-0.70, -0.68, 1.43, 1.87),)
)
WITHIN_A_COPY = replace(
    PLAIN,
    prints=(standin.Print(size=0.075), standin.Print((0.0, 0.05, 0.0), 0.45, 0.80)),
    marker=standin.DockMarker(standin.DICTIONARY, 0, 0.075, 0.5),
)


def check_docked(feed):
    result = feed.task.result
    assert result.success, result
    assert not feed.contact
    x, y, yaw = se2.between(feed.stand.dock, feed.pose)
    assert abs(-x - 0.56) < 0.006
    assert abs(y) < 0.006
    assert abs(math.degrees(yaw)) < 0.6
    # What it says of itself is so.
    assert result.lateral == pytest.approx(y, abs=0.005)
    assert result.yaw == pytest.approx(yaw, abs=0.01)


STANDS = {"plain": PLAIN, "beside a decoy": BESIDE_DECOY, "within a copy": WITHIN_A_COPY}


# When it docked, and the way and turn so far: all that decides about a docking shows in them, to
# the last figure. Whoever means to change what decides renews the figures.
@cases("""
name, changes, seconds, moved:
  - !long [plain, {}, 24.05, 6.403600]
  - !long [plain, {image_rate: 30.0}, 21.85, 6.294492]
  - [plain, {image_rate: 20.0, late: 0.35}, 22.80, 6.373525]
  # Between the walls, looking out.
  - [plain, {start: [3.1, 0.15, 3.0]}, 18.85, 5.494744]
  # Too near to correct its offset from there.
  - [plain, {start: [3.2, -0.1, 0.3]}, 13.25, 2.102408]
  # Beside the left wall.
  - !long [plain, {start: [3.1, 1.05, 1.0], seed: 3}, 36.85, 11.528995]
  - !long [plain, {start: [0.5, -4.5, -2.0], dock_error: [0.3, 0.3, -0.17]}, 67.65, 22.892058]
  # Any frame.
  - [plain, {dock: [-2.0, 5.0, 2.2], start: [-0.48, 2.4, 2.6]}, 24.25, 6.426102]
  - !long [plain, {model: report, std: 0.1, seed: 4}, 24.05, 6.455489]
  - [plain, {model: rate_invariant, std: 0.03, seed: 5}, 17.45, 3.570103]
  - [plain, {walls: false}, 17.85, 3.755504]
  - !long [beside a decoy, {start: [1.5, 1.6, 0.0]}, 63.65, 13.281207]
  - [beside a decoy, {start: [3.1, 1.0, -1.0]}, 48.85, 17.565660]
  - [within a copy, {}, 61.45, 11.877211]
""")
def test_docks(name, changes, seconds, moved):
    feed = standin.run(replace(STANDS[name], **changes))
    check_docked(feed)
    assert (feed.now, feed.moved) == pytest.approx((seconds, moved), abs=1e-6)


@cases("""
prints, start, seconds, moved:
  - [[], [2.5, 0.0, 0.0], 23.85, 8.317220]
  - !long [[{id: 1}], [1.0, 0.3, 0.4], 64.45, 23.292598]
  - !long [[{height: 0.9}], [1.0, 0.3, 0.4], 27.85, 2.245811]
  # The decoy.
  - !long [[{pose: [-0.7, 1.65, 0.0], size: 0.35}], [1.0, 0.3, 0.4], 103.25, 30.600612]
""")
def test_says_that_the_marker_is_not_there(prints, start, seconds, moved):
    prints = [standin.Print(**one) for one in prints]
    feed = standin.run(replace(BESIDE_DECOY, start=start, prints=prints))
    assert feed.task.result.error == DockingError.NOT_DETECTED
    assert not feed.contact
    assert math.isnan(feed.task.result.lateral)
    assert (feed.now, feed.moved) == pytest.approx((seconds, moved), abs=1e-6)


def fed(start=(1.0, 0.0, 0.0), dock_changes=(), **settings):
    """Return a feed of a docking that begins."""
    dock = replace(standin.make_dock(PLAIN), **dict(dock_changes))
    task = DockingTask(dock, dock.pose, standin.MOUNT, DockingSettings(**settings))
    return standin.Feed(task, replace(PLAIN, start=start, image_rate=20.0))


def approaching():
    """Return a feed that is on its approach."""
    feed = fed(time_limit=90.0)
    feed.run(30.0, until=DockingState.APPROACHING)
    feed.run(1.0)
    assert feed.speeds[0] > 0.05
    assert feed.task.state == DockingState.APPROACHING
    assert feed.task.wants_images
    x, y, yaw = se2.between(PLAIN.dock, feed.pose)
    assert feed.task.place == pytest.approx((-x - 0.16, y, yaw), abs=0.05)
    assert math.dist(feed.task.dock_pose[:2], PLAIN.dock[:2]) < 0.05
    return feed


def check_ended(feed, error, moved=None):
    """Check that a docking ends by an error, after a way (m) if one is given."""
    feed.run(10.0)
    assert feed.task.result.error == error
    assert feed.task.tick(feed.now) == (0.0, 0.0)
    assert not feed.task.wants_images
    assert moved is None or feed.moved == moved


@cases("""
what, found, error, seconds:
  - [images, false, CAMERA_LOST, 3.05]
  - [odometry, false, ODOMETRY_LOST, 1.05]
  - [blocked, true, BLOCKED, 1.5]
""")
def test_what_stops_is_noticed(what, found, error, seconds):
    feed = approaching()
    setattr(feed, what, found)
    start = feed.pose.copy()
    before = feed.now
    check_ended(feed, DockingError[error])
    assert feed.now - before == pytest.approx(seconds)
    # Unseen, it does not go on for long.
    assert math.dist(start[:2], feed.pose[:2]) < 0.5


@cases("""
step, seconds, said:
  - [[0.231, -0.174, 0.359], 0.05, ""]
  - [[0.233, -0.174, 0.0], 0.05, odometry jumped by 0.29 m]
  - [[0.0, 0.0, -0.361], 0.05, odometry jumped by 21 degrees]
  - [[9.0, 0.0, 9.0], 0.0, ""]
  - [[0.0, 0.0, 0.0], -0.49, ""]
  - [[0.0, 0.0, 0.0], -0.51, odometry went back in time]
""")
def test_as_much_as_the_robot_may_have_moved_is_no_trouble(step, seconds, said):
    step = MotionStep(step, np.diag([1e-4, 4e-4, 9e-4]))
    assert fed().task._find_trouble(step, seconds) == said


@cases("""
command, step, count, stuck:
  - [[0.039, 0.12], [0.0, 0.0, 0.0], 16, false]
  - [[0.041, 0.0], [0.0, 9.0, 9.0], 16, true]
  - [[0.041, 0.0], [0.0, 9.0, 9.0], 15, false]
  - [[-0.1, 0.0], [-0.0037, 0.0, 9.0], 16, true]
  - [[-0.1, 0.0], [-0.0038, 0.0, 0.0], 16, false]
  - [[0.0, -0.13], [9.0, 0.0, -0.0048], 16, true]
  - [[0.0, 0.13], [0.0, 0.0, 0.0049], 16, false]
""")
def test_who_did_not_do_three_tenths_of_what_was_commanded_is_stuck(command, step, count, stuck):
    """In the last 2 s: sixteen steps, so that the first one does not count."""
    watch = StuckWatch()
    assert not watch.is_stuck()
    for moved in ((9.0, 0.0, 9.0), *[step] * count):
        watch.add(command, moved, 0.125)
    assert watch.is_stuck() == stuck


@cases("jump: [[0.4, 0.0, 0.0], [0.0, 0.0, 0.8], [.nan, 0.0, 0.0]]")
def test_odometry_that_jumps_is_noticed(jump):
    feed = approaching()
    feed.pose = feed.pose + np.array(jump)
    feed.tick()
    check_ended(feed, DockingError.ODOMETRY_LOST)


@cases("""
start, dock, settings, error, moved, said:
  - [[1.0, 0.0, 0.0], {}, {time_limit: 2.0}, TIMED_OUT, null, not docked after 2 s]
  # Only what is in sight counts.
  - [[1.0, 0.0, 3.0], {}, {search: false}, NOT_DETECTED, 0.0, ""]
  # Within the walls.
  - - [3.0, 0.6, 0.0]
    - {uncertainty: [0.05, 0.02], pose: [4.0, 0.0, 0.0]}
    - {}
    - NOT_VALID
    - 0.0
    - ""
  # From where the marker is not seen.
  - - [1.0, 0.0, 0.0]
    - {docked_distance: 0.2}
    - {}
    - NOT_VALID
    - 0.0
    - the nearest distance possible is 0.35 m
""")
def test_what_ends_a_docking_before_it_has_found_the_marker(
    start, dock, settings, error, moved, said
):
    if "uncertainty" in dock:
        dock["uncertainty"] = DockUncertainty(*dock["uncertainty"])
    feed = fed(start, dock, **settings)
    check_ended(feed, DockingError[error], moved)
    assert said in feed.task.result.message
    assert moved is None or feed.now < 0.2 or not said


def test_a_marker_that_vanishes_is_searched_again():
    feed = approaching()
    feed.stand = replace(feed.stand, dropout=1.0)
    feed.run(20.0, until=DockingState.SEARCHING)
    feed.stand = replace(feed.stand, dropout=0.0)
    feed.run(120.0)
    check_docked(feed)
    assert feed.moved == pytest.approx(3.603809, abs=1e-6)


def test_shares_no_random_numbers_with_noise_of_the_same_seed():
    dock = standin.make_dock(PLAIN)
    tasks = [DockingTask(dock, dock.pose, standin.MOUNT, seed=seed) for seed in (1, 1, 2)]
    first, again, other = (task._belief._rng.random() for task in tasks)
    assert first == again != other
    assert first != np.random.default_rng(1).random()


@cases("""
distance, looks, start, images, x, most, ended:
  - [0.8, false, [3.44, 0.0, 0.0], true, 2.64, 0.01, [3.75, 0.799598]]
  # Straight back it would be 0.13 m off the axis; the marker told it where that is.
  - [0.0, true, [3.44, 0.02, 0.05235987755982989], true, 1.0, 0.03, [10.8, 2.499023]]
  - [0.0, true, [3.44, 0.0, 0.0], false, 1.0, 0.2, [11.8, 2.439003]]
""")
def test_backs_out_by_a_distance_or_until_it_stands_before_the_dock(
    distance, looks, start, images, x, most, ended
):
    dock = standin.make_dock(PLAIN)
    task = UndockingTask(distance, dock, dock.pose, standin.MOUNT if looks else None)
    feed = standin.Feed(task, replace(PLAIN, start=start))
    feed.images = images
    feed.run(60.0)
    assert feed.task.result.success
    assert feed.task.remaining == 0.0
    assert (feed.now, feed.moved) == pytest.approx(ended, abs=1e-6)
    assert feed.pose[:2] == pytest.approx((x, 0.0), abs=most)
