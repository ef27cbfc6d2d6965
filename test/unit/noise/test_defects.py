"""The report's noise with its defects as switches, against the two versions it joins."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from noise_paths import drive

from bullet_lab.core import se2
from bullet_lab.core.se2 import atan2, hypot
from bullet_lab.noise.odometry_noise import NoisyPath, ReportRule
from bullet_lab.noise.published_noise import (
    ALL,
    DEFECTS,
    NONE,
    Defects,
    PublishedNoise,
    Sampler,
    combinations,
    noisy_paths,
    sampled,
)

SEEDS = range(20)
STD = 0.1
SIDE = (12, (0.15, 0.0, 0.0))
# To the last bit what PublishedNoise uses.
PYTHON = SimpleNamespace(
    **{
        name: np.vectorize(f, otypes=[float])
        for name, f in (
            *(("sin", math.sin), ("cos", math.cos)),
            *(("arctan2", atan2), ("hypot", hypot)),
        )
    }
)
CORNER = (7, (0.0, 0.0, math.radians(-90.3) / 7))
REST = (5, (0.0, 0.0, 0.0))


def square(start=(0.0, 0.0, 0.0)):
    return drive(start, REST, *[SIDE, CORNER] * 4, REST)


def draws(poses, seeds=SEEDS):
    """Return what the generators of live algorithms draw."""
    shape = (len(poses) - 1, 3)
    return np.stack([np.random.default_rng(s).standard_normal(shape) for s in seeds], axis=1)


def noisy(poses, defects, std=STD, seeds=SEEDS, **functions):
    return noisy_paths(poses[:, np.newaxis], draws(poses, seeds), std, defects, **functions)


def only(name):
    return Defects(**{name: True})


def published(poses, seed):
    noise = PublishedNoise(STD, seed)
    return np.array([noise.update(*pose) for pose in poses.tolist()])


def mended(poses, seed):
    path = NoisyPath(ReportRule(STD), seed)
    return np.array([path.update(*pose).pose for pose in poses.tolist()])


@pytest.mark.parametrize(
    "poses",
    [
        square((1.0, -2.0, 3.1)),
        drive((0, 0, 0), (30, (-0.1, 0.02, 0.3)), REST, (10, (0.0, 0.0, -0.7))),
        drive((0, 0, 10.0), (30, (0.1, 0.0, 0.0))),
    ],
)
def test_with_all_defects_it_is_the_published_algorithm_bit_for_bit(poses):
    replay = noisy(poses, ALL, functions=PYTHON)
    for number, seed in enumerate(SEEDS):
        np.testing.assert_array_equal(replay[:, number], published(poses, seed))


def test_without_defects_it_is_the_mended_algorithm():
    poses = square((1.0, -2.0, 0.4))
    replay = noisy(poses, NONE)
    for number, seed in enumerate(SEEDS):
        errors = se2.between(mended(poses, seed), replay[:, number])
        assert np.abs(errors).max() < 1e-12


def test_without_defects_going_backwards_still_counts_as_two_half_turns():
    poses = drive((0.0, 0.0, 0.0), (1, (-1.0, 0.0, 0.0)))
    error = noisy(poses, NONE)[1] - poses[1]
    draw1 = draws(poses)[0, :, 1]
    np.testing.assert_allclose(np.sin(STD * math.pi * draw1) * -1.0, error[:, 1], rtol=0.5)
    assert np.abs(mended(poses, 1)[1, 1]) < 1e-12 < np.abs(error[:, 1]).min()


def test_combinations():
    found = combinations()
    assert len(set(found)) == len(found) == 32
    assert found[0] == NONE and found[-1] == ALL
    assert str(found[0]) == "none"
    assert str(found[-1]) == " + ".join(DEFECTS)
    assert [len(defects.names) for defects in found] == sorted(
        len(defects.names) for defects in found
    )


def spread(replay, poses):
    """Return the rms position error (m) at each pose."""
    return np.sqrt(np.mean(np.sum((replay - poses[:, np.newaxis])[..., :2] ** 2, -1), axis=-1))


def test_aliasing_forgets_the_error_of_the_step_before():
    poses = drive((0, 0, 0), (100, (0.1, 0.0, 0.0)))
    kept, forgotten = (
        spread(noisy(poses, defects, seeds=range(300)), poses)
        for defects in (NONE, only("aliasing"))
    )
    assert kept[-1] == pytest.approx(STD * 0.1 * math.sqrt(100), rel=0.1)
    assert forgotten[-1] == pytest.approx(STD * 0.1, rel=0.1)


def test_unwrapped_makes_noise_where_the_heading_passes_half_a_turn():
    poses = drive((0, 0, 3.0), (10, (0.1, 0.0, 0.05)))
    passing = int(np.argmax(poses[:, 2] < 0.0))
    for defects, jumps in ((NONE, False), (only("unwrapped"), True)):
        errors = np.abs(se2.between(poses[:, np.newaxis], noisy(poses, defects))[..., 2])
        assert errors[passing - 1].max() < 0.05
        assert (np.median(errors[passing]) > 0.2) == jumps


def test_noise_at_rest_turns_a_robot_that_stands_still():
    poses = drive((1.0, 2.0, 1.5), REST)
    still = noisy(poses, NONE)
    np.testing.assert_allclose(still, np.broadcast_to(still[0], still.shape), rtol=0, atol=1e-12)
    turned = noisy(poses, only("noise_at_rest"))
    assert np.std(turned[-1, :, 2]) > 0.3
    np.testing.assert_array_equal(turned[..., :2], np.broadcast_to(poses[0, :2], (6, 20, 2)))


def test_unbent_keeps_the_direction_whatever_the_heading():
    poses = drive((0, 0, 0), (10, (0.0, 0.0, 0.15)), (20, (0.1, 0.0, 0.0)))
    for defects, bends in ((NONE, True), (only("unbent"), False)):
        replay = noisy(poses, defects)
        way = replay[-1] - replay[10]
        direction = np.arctan2(way[:, 1], way[:, 0]) - 1.5
        heading_error = replay[10, :, 2] - 1.5
        expected = heading_error if bends else np.zeros(len(SEEDS))
        np.testing.assert_allclose(direction, expected, atol=1e-9)


def test_unbent_is_of_no_matter_with_aliasing():
    poses = square()
    straight = noisy(poses, Defects(aliasing=True, unbent=True))
    np.testing.assert_array_equal(noisy(poses, only("aliasing")), straight)


def test_without_noise_every_combination_gives_the_perfect_path():
    poses = square()
    for defects in combinations():
        errors = se2.between(poses[:, np.newaxis], noisy(poses, defects, std=0.0))
        assert np.abs(errors).max() < 1e-12


def test_many_paths_are_each_what_they_are_alone():
    poses = square()
    other = poses + [1.0, 0.0, 0.2]
    together = noisy_paths(np.stack([poses, other], axis=1), draws(poses, [1, 2]), STD, ALL)
    np.testing.assert_allclose(together[:, 1:], noisy(other, ALL, seeds=[2]), atol=1e-9)


def test_sampled_looks_when_the_live_node_does():
    stamps = 5.0 + np.arange(300) / 20
    sampler = Sampler(0.9)
    live = [number for number, stamp in enumerate(stamps) if sampler.due(stamp)]
    np.testing.assert_array_equal(sampled(stamps, 0.9, [1.0 / 0.9])[:, 0], live)


def test_sampled_with_phases():
    stamps = np.arange(41) / 20
    indices = sampled(stamps, 2.0, [0.0, 0.12, 0.49])
    np.testing.assert_array_equal(indices, [[0, 3, 10], [10, 13, 20], [20, 23, 30], [30, 33, 40]])
