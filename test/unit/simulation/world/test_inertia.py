import math

import numpy as np
import pytest

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import Inertia
from bullet_lab.simulation.world.tree import (
    combine,
    principal_axes,
)


def box(mass, x, y, z, centre=(0.0, 0.0, 0.0)):
    squares = (y * y + z * z, x * x + z * z, x * x + y * y)
    return Inertia(mass, centre, mass / 12.0 * np.diag(squares))


def test_two_halves_make_the_whole_box():
    half = box(1.5, 0.2, 0.4, 0.6)
    whole = combine([(half, Pose((-0.1, 0.0, 0.0))), (half, Pose((0.1, 0.0, 0.0)))])
    assert whole.mass == pytest.approx(3.0)
    assert whole.centre == pytest.approx((0, 0, 0), abs=1e-15)
    assert whole.matrix == pytest.approx(box(3.0, 0.4, 0.4, 0.6).matrix)


def test_unequal_parts_of_a_turned_box():
    # A box of 0.6 x 0.2 x 0.1 m, cut at a third of its length, and turned as a whole; each
    # part's centre of mass lies off the origin of its frame.
    turned = Pose.from_rpy((1.0, 2.0, 3.0), (0.3, -0.4, 0.5))
    short = box(1.0, 0.2, 0.2, 0.1, centre=(0.1, 0.0, 0.0))
    long = box(2.0, 0.4, 0.2, 0.1, centre=(0.2, 0.0, 0.0))
    parts = [(short, turned), (long, turned * Pose((0.2, 0.0, 0.0)))]
    whole = combine(parts)
    turn = turned.rotation_matrix()
    assert whole.centre == pytest.approx((turned * Pose((0.3, 0.0, 0.0))).position)
    assert whole.matrix == pytest.approx(turn @ box(3.0, 0.6, 0.2, 0.1).matrix @ turn.T)


def test_parts_without_mass_count_for_nothing():
    nothing = Inertia(0.0, (9.0, 9.0, 9.0), np.zeros((3, 3)))
    whole = combine([(box(2.0, 1, 1, 1), Pose()), (nothing, Pose())])
    assert whole.mass == 2.0
    assert whole.centre == (0.0, 0.0, 0.0)


def test_principal_axes_of_a_turned_box():
    turned = Pose.from_rpy((0, 0, 0), (0.2, 0.7, -1.0))
    turn = turned.rotation_matrix()
    straight = box(3.0, 0.6, 0.2, 0.1).matrix
    moments, frame = principal_axes(Inertia(3.0, (1.0, 2.0, 3.0), turn @ straight @ turn.T))
    assert sorted(moments) == pytest.approx(sorted(np.diag(straight)))
    assert frame.position == (1.0, 2.0, 3.0)
    axes = frame.rotation_matrix()
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes @ np.diag(moments) @ axes.T == pytest.approx(turn @ straight @ turn.T)


def test_a_diagonal_inertia_keeps_its_axes():
    moments, frame = principal_axes(box(1.0, 0.1, 0.3, 0.2))
    assert moments == tuple(np.diag(box(1.0, 0.1, 0.3, 0.2).matrix))
    assert frame == Pose()
    assert math.hypot(*frame.quaternion) == 1.0
