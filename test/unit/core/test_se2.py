"""Planar poses, angles, exponential coordinates and patterns of places."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm
from shared import cases

from bullet_lab.core import se2
from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import (
    circle,
    grid,
    line,
    logarithm,
    quaternion_from_yaw,
    wrap,
    yaw_from_quaternion,
)


def random_poses(*shape):
    return np.random.default_rng(3).uniform(-3.0, 3.0, (*shape, 3))


def matrix(pose):
    x, y, yaw = pose
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.array([[cos, -sin, x], [sin, cos, y], [0.0, 0.0, 1.0]])


def test_compose_is_the_product_of_the_matrices():
    pose, paths = random_poses(), random_poses(4, 7)
    moved = se2.compose(pose, paths)
    for place in np.ndindex(4, 7):
        expected = matrix(pose) @ matrix(paths[place])
        assert_allclose(matrix(moved[place]), expected, atol=1e-12)
    assert se2.compose(paths, pose).shape == moved.shape == (4, 7, 3)


def test_between_and_inverse_undo_compose():
    a, b = random_poses(2, 50)
    assert_allclose(se2.between(a, se2.compose(a, b)), b, atol=1e-12)
    assert_allclose(se2.compose(a, se2.inverse(a)), 0.0, atol=1e-12)
    for turned in (se2.compose([0, 0, 3.0], [0, 0, 3.0]), se2.between([0, 0, -3.0], [0, 0, 3.0])):
        assert turned[2] == 6.0 - 2 * math.pi


@cases("scale: [1.0e-200, 1.0e-9, 1.0, 1.0e+100]")
def test_angles_and_lengths_are_those_of_math(scale):
    angles = np.concatenate([np.linspace(-math.pi, math.pi, 2001), np.geomspace(1e-12, 3.0, 500)])
    for angle in angles.tolist():
        y, x = scale * math.sin(angle), scale * math.cos(angle)
        assert se2.atan2(y, x) == pytest.approx(math.atan2(y, x), rel=4.5e-16, abs=0.0)
        if scale > 1e-150:
            assert se2.hypot(x, y) == pytest.approx(math.hypot(x, y), rel=4.5e-16, abs=0.0)


SPECIAL = (-math.inf, -1.0, -0.0, 0.0, 1.0, math.inf, math.nan)


@pytest.mark.parametrize("y", SPECIAL)
@pytest.mark.parametrize("x", SPECIAL)
def test_the_angles_of_the_axes_are_exact(y, x):
    assert se2.atan2(y, x) == pytest.approx(math.atan2(y, x), rel=0.0, abs=0.0, nan_ok=True)


@cases("""
angle, to:
  - [0.0, 0.0]
  - [3.141592653589793, -3.141592653589793]
  - [-3.141592653589793, -3.141592653589793]
  - [3.1415926535897927, 3.1415926535897927]
  - [4.71238898038469, -1.5707963267948966]
  - [-4.71238898038469, 1.5707963267948966]
  - [7.0, 0.7168146928204138]
  - [-1.0e-300, -1.0e-300]
""")
def test_wrap(angle, to):
    assert [wrap(angle), *wrap(np.array([angle]))] == pytest.approx([to] * 2, abs=1e-15)


def test_wrap_of_floats_and_of_an_array():
    angles = np.random.default_rng(1).uniform(-50.0, 50.0, (40, 25))
    wrapped = wrap(angles)
    assert_array_equal(wrapped, [[wrap(a) for a in row] for row in angles.tolist()])
    assert isinstance(wrap(7.0), float)
    assert wrapped.min() >= -math.pi
    assert wrapped.max() < math.pi
    assert_allclose(np.exp(1j * wrapped), np.exp(1j * angles), atol=1e-13)


def test_wrap_leaves_angles_inside_bit_for_bit():
    angles = np.random.default_rng(2).uniform(-math.pi, math.pi, 1000)
    assert_array_equal(wrap(angles), angles)
    assert math.isnan(wrap(math.nan))
    assert [wrap(angle) for angle in angles.tolist()] == angles.tolist()


@cases("yaw: [0.0, -2.0, 3.14, 1.0e-9]")
def test_yaw_survives_the_quaternion(yaw):
    quaternion = quaternion_from_yaw(yaw)
    assert math.hypot(*quaternion[2:]) == pytest.approx(1.0)
    assert yaw_from_quaternion(*quaternion) == pytest.approx(yaw, abs=1e-15)
    doubled = [2.0 * part for part in quaternion]
    assert yaw_from_quaternion(*doubled) == pytest.approx(yaw, abs=1e-15)
    assert yaw_from_quaternion(0.0, 0.0, 0.0, 0.0) == 0.0


def test_yaw_of_a_tilted_body_is_its_heading():
    tilted = Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.2, 0.7))
    assert yaw_from_quaternion(*tilted.quaternion) == pytest.approx(0.7)


COORDINATES = np.concatenate(
    [
        np.random.default_rng(1).uniform([-5.0, -5.0, -3.1], [5.0, 5.0, 3.1], (40, 3)),
        [[1.0, 2.0, yaw] for yaw in (0.0, 1e-12, -1e-9, 1e-6, 3e-4, 1.9e-4, -math.pi, 3.14159)],
    ]
)


@pytest.mark.parametrize("coordinates", COORDINATES.tolist())
def test_it_is_the_inverse_of_the_matrix_exponential(coordinates):
    x, y, yaw = coordinates
    matrix = expm(np.array([[0.0, -yaw, x], [yaw, 0.0, y], [0.0, 0.0, 0.0]]))
    pose = (*matrix[:2, 2], math.atan2(matrix[1, 0], matrix[0, 0]))
    assert_allclose(logarithm(pose), coordinates, rtol=0.0, atol=1e-10)
    # A turn more is the same pose.
    turned = (*pose[:2], pose[2] + math.tau)
    assert_allclose(logarithm(turned), coordinates, atol=1e-10)


def test_a_line_and_a_grid_which_fills_row_by_row():
    assert line(3, 0.5) == [(0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (1.0, 0.0, 0.0)]
    places = [(x, y) for x, y, _ in grid(5, 2.0)]
    assert places == [(0.0, 0.0), (2.0, 0.0), (4.0, 0.0), (0.0, 2.0), (2.0, 2.0)]
    assert grid(1, 2.0) == [(0.0, 0.0, 0.0)]


def test_a_circle_is_even_and_faces_outwards():
    places = np.array(circle(8, 3.0))
    assert places[0].tolist() == [3.0, 0.0, 0.0]
    x, y, yaw = places.T
    assert_allclose((3.0 * np.cos(yaw), 3.0 * np.sin(yaw)), (x, y), atol=1e-12)
    assert_allclose(np.abs(np.diff(x + 1j * y, append=3.0)), 6.0 * math.sin(math.pi / 8))
