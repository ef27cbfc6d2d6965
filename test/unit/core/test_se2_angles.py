import math

import numpy as np
import pytest

from bullet_lab.core.se2 import quaternion_from_yaw, wrap, yaw_from_quaternion

BELOW_PI = float(np.nextafter(math.pi, 0.0))
CASES = [
    (0.0, 0.0),
    (math.pi, -math.pi),
    (-math.pi, -math.pi),
    (BELOW_PI, BELOW_PI),
    (3 * math.pi / 2, -math.pi / 2),
    (-3 * math.pi / 2, math.pi / 2),
    (2 * math.pi, 0.0),
    (7.0, 7.0 - 2 * math.pi),
    (-1e-300, -1e-300),
]


@pytest.mark.parametrize(("angle", "expected"), CASES)
def test_wrap_of_a_float(angle, expected):
    wrapped = wrap(angle)
    assert isinstance(wrapped, float)
    assert wrapped == pytest.approx(expected, abs=1e-15)


def test_wrap_of_an_array_is_that_of_its_floats():
    angles = np.random.default_rng(1).uniform(-50.0, 50.0, (40, 25))
    angles[0, : len(CASES)] = [angle for angle, _ in CASES]
    wrapped = wrap(angles)
    assert wrapped.shape == angles.shape
    np.testing.assert_array_equal(wrapped, [[wrap(float(a)) for a in row] for row in angles])
    assert wrapped.min() >= -math.pi
    assert wrapped.max() < math.pi
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angles), atol=1e-13)


def test_wrap_leaves_angles_inside_bit_for_bit():
    angles = np.random.default_rng(2).uniform(-math.pi, math.pi, 1000)
    np.testing.assert_array_equal(wrap(angles), angles)
    assert [wrap(angle) for angle in angles.tolist()] == angles.tolist()


def test_wrap_of_nan_is_nan():
    assert math.isnan(wrap(math.nan))
    assert np.isnan(wrap(np.array([math.nan]))).all()


@pytest.mark.parametrize("yaw", [0.0, 0.3, -2.0, math.pi / 2, 3.14, -3.14, 1e-9])
def test_yaw_survives_the_quaternion(yaw):
    quaternion = quaternion_from_yaw(yaw)
    assert math.hypot(*quaternion[2:]) == pytest.approx(1.0)
    assert yaw_from_quaternion(*quaternion) == pytest.approx(yaw, abs=1e-15)
    doubled = [2.0 * part for part in quaternion]
    assert yaw_from_quaternion(*doubled) == pytest.approx(yaw, abs=1e-15)


def test_yaw_of_a_tilted_body_is_its_heading():
    half_yaw, half_pitch = 0.5 * 0.7, 0.5 * 0.2
    quaternion = (
        -math.sin(half_yaw) * math.sin(half_pitch),
        math.cos(half_yaw) * math.sin(half_pitch),
        math.sin(half_yaw) * math.cos(half_pitch),
        math.cos(half_yaw) * math.cos(half_pitch),
    )
    assert yaw_from_quaternion(*quaternion) == pytest.approx(0.7)


def test_an_empty_quaternion_is_no_heading():
    assert yaw_from_quaternion(0.0, 0.0, 0.0, 0.0) == 0.0
