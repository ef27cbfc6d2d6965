"""Moments of noisy paths against those of the unicycle in Brownian motion, which has no steps."""

import brownian_unicycle
import numpy as np
from numpy.testing import assert_allclose
from shared import cases

from bullet_lab.noise.exact_moments import exact_moments
from bullet_lab.noise.noisy_paths import noisy_steps
from bullet_lab.noise.odometry_noise import RateInvariantRule


def arc(length, curvature, count):
    along = np.linspace(0.0, length, count + 1)
    if not curvature:
        return np.column_stack([along, 0.0 * along, 0.0 * along])
    turned = curvature * along
    arc = np.column_stack([np.sin(turned), 1.0 - np.cos(turned), turned])
    return arc / [curvature, curvature, 1.0]


@cases("k, curvature: [[0.01, 0.5], [0.3, 0.0], [1.0, -2.0]]")
def test_exact_moments_of_many_steps_are_those_of_none(k, curvature):
    # The model's heading gains k² per metre and per radian.
    steps = noisy_steps(arc(4.0, curvature, 2000), RateInvariantRule(k))
    expected = brownian_unicycle.moments(4.0, curvature, k**2 * (1.0 + abs(curvature)), k)
    found, scale = exact_moments(steps), np.sqrt(np.diag(expected[1]))
    assert_allclose(found.mean[-1] / scale, expected[0] / scale, atol=2e-5)
    size = np.outer(scale, scale)
    assert_allclose(found.covariance[-1] / size, expected[1] / size, atol=2e-5)
