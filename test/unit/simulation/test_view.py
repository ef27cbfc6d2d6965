import math

import numpy as np
import pytest
from shared import cases

from bullet_lab.simulation.rendering import RendererError
from bullet_lab.simulation.simulation import Simulation, View, take_picture

# All three beacons side by side, seen from 10 m away at half their height.
BESIDE = View(eye=(0.0, -9.0, 1.0), target=(0.0, 1.0, 1.0), width=320, height=240)
FOCAL = 160 / math.tan(math.radians(65) / 2)


@pytest.fixture(scope="module")
def beacons():
    with Simulation.of("package://bullet_lab/worlds/beacons.world") as simulation:
        yield simulation


def test_three_white_columns_on_gazebos_grey_floor_under_a_grey_sky(beacons):
    picture = take_picture(beacons, BESIDE)
    assert (picture.shape, picture.dtype) == ((240, 320, 3), np.uint8)
    assert (picture[:5] == round(255 * 0.7)).all()
    floor = 155
    assert (picture[-5:] == floor).all()
    row = picture[135].astype(float).mean(axis=1)
    for x in (-5.0, 1.0, 5.0):
        bearing, half = math.atan2(x, 10.0), math.asin(0.25 / math.hypot(x, 10.0))
        left, right = (round(160 + FOCAL * math.tan(bearing + side)) for side in (-half, half))
        # The sun stands towards +x, which is to the right.
        middle = (left + right) // 2
        assert row[middle:right - 2].mean() > row[left + 2 : middle].mean() + 5
        # A column ends within 2 px.
        assert min(abs(row[[left + 1, right - 2]] - floor)) > 3
        row[left - 2 : right + 2] = floor
    assert abs(row - floor).max() <= 3


@cases("""
changed:
  - {width: 0}
  - {horizontal_fov: 3.141592653589793}
  - {eye: [0.0, .nan, 1.0]}
  - {target: [0.0, -9.0, 0.0]}
  - {near: 2.0, far: 1.0}
""")
def test_bad_views_are_refused(beacons, changed):
    view = {"eye": BESIDE.eye, "target": BESIDE.target, "width": 32, "height": 24, **changed}
    with pytest.raises(RendererError):
        take_picture(beacons, View(**view))
