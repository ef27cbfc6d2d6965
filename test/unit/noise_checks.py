"""Statistics that the tests of noise share."""

import math

import numpy as np
from scipy import stats


def check_normal(errors, deviation, mean=0.0):
    """Compare mean and variance of errors with their distributions, to 99.9 % each."""
    errors = np.ravel(errors) - mean
    number = len(errors)
    assert abs(errors.mean()) < stats.norm.ppf(0.9995) * deviation / math.sqrt(number)
    chi = np.sum(errors**2) / deviation**2
    assert stats.chi2.ppf(0.0005, number) < chi < stats.chi2.ppf(0.9995, number)
