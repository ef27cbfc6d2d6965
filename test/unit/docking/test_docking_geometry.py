"""Tests of walls and sight, against the stand-in's own arithmetic."""

import math
from dataclasses import replace

import docking_standin as standin
import numpy as np
import pytest

from bullet_lab.core import se2
from bullet_lab.core.pose import Pose
from bullet_lab.docking.geometry import MarkerVisibility, clearance, misfit, wall_boxes

STAND = standin.Stand((0.0, 0.0, 0.0), pixel_noise=0.0, dropout=0.0, tilt=0.0)
DOCK = standin.make_dock(STAND)
BOXES = wall_boxes(DOCK)
VISIBILITY = MarkerVisibility(DOCK, standin.CAMERA, standin.MOUNT.z).up_to(4.5, 0.0)


@pytest.mark.parametrize(
    ("point", "boxes", "away"),
    [
        ((-1.0, 0.2), BOXES, 0.3),
        ((-0.1, 0.0), BOXES, 0.1),
        ((-3.0, 0.6), BOXES, 1.0),
        ((-1.0, 0.6), BOXES, 0.0),
        ((0.0, 0.0), np.empty((0, 4)), math.inf),
    ],
)
def test_distance_from_the_walls(point, boxes, away):
    assert clearance(np.array(point), boxes) == pytest.approx(away)


def test_sight_is_never_promised_where_there_is_none():
    rng = np.random.default_rng(4)
    places = rng.uniform((-6.0, -3.0, -1.2), (-0.2, 3.0, 1.2), (3000, 3))
    promised = [place for place in places if VISIBILITY.visible(place)]
    assert len(promised) > 100
    for robot in se2.compose(np.array(promised), (-standin.MOUNT.x, 0.0, 0.0)):
        assert standin.see_print(robot, standin.Print(), STAND, rng) is not None


@pytest.mark.parametrize(
    ("distance", "degrees", "seen"),
    # The walls hide the marker beyond 14 degrees. Too near, it leaves the image.
    [(4.0, 8.0, True), (4.0, 15.0, False), (0.42, 0.0, True), (0.25, 0.0, False)],
)
def test_the_marker_is_seen_between_the_walls(distance, degrees, seen):
    angle = math.radians(degrees)
    x, y = -distance * math.cos(angle), distance * math.sin(angle)
    assert bool(VISIBILITY.unobstructed(x, y)) is seen


@pytest.mark.parametrize(("cx", "cy"), [(219.5, 139.5), (419.5, 339.5)])
def test_the_nearer_edges_of_the_image_count(cx, cy):
    visibility = MarkerVisibility(DOCK, replace(standin.CAMERA, cx=cx, cy=cy), standin.MOUNT.z)
    # 40 px from the edges beside, 10 px from those above and below.
    assert visibility.half_angle(1e9) == pytest.approx(math.atan(179.5 / standin.CAMERA.fx))
    seen = visibility.unobstructed((-0.72, -0.71), 0.0)
    assert seen.tolist() == [True, False]


def test_a_camera_is_turned_about_fixed_axes():
    turned = Pose.from_rpy((0, 0, 0), (0.3, -0.4, 0.5)).rotation_matrix()
    assert replace(standin.MOUNT, roll=0.3, pitch=-0.4, yaw=0.5).rotation == pytest.approx(turned)


UP, DOWN = math.atan(233.5 / standin.CAMERA.fy), math.radians(3.0)


@pytest.mark.parametrize(
    ("marker", "mount", "wanted", "said"),
    [
        ({}, standin.MOUNT, 0.40, None),
        # Its upper edge, 0.16 m above the camera, is 233.5 px above the middle of the image.
        ({}, standin.MOUNT, 0.20, 0.16 / math.tan(UP) + 0.005),
        ({}, replace(standin.MOUNT, pitch=DOWN), 0.40, 0.16 / math.tan(UP - DOWN) + 0.005),
        ({"size": 0.05}, standin.MOUNT, 2.0, 1.395),
        ({"height": 3.0}, standin.MOUNT, 0.40, math.nan),
    ],
)
def test_a_docked_robot_has_to_see_the_whole_marker(marker, mount, wanted, said):
    marker = replace(DOCK.marker, **marker)

    def trouble_at(distance):
        dock = replace(DOCK, marker=marker, docked_distance=distance)
        return misfit(dock, standin.CAMERA, mount)

    trouble = trouble_at(wanted)
    if said is None:
        assert trouble == ""
        return
    assert f"docked_distance is {wanted:g} m" in trouble
    if math.isnan(said):
        assert trouble.endswith("as from no other distance")
        return
    nearest = float(trouble.split()[-2])
    assert nearest == pytest.approx(said, abs=0.0021)
    assert trouble_at(nearest) == ""
    assert trouble_at(nearest + math.copysign(0.001, wanted - said)) != ""
