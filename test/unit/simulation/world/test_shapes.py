import math

import numpy as np
import pytest

from bullet_lab.simulation.physics.physics import SHAPES as BODIES
from bullet_lab.simulation.world.shapes import Box, Cylinder, Mesh, Plane, Shape, Sphere

SOLIDS = [Box((0.4, 1.0, 2.0)), Cylinder(0.3, 1.2), Sphere(0.7)]
# The greatest corner, and the distances of a point inside and one outside.
SIZES = [((0.2, 0.5, 1.0), 0.2, 0.5), ((0.3, 0.3, 0.6), 0.2, 0.4), ((0.7, 0.7, 0.7), 0.6, 0.0)]


def test_a_plane_has_no_end():
    assert Plane().bounds().tolist() == [[-math.inf] * 3, [math.inf] * 3]
    assert Plane() == Plane((0.0, 0.0, 1.0), (100.0, 100.0))
    assert Plane((0.0, 3.0, 4.0)).distance((9.0, 0.0, 1.0)) == pytest.approx(0.8)


@pytest.mark.parametrize("shape, size", [*zip(SOLIDS, SIZES)])
def test_a_shape_has_its_size(shape, size):
    corner, inside, outside = size
    assert np.ravel(shape.bounds()) == pytest.approx([-value for value in corner] + [*corner])
    assert shape.distance((0.0, -0.1, 0.0)) == pytest.approx(inside)
    assert shape.distance((0.7, 0.0, 0.0)) == pytest.approx(outside)


def test_all_that_makes_something_of_shapes_knows_each():
    pytest.importorskip("rospy")
    from bullet_lab.ros.messages.conversions import MARKERS

    shapes = set(Shape.__subclasses__())
    assert set(MARKERS) == shapes
    # A mesh is made by its corners.
    assert set(BODIES) == shapes - {Mesh}
