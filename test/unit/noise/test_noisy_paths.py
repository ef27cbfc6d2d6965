"""Noisy paths by the thousand: the same as NoisyPath's, whatever the blocks and the order."""

import math

import numpy as np
import pytest
from noise_paths import RULES, played, reported, square, wandering
from numpy.testing import assert_allclose, assert_array_equal
from shared import cases

from bullet_lab.core.se2 import wrap
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.errors import LabError
from bullet_lab.noise.exact_moments import exact_moments
from bullet_lab.noise.noisy_paths import noisy_blocks, noisy_steps
from bullet_lab.noise.odometry_noise import NoisyPath
from bullet_lab.studies.paths import find_corners, resample


def square_drive(count=20):
    poses = square(count, start=(0.0, 0.0, 0.0))
    return Trajectory(0.05 * np.arange(len(poses)), poses)


def drawn(poses, rule, seed, count, **options):
    steps = noisy_steps(poses, rule)
    blocks = noisy_blocks(steps, np.random.default_rng(seed), count, **options)
    return np.concatenate([block.poses(poses) for block in blocks])


@pytest.mark.parametrize("rule", RULES)
def test_the_loop_gives_the_paths_of_the_same_draws_and_their_exact_moments(rule):
    poses, path = wandering(), NoisyPath(rule, 41)
    expected = exact_moments(noisy_steps(poses, rule)).about_perfect()
    looped = []
    for _ in range(3):
        path.restart()
        steps = played(path, poses)
        looped.append(reported(steps))
        covariance = [step.covariance for step in steps]
        assert_allclose(covariance, expected, rtol=0.0, atol=1e-12 * expected.max())
    difference = drawn(poses, rule, 41, 3) - looped
    difference[..., 2] = wrap(difference[..., 2])
    assert np.abs(difference).max() < 1e-12


@cases("size: [1, 250]")
def test_the_size_of_the_blocks_does_not_matter(size):
    poses = wandering()
    expected = drawn(poses, RULES[0], 43, 7)
    assert_array_equal(drawn(poses, RULES[0], 43, 7, steps_per_block=size), expected)


@cases("rate: [0.9, 20.0, 50.0]")
def test_a_rate_keeps_start_end_and_way(rate):
    trajectory = square_drive()
    other = resample(trajectory, rate)
    assert_array_equal(other.poses[[0, -1]], trajectory.poses[[0, -1]])
    assert np.diff(other.stamps)[:-1] == pytest.approx(1.0 / rate)
    for axis in (0, 1):
        on_path = np.interp(other.stamps, trajectory.stamps, trajectory.poses[:, axis])
        assert_allclose(other.poses[:, axis], on_path, atol=1e-12)


def test_a_heading_is_interpolated_the_short_way_round():
    trajectory = Trajectory([0.0, 1.0], [[0.0, 0.0, 3.1], [1.0, 0.0, -3.1]])
    middle = resample(trajectory, 2.0).poses[1, 2]
    assert abs(wrap(middle - math.pi)) < 1e-12


def test_a_rate_that_is_too_high():
    with pytest.raises(LabError, match="1e\\+09 Hz for .* are too many messages"):
        resample(square_drive(), 1e9)


def test_the_corners_of_a_square():
    trajectory = square_drive(20)
    corners = trajectory.poses[find_corners(trajectory), :2]
    assert_allclose(corners, [[2, 0], [2, 2], [0, 2], [0, 0]], atol=1e-12)
