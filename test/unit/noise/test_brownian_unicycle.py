"""Moments of noisy paths against those of the unicycle in Brownian motion, which has no steps."""

import brownian_unicycle
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bullet_lab.noise.exact_moments import exact_moments, exponential_moments, first_order_moments
from bullet_lab.noise.noisy_paths import noisy_steps
from bullet_lab.noise.odometry_noise import RateInvariantRule


def arc(length, curvature, count):
    along = np.linspace(0.0, length, count + 1)
    if not curvature:
        return np.column_stack([along, 0.0 * along, 0.0 * along])
    turned = curvature * along
    arc = np.column_stack([np.sin(turned), 1.0 - np.cos(turned), turned])
    return arc / [curvature, curvature, 1.0]


def assert_close(found, at, expected, relative):
    scale = np.sqrt(np.diag(expected[1]))
    whitened = found.mean[at] / scale, found.covariance[at] / np.outer(scale, scale)
    assert_allclose(whitened[0], expected[0] / scale, atol=relative)
    assert_allclose(whitened[1], expected[1] / np.outer(scale, scale), atol=relative)


@pytest.mark.parametrize("k, curvature", [(0.01, 0.5), (0.3, 0.0), (1.0, -2.0)])
def test_exact_moments_of_many_steps_are_those_of_none(k, curvature):
    # The model's heading gains k² per metre and per radian.
    steps = noisy_steps(arc(4.0, curvature, 2000), RateInvariantRule(k))
    expected = brownian_unicycle.moments(4.0, curvature, k**2 * (1.0 + abs(curvature)), k)
    assert_close(exact_moments(steps), -1, expected, 2e-5)


@pytest.mark.parametrize("length, k", [(4.0, 0.3), (40.0, 0.05)])
def test_exponential_moments_of_many_steps_are_those_of_none(length, k):
    steps = noisy_steps(arc(length, 0.0, 600), RateInvariantRule(k))
    expected = brownian_unicycle.exponential_moments(length, k**2, k)
    assert_close(exponential_moments(steps, [600]), 0, expected, 5e-5)


def test_the_least_noise_has_the_same_covariance_in_exponential_coordinates():
    steps = noisy_steps(arc(4.0, 0.5, 60), RateInvariantRule(1e-7))
    found, first = exponential_moments(steps, [60]).covariance[0], first_order_moments(steps)
    assert_array_equal(found, first.covariance[-1])
