"""Steps of truth and odometry as real ones are: other rates, clocks, frames, gaps and rests."""

import numpy as np
import pytest
from shared import cases, refuses

from bullet_lab.core import se2
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.noise.systematic import path_of
from bullet_lab.studies.calibrate.alignment import marker_place, resolution
from bullet_lab.studies.calibrate.steps import StepSettings, joined, take_steps
from bullet_lab.studies.paths import Recording


def steps_of(truth, odometry, **settings):
    return take_steps(Recording("x", truth, odometry), StepSettings(**settings))


def pose_at(seconds):
    """A drive whose way and turn go up and down, round and round: (n, 3)."""
    t = np.linspace(0.0, 30.0, 60001)
    speed, turn = 0.3 + 0.2 * np.sin(1.3 * t), 0.6 * np.sin(0.7 * t) + 0.4
    heading = np.cumsum(turn) * t[1]
    x, y = np.cumsum(speed * np.cos(heading)) * t[1], np.cumsum(speed * np.sin(heading)) * t[1]
    columns = [np.interp(seconds, t, column) for column in (x, y, heading)]
    return np.column_stack((columns[0], columns[1], se2.wrap(columns[2])))


def path(start, end, rate, offset=0.0, frame=(0.0, 0.0, 0.0)):
    stamps = np.arange(start, end, 1.0 / rate)
    return Trajectory(stamps - offset, se2.compose(frame, pose_at(stamps)))


def some(whole, seen):
    """The poses of a path that were seen."""
    return Trajectory(whole.stamps[seen], whole.poses[seen])


def moved(whole, by):
    """A path whose poses are off by some amounts."""
    return Trajectory(whole.stamps, whole.poses + by)


def normal(seed, deviation, like):
    return np.random.default_rng(seed).normal(0.0, deviation, like.poses.shape)


def far(steps):
    return np.hypot(*steps.true[:, :2].T)


def test_the_same_stamps_give_the_steps_of_both_bit_for_bit():
    both = path(0.0, 5.0, 20.0)
    steps = steps_of(both, both)
    np.testing.assert_array_equal(steps.true, se2.steps(both.poses))
    np.testing.assert_array_equal(steps.odometry, steps.true)
    assert steps.follows.tolist() == [False] + [True] * (len(steps) - 1)
    # Several recordings are one.
    two = joined([steps, steps])
    assert len(two) == 2 * len(steps)
    assert not two.follows[len(steps)]


@cases("rates: [[97.0, 20.0], [20.0, 50.0], [31.0, 30.0]]")
def test_other_rates_and_frames_give_the_same_steps(rates):
    truth = path(0.013, 20.0, rates[0])
    odometry = path(0.5, 25.0, rates[1], frame=(5.0, -3.0, 2.0))
    steps = steps_of(truth, odometry)
    slower = min(rates)
    assert len(steps) == pytest.approx(19.5 * slower, abs=2)
    assert np.median(steps.seconds) == pytest.approx(1.0 / slower)
    # The robot's velocity changes between poses; linear interpolation would be 1 mm off.
    np.testing.assert_allclose(steps.true, steps.odometry, atol=2e-4)


def test_steps_over_gaps_are_left_out_and_counted():
    truth, odometry = path(0.0, 20.0, 100.0), path(0.0, 20.0, 10.0)
    truth = some(truth, (truth.stamps < 5.0) | (truth.stamps > 7.0))
    odometry = some(odometry, (odometry.stamps < 12.0) | (odometry.stamps > 13.0))
    steps = steps_of(truth, odometry)
    assert steps.gaps == pytest.approx(23, abs=1)
    assert steps.seconds.max() < 0.2
    assert (~steps.follows).sum() == 3
    np.testing.assert_allclose(steps.true, steps.odometry, atol=1e-3)


def test_pauses_between_bursts_are_no_gaps():
    whole = path(0.0, 20.0, 100.0)
    steps = steps_of(whole, some(whole, np.arange(len(whole)) % 30 < 15))
    assert steps.gaps == 0
    assert steps.seconds.max() > 0.15


def test_a_robot_that_stands_gives_no_steps_and_one_that_is_carried_is_counted():
    true = pose_at(np.maximum(np.arange(110) - 50, 0) * 0.1)
    odometry = Trajectory(0.1 * np.arange(110), true)
    steps = steps_of(moved(odometry, normal(1, 1e-4, odometry)), odometry)
    assert (len(steps), steps.resting, steps.unseen) == (59, 50, 0)
    said = true.copy()
    said[80:90] = said[80]
    assert steps_of(odometry, Trajectory(odometry.stamps, said)).unseen == 9


def test_longer_steps_end_where_the_truth_has_gone_or_turned_so_far():
    both = path(0.0, 20.0, 50.0)
    steps = steps_of(both, both, min_distance=0.1, min_angle=0.2)
    assert ((far(steps) >= 0.1) | (np.abs(steps.true[:, 2]) >= 0.2)).all()
    assert far(steps).max() < 0.12
    assert steps.follows[1:].all()


@cases("offset: [0.25, -0.6]")
def test_a_clock_that_is_behind_is_corrected(offset):
    both = path(0.0, 28.0, 100.0), path(1.0, 27.0, 20.0, offset=offset)
    (remark,) = steps_of(*both, find_offset=False, find_marker=False).remarks
    assert f"time_offset:={offset:.2f}" in remark
    steps = steps_of(*both)
    assert "corrected" in steps.remarks[0]
    np.testing.assert_allclose(steps.true, steps.odometry, atol=2e-3)
    assert steps_of(*both, time_offset=offset).remarks == ()


def test_no_offset_is_made_up_of_noise():
    truth, odometry = path(0.0, 28.0, 100.0), path(1.0, 27.0, 20.0)
    drift = np.cumsum(normal(2, 0.003, odometry), axis=0)
    assert steps_of(truth, moved(odometry, drift)).remarks == ()


def test_what_is_too_short_is_refused():
    with refuses("no time in common; time_offset is added"):
        steps_of(path(0.0, 5.0, 20.0), path(6.0, 9.0, 20.0))
    both = path(0.0, 1.0, 20.0)
    with refuses("19 steps with a moving robot are too few: 30 at least"):
        joined([steps_of(both, both)])


def test_noise_of_the_truth_is_measured_and_steps_are_longer_than_it():
    clean, odometry = path(0.0, 29.0, 100.0), path(0.0, 29.0, 25.0)
    truth = moved(clean, normal(3, [0.002, 0.002, 0.004], clean))
    steps = steps_of(truth, odometry)
    # 700 pairs of steps determine it to some 7 %.
    assert (steps.truth_std_m, steps.truth_std_rad) == pytest.approx((0.002, 0.004), rel=0.25)
    assert "steps end after 0.2" in steps.remarks[0]
    assert (np.maximum(far(steps) / 0.002, np.abs(steps.true[:, 2]) / 0.004) > 85.0).all()
    assert (far(steps_of(truth, odometry, min_distance=0.5)) >= 0.5).all()
    # Noise that adds up is the odometry's, not the truth's.
    drift = np.cumsum(normal(3, [0.002, 0.002, 0.004], odometry), axis=0)
    for reported in (odometry, moved(odometry, drift)):
        found = steps_of(clean, reported, find_offset=False, find_marker=False)
        assert (found.truth_std_m, found.truth_std_rad) == (1e-9, 1e-9)


@cases("place: [[-0.012, 0.0, 0.011], [0.05, -0.03, 0.0]]")
def test_the_place_of_the_truths_point_is_found_and_corrected(place):
    robot = path(0.0, 29.0, 50.0)
    seen = Trajectory(robot.stamps, se2.compose(robot.poses, place))
    said = path_of(se2.steps(robot.poses) + normal(4, [4e-4, 0.0, 4e-4], robot)[1:])
    found, errors = marker_place(seen.poses, said, seen.stamps)
    for value, true, error in zip(found, place, errors):
        assert abs(value - true) < 4.0 * error < 0.02
    steps = steps_of(seen, Trajectory(robot.stamps, said))
    assert "mm ahead of the axle" in steps.remarks[0]
    np.testing.assert_allclose(steps.true, se2.steps(robot.poses), atol=1e-3)
    assert not marker_place(robot.poses, said, robot.stamps)[0].any()


def test_digits_of_a_file_are_its_resolution():
    both = path(0.0, 5.0, 20.0)
    rounded = Trajectory(both.stamps, both.poses.round(4))
    assert resolution(rounded) == pytest.approx(2e-4 / np.sqrt(12.0))
    assert resolution(both) == 1e-9
