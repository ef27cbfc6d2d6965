"""Each defect of the published noise: a check that the mended one passes and it does not."""

import math

import numpy as np
import pytest

from bullet_lab.core import se2
from bullet_lab.core.se2 import wrap
from bullet_lab.noise.odometry_noise import NoisyPath, RateInvariantRule, ReportRule
from bullet_lab.noise.published_noise import PUBLISHED_RATE, PublishedNoise, Sampler

SEEDS = range(50)


def mended(seed):
    path = NoisyPath(ReportRule(0.1), seed)
    return lambda *pose: path.update(*pose).pose


def mended_for_any_rate(seed):
    path = NoisyPath(RateInvariantRule(0.1), seed)
    return lambda *pose: path.update(*pose).pose


def published(seed):
    return PublishedNoise(0.1, seed).update


def drive(start, *legs):
    """Return the poses of a drive; a leg is a number of equal steps and the step."""
    poses = [np.array(start, dtype=float)]
    for count, step in legs:
        for _ in range(count):
            poses.append(se2.compose(poses[-1], step))
    return np.array(poses)


def run(update, poses):
    return np.array([update(*pose) for pose in poses.tolist()])


def errors_accumulate(make_update):
    poses = drive((0, 0, 0), (100, (0.1, 0.0, 0.05)))
    noisy = np.array([run(make_update(seed), poses) for seed in SEEDS])
    rms = np.sqrt(np.mean(np.sum((noisy - poses)[..., :2] ** 2, axis=-1), axis=0))
    return rms[-1] > 5.0 * rms[1]


def angles_are_wrapped(make_update):
    # Along the heading where the sign of yaw changes; the heading sways by a milliradian.
    poses = drive((0, 0, math.pi - 5e-4), *[(1, (0.2, 0.0, s * 1e-3)) for s in [1, -1] * 5])
    noisy = run(make_update(1), poses)
    return np.abs(noisy[:, 1] - poses[:, 1]).max() < 0.01


def rest_is_quiet(make_update):
    noisy = run(make_update(1), drive((1.0, 2.0, 1.5), (20, (0.0, 0.0, 0.0))))
    return len(np.unique(noisy, axis=0)) == 1


def rest_after_a_drive_is_quiet(make_update):
    noisy = run(make_update(1), drive((0, 0, 1.5), (5, (0.1, 0, 0.1)), (20, (0.0, 0.0, 0.0))))
    return len(np.unique(noisy[5:], axis=0)) == 1


def heading_error_bends_the_path(make_update):
    poses = drive((0, 0, 0), (10, (0.0, 0.0, 0.15)), (20, (0.1, 0.0, 0.0)))
    noisy = run(make_update(1), poses)
    dx, dy, _ = noisy[-1] - noisy[10]
    bend = wrap(math.atan2(dy, dx) - 1.5)
    heading_error = wrap(noisy[10, 2] - 1.5)
    return abs(bend) > 0.01 and abs(bend - heading_error) < 1e-6


def reversing_stays_reversing(make_update):
    poses = drive((0, 0, 0), (50, (-0.05, 0.0, 0.0)))
    steps = se2.steps(run(make_update(1), poses))
    return bool((steps[:, 0] < 0.0).all()) and np.abs(steps[:, 1:]).max() < 1e-3


def spread_is_that_of_any_rate(make_update):
    spreads = []
    for count in (4, 80):
        poses = drive((0, 0, 0), (count, (4.0 / count, 0.0, 1.0 / count)))
        final = np.array([run(make_update(seed), poses)[-1] for seed in range(400)])
        spreads.append(np.std(wrap(final[:, 2] - poses[-1, 2])))
    return 0.8 < spreads[0] / spreads[1] < 1.25


@pytest.mark.parametrize(
    "check",
    [
        errors_accumulate,
        angles_are_wrapped,
        rest_is_quiet,
        rest_after_a_drive_is_quiet,
        heading_error_bends_the_path,
        reversing_stays_reversing,
    ],
)
def test_defect_is_mended(check):
    assert check(mended)
    assert not check(published)


def test_defect_of_the_rate_is_mended_by_the_rate_invariant_rule():
    assert spread_is_that_of_any_rate(mended_for_any_rate)
    assert not spread_is_that_of_any_rate(published)
    assert not spread_is_that_of_any_rate(mended)


def test_one_output_for_each_message_where_the_published_node_skips():
    stamps = [k / 20 for k in range(201)]
    sampler, path = Sampler(PUBLISHED_RATE), NoisyPath(ReportRule(0.1), 1)
    assert len([path.update(stamp, 0.0, 0.0) for stamp in stamps]) == len(stamps)
    assert len([stamp for stamp in stamps if sampler.due(stamp)]) == 9


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


def test_published_noise_of_zero_std_is_the_perfect_path():
    poses = drive((0, 0, 0), (50, (0.1, 0.0, 0.3)))
    np.testing.assert_allclose(run(PublishedNoise(0.0, 1).update, poses), poses, atol=1e-12)


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
    side = (200, (1.902 / 200, 0.0, 0.0))
    turn = (68, (0.0, 0.0, math.radians(-90.1) / 68))
    poses = drive((0, 0, 0), *[side, turn] * 4)
    sides = [0] + [label for number in range(4) for label in [number] * 200 + [-1] * 68]
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
