import math

import numpy as np
import pytest

from bullet_lab.core.pose import Pose, heading_of

RNG = np.random.default_rng(7)
ANGLES = [tuple(RNG.uniform((-3.1, -1.5, -3.1), (3.1, 1.5, 3.1))) for _ in range(6)]
POLES = [(0.3, 0.5 * math.pi, 0.5), (1.0, -0.5 * math.pi, 0.2), (0.0, 0.5 * math.pi, -3.0)]
HALF_TURNS = [(math.pi, 0.0, 0.0), (0.0, 0.0, math.pi), (math.pi, 0.0, math.pi)]


def axes_of(rpy):
    """Rotation about the fixed axes x, then y, then z, from the textbook."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


@pytest.mark.parametrize("rpy", ANGLES + POLES + HALF_TURNS + [(0.4, 0.5 * math.pi - 1e-7, 0.9)])
def test_angles_and_matrices_are_those_of_turns_about_fixed_axes(rpy):
    pose = Pose.from_rpy((1, 2, 3), rpy)
    assert pose.rotation_matrix() == pytest.approx(axes_of(rpy))
    # Where its angles are not unique, they mean the same rotation.
    again = Pose.from_rpy((0, 0, 0), pose.rpy())
    assert again.rotation_matrix() == pytest.approx(axes_of(rpy), abs=2e-7)
    if rpy in ANGLES:
        assert (*pose.rpy(), pose.yaw) == pytest.approx((*rpy, rpy[2]))
        heading = math.cos(rpy[2]), math.sin(rpy[2])
        assert heading_of(pose.quaternion) == pytest.approx(heading)
    read = Pose.from_matrix((1, 2, 3), axes_of(rpy))
    assert read.position == (1.0, 2.0, 3.0)
    assert read.rotation_matrix() == pytest.approx(axes_of(rpy))
    assert read.quaternion[3] >= 0.0
    assert math.hypot(*read.quaternion) == pytest.approx(1.0)


def test_what_points_straight_up_has_no_heading():
    assert heading_of((0.5, -0.5, 0.5, 0.5)) == (0.0, 0.0)


def test_composing_is_the_product_of_the_matrices():
    a, b = Pose.from_rpy((1, -2, 0.5), ANGLES[0]), Pose.from_rpy((0.3, 4, -1), ANGLES[1])
    product = a * b
    assert product.rotation_matrix() == pytest.approx(axes_of(ANGLES[0]) @ axes_of(ANGLES[1]))
    assert product.position == pytest.approx(
        np.array(a.position) + axes_of(ANGLES[0]) @ b.position
    )


def test_the_inverse_undoes():
    pose = Pose.from_rpy((1, -2, 0.5), ANGLES[2])
    both = pose * pose.inverse()
    assert both.position == pytest.approx((0, 0, 0), abs=1e-12)
    assert both.rotation_matrix() == pytest.approx(np.eye(3))
