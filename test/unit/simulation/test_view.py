import math

import cv2
import numpy as np
import pytest

from bullet_lab.simulation.rendering.graphics import RendererError
from bullet_lab.simulation.simulation import Simulation, View, take_picture

# All three beacons side by side, seen from 10 m away at half their height.
BESIDE = View(eye=(0.0, -9.0, 1.0), target=(0.0, 1.0, 1.0), width=320, height=240)
FOCAL = 160 / math.tan(math.radians(65) / 2)


@pytest.fixture(scope="module")
def beacons():
    with Simulation.of("package://bullet_lab/worlds/beacons.world") as simulation:
        yield simulation


def runs(mask):
    """Return first and last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return list(zip(edges[::2], edges[1::2] - 1))


def test_three_white_columns_on_gazebos_grey_floor_under_a_grey_sky(beacons):
    picture = take_picture(beacons, BESIDE)
    assert (picture.shape, picture.dtype) == ((240, 320, 3), np.uint8)
    assert (picture[:5] == round(255 * 0.7)).all()
    floor = 155
    assert (picture[-5:] == floor).all()
    row = picture[135].astype(float)
    # The shades of a column may include that of the floor.
    other = (abs(row.mean(axis=1) - floor) > 3).astype(np.uint8)
    found = runs(cv2.morphologyEx(other[None], cv2.MORPH_CLOSE, np.ones((1, 9)))[0])
    assert len(found) == 3
    for (first, last), x in zip(found, (-5.0, 1.0, 5.0)):
        bearing, half = math.atan2(x, 10.0), math.asin(0.25 / math.hypot(x, 10.0))
        left, right = (160 + FOCAL * math.tan(bearing + side) for side in (-half, half))
        assert (first, last + 1) == pytest.approx((left, right), abs=1.5)
    # The sun stands towards +x, which is to the right.
    first, last = found[1]
    middle = (first + last + 1) // 2
    assert row[middle + 1 : last].mean() > row[first + 1 : middle].mean() + 5


@pytest.mark.parametrize(
    "changed",
    [
        {"width": 0},
        {"horizontal_fov": math.pi},
        {"eye": (0.0, math.nan, 1.0)},
        {"target": (0.0, -9.0, 0.0)},
        {"near": 2.0, "far": 1.0},
    ],
)
def test_bad_views_are_refused(beacons, changed):
    view = {"eye": BESIDE.eye, "target": BESIDE.target, "width": 32, "height": 24, **changed}
    with pytest.raises(RendererError):
        take_picture(beacons, View(**view))
