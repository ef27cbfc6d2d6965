"""Tests of walls and sight, against the stand-in's own arithmetic."""

import math
from dataclasses import replace

import docking_standin as standin
import numpy as np
import pytest

from bullet_lab.docking.geometry import MarkerVisibility, clearance, misfit, wall_boxes

STAND = standin.Stand((0.0, 0.0, 0.0), pixel_noise=0.0, dropout=0.0, tilt=0.0)
DOCK = standin.make_dock(STAND)
BOXES = wall_boxes(DOCK)


@pytest.mark.parametrize(
    ("point", "away"),
    [
        ((-1.0, 0.2), 0.3),
        ((-0.1, 0.0), 0.1),
        ((-3.0, 0.6), 1.0),
        ((-1.0, -0.9), 0.2),
        ((-1.0, 0.6), 0.0),
        ((-2.3, 0.1), 0.5),
    ],
)
def test_distance_from_the_walls(point, away):
    assert clearance(np.array(point), BOXES) == pytest.approx(away)


def test_without_walls_all_is_free():
    assert np.isinf(clearance(np.zeros((3, 2)), np.empty((0, 4)))).all()


def test_sight_is_never_promised_where_there_is_none():
    rng = np.random.default_rng(4)
    visibility = MarkerVisibility(DOCK, standin.CAMERA, standin.MOUNT.z)
    promised = kept = 0
    for _ in range(3000):
        camera = (rng.uniform(-6.0, -0.2), rng.uniform(-3.0, 3.0), rng.uniform(-1.2, 1.2))
        if not visibility.visible(np.array(camera)):
            continue
        promised += 1
        robot = (
            camera[0] - standin.MOUNT.x * math.cos(camera[2]),
            camera[1] - standin.MOUNT.x * math.sin(camera[2]),
            camera[2],
        )
        kept += standin.see_print(robot, standin.Print(), STAND, rng) is not None
    assert promised > 100
    assert kept == promised


def test_the_walls_hide_the_marker_beyond_14_degrees():
    visibility = MarkerVisibility(DOCK, standin.CAMERA, standin.MOUNT.z)
    for angle, seen in ((math.radians(8.0), True), (math.radians(15.0), False)):
        x, y = -4.0 * math.cos(angle), 4.0 * math.sin(angle)
        assert bool(visibility.unobstructed(x, y)) is seen
    # Too near, the marker leaves the image.
    assert visibility.unobstructed(-0.42, 0.0)
    assert not visibility.unobstructed(-0.25, 0.0)


UP, DOWN = math.atan(233.5 / standin.CAMERA.fy), math.radians(3.0)


@pytest.mark.parametrize(
    ("dock", "mount", "wanted", "said"),
    [
        (DOCK, standin.MOUNT, 0.40, None),
        # Its upper edge, 0.16 m above the camera, is 233.5 px above the middle of the image.
        (DOCK, standin.MOUNT, 0.20, 0.16 / math.tan(UP) + 0.005),
        (DOCK, replace(standin.MOUNT, pitch=DOWN), 0.40, 0.16 / math.tan(UP - DOWN) + 0.005),
        (replace(DOCK, marker=replace(DOCK.marker, size=0.05)), standin.MOUNT, 2.0, 1.395),
        (replace(DOCK, marker=replace(DOCK.marker, height=3.0)), standin.MOUNT, 0.40, math.nan),
    ],
)
def test_a_docked_robot_has_to_see_the_whole_marker(dock, mount, wanted, said):
    dock = replace(dock, docked_distance=wanted)
    farthest = standin.CAMERA.fy * dock.marker.size / 18.0
    trouble = misfit(dock, standin.CAMERA, mount, farthest)
    if said is None:
        assert trouble == ""
        return
    assert f"docked_distance is {wanted:g} m" in trouble
    if math.isnan(said):
        assert trouble.endswith("as from no other distance")
        return
    nearest = float(trouble.split()[-2])
    assert nearest == pytest.approx(said, abs=0.0021)
    for distance, fits in ((nearest, True), (nearest + math.copysign(0.001, wanted - said), False)):
        again = replace(dock, docked_distance=distance)
        assert (misfit(again, standin.CAMERA, mount, farthest) == "") == fits
