"""Exponential moments against samples; confidence 99.9 % for each family, shared out evenly."""

import numpy as np
import pytest
from noise_paths import assert_moments, wandering
from scipy import stats

from bullet_lab.core import se2
from bullet_lab.noise.exact_moments import exponential_moments
from bullet_lab.noise.noisy_paths import noisy_blocks, noisy_steps
from bullet_lab.noise.odometry_noise import MODELS, model_named

PATHS, FAMILY = 10_000, 0.001
STDS = (0.05, 1.0)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("std", STDS)
def test_sample_moments_are_the_exact_ones(model, std):
    steps, at = noisy_steps(wandering(60), model_named(model).at_level(std)), [25, 60]
    exact = exponential_moments(steps, at)
    coordinates = []
    for block in noisy_blocks(steps, np.random.default_rng(71), PATHS):
        off = block.position[:, at] - steps.position[at]
        poses = np.stack([off.real, off.imag, block.heading_error[:, at]], axis=-1)
        coordinates.append(se2.logarithm(poses))
    # Mean 3, covariance 6 entries, at two poses, for each model and level.
    quantile = stats.norm.isf(0.5 * FAMILY / (9 * 2 * len(MODELS) * len(STDS)))
    for k, found in enumerate(np.moveaxis(np.concatenate(coordinates), 1, 0)):
        assert_moments(found, exact.mean[k], exact.covariance[k], quantile)


def test_no_noise_is_no_error():
    steps = noisy_steps(wandering(60), model_named("report").at_level(0.0))
    found = exponential_moments(steps, [60])
    assert not found.mean.any()
    assert not found.covariance.any()
