"""The camera sees the whole of what it is to take a picture of."""

import math
from itertools import product

import pytest

from bullet_lab.ros.record.photograph import CLEARANCE, FIELD_OF_VIEW, camera_pose, distance_to

BOXES = [
    ((-0.1, -0.1, 0.0), (0.1, 0.1, 0.2)),
    ((2.0, -5.0, 0.1), (4.0, -4.5, 0.4)),
    ((-0.1, -0.1, 0.0), (0.1, 0.1, 3.0)),
]


@pytest.mark.parametrize("box", BOXES)
def test_every_corner_is_in_the_picture(box):
    eye = camera_pose(*box).inverse()
    for corner in product(*zip(*box)):
        x, y, z = (eye * type(eye)(corner)).position
        assert x > CLEARANCE * distance_to(*box)
        assert math.atan2(abs(y), x) < 0.5 * FIELD_OF_VIEW
        # The picture is three quarters as high as wide.
        assert abs(z) / x < 0.75 * math.tan(0.5 * FIELD_OF_VIEW)


def test_a_point_is_looked_at_from_somewhere():
    assert distance_to((1.0, 1.0, 1.0), (1.0, 1.0, 1.0)) > 0.1
