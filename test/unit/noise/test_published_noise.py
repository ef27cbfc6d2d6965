"""Each defect of the published noise: a check that the mended one passes and it does not."""

import math

import numpy as np
import pytest
from noise_paths import drive, square

from bullet_lab.core import se2
from bullet_lab.noise.published_noise import PUBLISHED_RATE, PublishedNoise, Sampler

SEEDS = range(50)


def published(seed):
    return PublishedNoise(0.1, seed).update


def run(update, poses):
    return np.array([update(*pose) for pose in poses.tolist()])


def test_published_algorithm_step_by_step():
    # The listings, by hand, for two steps; the second starts where the first noisy one ended.
    draws = np.random.default_rng(5).standard_normal(6)
    noise = PublishedNoise(0.1, 5)
    assert noise.update(1.0, 2.0, 3.0) == pytest.approx((1.0, 2.0, 3.0))
    x, y, yaw, summed = 1.0, 2.0, 3.0, 3.0
    for k, now in enumerate([(0.8, 1.9, -3.1), (0.6, 1.85, -3.0)]):
        trans = math.hypot(now[0] - x, now[1] - y)
        rot1 = math.atan2(now[1] - y, now[0] - x) - yaw
        rot2 = now[2] - yaw - rot1
        trans += 0.1 * trans * draws[3 * k]
        rot1 += 0.1 * abs(rot1) * draws[3 * k + 1]
        rot2 += 0.1 * abs(rot2) * draws[3 * k + 2]
        x, y = x + trans * math.cos(yaw + rot1), y + trans * math.sin(yaw + rot1)
        summed += rot1 + rot2
        yaw = math.atan2(math.sin(summed), math.cos(summed))
        assert noise.update(*now) == pytest.approx((x, y, yaw))


def test_published_noise_reads_yaw_as_a_quaternion_has_it():
    poses = drive((0, 0, 0), (50, (0.1, 0.0, 0.3)))
    more_turns = poses + [0.0, 0.0, 4 * math.pi]
    expected = run(published(1), poses)
    np.testing.assert_allclose(run(published(1), more_turns), expected, atol=1e-9)


def test_published_noise_restarts():
    noise = PublishedNoise(0.1, 1)
    run(noise.update, drive((0, 0, 0), (5, (0.1, 0.0, 0.3))))
    noise.restart()
    assert noise.update(4.0, 5.0, 0.6) == pytest.approx((4.0, 5.0, 0.6))


def square_of_figure_1a():
    """Return the stamps, the poses and the side (0 to 3; -1: a turn) of each, at 20 Hz."""
    poses = square(136, 1.902, math.radians(-90.1), (0.0, 0.0, 0.0))
    sides = [0] + [label for number in range(4) for label in [number] * 136 + [-1] * 68]
    return np.arange(len(poses)) / 20, poses, np.array(sides)


def largest_deviations(seed):
    """Replay the published node; return the largest distance from the line of each side."""
    stamps, poses, sides = square_of_figure_1a()
    sampler, noise = Sampler(PUBLISHED_RATE), PublishedNoise(0.1, seed)
    picked = [k for k, stamp in enumerate(stamps) if sampler.due(stamp)]
    errors = se2.between(poses[picked], run(noise.update, poses[picked]))
    return [np.abs(errors[sides[picked] == side, 1]).max() for side in range(4)]


def test_published_noise_zigzags_on_the_third_side_only():
    deviations = np.array([largest_deviations(seed) for seed in SEEDS])
    others = deviations[:, [0, 1, 3]].max(axis=1)
    as_in_figure_1b = (deviations[:, 2] > 0.05) & (deviations[:, 2] > 5.0 * others)
    assert as_in_figure_1b.sum() > 0.8 * len(SEEDS)


def due(sampler, stamps):
    return [stamp for stamp in stamps if sampler.due(stamp)]


def test_sampler_takes_the_first_message_after_each_tick():
    stamps = [5.0 + k / 20 for k in range(100)]
    # Ticks at 1.1111 s, 2.2222 s, 3.3333 s and 4.4444 s after the first stamp.
    assert due(Sampler(0.9), stamps) == pytest.approx([6.15, 7.25, 8.35, 9.45])


def test_sampler_at_the_rate_of_the_messages_takes_each():
    for start in (0.05, 1.7e9):
        stamps = [start + k / 20 for k in range(1000)]
        assert due(Sampler(20.0), stamps) == stamps[1:]


def test_sampler_does_not_catch_up_after_a_gap():
    sampler = Sampler(1.0)
    assert due(sampler, [0.0, 0.5, 1.0, 5.5, 5.6, 6.0, 6.1]) == [1.0, 5.5, 6.0]
    sampler.restart()
    assert due(sampler, [2.0, 2.9, 3.0]) == [3.0]
