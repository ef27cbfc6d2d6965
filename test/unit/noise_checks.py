"""Statistics that the tests of noise share."""

import math

import numpy as np
from scipy import stats

from bullet_lab.noise.noisy_paths import noisy_blocks


def drawn_errors(steps, generator, count):
    """Return the errors of x (m), y (m) and heading (rad) at the end of noisy paths, (count, 3)."""
    errors = []
    for block in noisy_blocks(steps, generator, count):
        off = block.position[:, -1] - steps.position[-1]
        errors.append(np.column_stack((off.real, off.imag, block.heading_error[:, -1])))
    return np.concatenate(errors)


def check_normal(errors, deviation, mean=0.0):
    """Compare mean and variance of errors with their distributions, to 99.9 % each."""
    errors = np.ravel(errors) - mean
    number = len(errors)
    assert abs(errors.mean()) < stats.norm.ppf(0.9995) * deviation / math.sqrt(number)
    chi = np.sum(errors**2) / deviation**2
    assert stats.chi2.ppf(0.0005, number) < chi < stats.chi2.ppf(0.9995, number)
