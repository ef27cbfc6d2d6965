"""Exponential coordinates: against the matrix exponential, and there and back."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from bullet_lab.core.se2 import exponential, logarithm, straightening

COORDINATES = np.concatenate(
    [
        np.random.default_rng(1).uniform([-5.0, -5.0, -3.1], [5.0, 5.0, 3.1], (40, 3)),
        [[1.0, 2.0, yaw] for yaw in (0.0, 1e-12, -1e-9, 1e-6, 3e-4, 1.9e-4, -math.pi, 3.14159)],
    ]
)


@pytest.mark.parametrize("coordinates", COORDINATES.tolist())
def test_it_is_the_matrix_exponential(coordinates):
    x, y, yaw = coordinates
    matrix = expm(np.array([[0.0, -yaw, x], [yaw, 0.0, y], [0.0, 0.0, 0.0]]))
    found = exponential(coordinates)
    np.testing.assert_allclose(found[:2], matrix[:2, 2], atol=1e-12)
    assert math.cos(found[2]) == pytest.approx(matrix[0, 0], abs=1e-12)


def test_there_and_back():
    np.testing.assert_allclose(logarithm(exponential(COORDINATES)), COORDINATES, atol=1e-10)
    poses = COORDINATES
    np.testing.assert_allclose(exponential(logarithm(poses)), poses, atol=1e-10)


def test_a_turn_more_is_the_same_pose():
    np.testing.assert_allclose(
        logarithm([1.0, 2.0, 1.0 + math.tau]), logarithm([1.0, 2.0, 1.0]), atol=1e-12
    )


def test_where_the_series_ends_nothing_jumps():
    below, above = straightening(np.array([1.9999999e-4, 2.0000001e-4]))
    assert abs(below - above) < 1e-10
