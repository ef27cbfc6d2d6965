"""Camera poses in front of the marker, and the images from there."""

import math
from dataclasses import replace

import numpy as np
import pytest
from marker_images import CAMERA
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.studies.detection_range.trial import (
    MARKER,
    WORLDS,
    Cell,
    FreeCamera,
    camera_pose,
    cell_shots,
    in_optical_frame,
    is_reachable,
    strewn_shots,
)
from bullet_lab.studies.worlds import lit_world


def cell(distance, degrees=0.0, world="docking", light="default"):
    return Cell(world, light, distance, math.radians(degrees))


@cases("""
distance, degrees, place:
  - [1.0, 0.0, [3.0, 0.0, 0.44]]
  # 4 less the root of 3.
  - [2.0, 30.0, [2.2679491924311228, 1.0, 0.44]]
""")
def test_a_bearing_is_seen_from_the_marker_and_the_camera_looks_back_at_it(
    distance, degrees, place
):
    pose = camera_pose(distance, math.radians(degrees))
    assert pose.position == pytest.approx(place)
    assert in_optical_frame(pose, [MARKER])[0] == pytest.approx((0.0, -0.06, distance))


def test_the_corners_are_those_of_an_upright_marker():
    corners = WORLDS["docking"][0].corners()
    corners = CAMERA.project(in_optical_frame(camera_pose(1.0, 0.0), corners))
    left, right = 319.5 - 50.23, 319.5 + 50.23
    assert corners[:, 0] == pytest.approx([left, right, right, left])
    assert corners[0, 1] == corners[1, 1] < corners[2, 1] == corners[3, 1]


def test_the_places_of_a_cell_are_on_both_sides_and_close_to_it():
    for number, view in enumerate(cell_shots(cell(2.0, 30.0), 20, 1)):
        x, y, z = view.pose.position
        distance, bearing = math.hypot(4.0 - x, y), math.atan2(y, 4.0 - x)
        assert distance == pytest.approx(2.0, abs=0.0101) and z == 0.44
        assert bearing == pytest.approx((-1) ** number * math.radians(30.0), abs=0.0176)
        ahead = in_optical_frame(view.pose, [MARKER])[0]
        assert abs(math.atan2(ahead[0], ahead[2])) <= math.radians(2.0)


def test_places_follow_from_the_cell_and_the_seed_alone():
    assert cell_shots(cell(2.0), 3, 1) == cell_shots(cell(2.0), 5, 1)[:3]
    others = [cell(2.0, 15.0), cell(2.5), cell(2.0, world="docking_dots"), cell(2.0, light="dark")]
    draws = [(cell(2.0), 1), (cell(2.0), 2), *((other, 1) for other in others)]
    assert len({cell_shots(one, 1, seed)[0].number for one, seed in draws}) == 6


def test_strewn_places_are_all_over_the_world_but_not_in_its_walls():
    places = strewn_shots("docking_dots", 100, 1, 0)
    assert places == strewn_shots("docking_dots", 100, 1, 0)
    assert places != strewn_shots("docking_dots", 100, 1, 1)
    x, y, _ = np.array([view.pose.position for view in places]).T
    assert x.min() < -2.0 and x.max() > 3.0 and y.min() < -2.0 and y.max() > 2.0
    assert not ((x > 1.95) & (abs(y) > 0.45) & (abs(y) < 0.75)).any()


@cases("""
distance, degrees, world, reachable, visible:
  - [0.3, 0, docking, true, true]
  - [8.0, 0, docking, true, true]
  - [0.5, 45, docking, true, true]
  # Nearer to the side wall than a robot comes.
  - [1.0, 30, docking, false, true]
  # In the side wall, which no ray from there meets.
  - [2.0, 15, docking, false, true]
  - [4.0, 15, docking, true, false]
  - [8.0, 60, docking, true, false]
  - [4.0, 60, marker_panel, true, true]
  - [0.3, 0, marker_panel, true, true]
""")
def test_walls_are_in_the_way(distance, degrees, world, reachable, visible):
    place = cell(distance, degrees, world)
    assert is_reachable(place) is reachable
    camera, corners = FreeCamera(world), WORLDS[world][0].corners()
    eyes = [camera_pose(distance, sign * place.bearing).position for sign in (-1.0, 1.0)]
    assert [camera.sees(eye, corners) for eye in eyes] == [visible, visible]


def test_a_world_in_another_light_is_the_same_world():
    own, dark = lit_world("docking_dots", "default"), lit_world("docking_dots", "dark")
    assert dark.models is own.models
    assert (dark.lights, dark.ambient) != (own.lights, own.ambient)


@pytest.mark.parametrize("name", WORLDS)
def test_the_wanted_marker_and_the_others_are_where_the_pictures_have_them(name):
    markers = WORLDS[name]
    assert all(tuple(marker.middle)[:2] != (0.0, 0.0) for marker in markers)
    # In a picture, black and white are where the corners say: just inside and outside.
    camera = FreeCamera(name)
    pose = Pose.from_rpy((0.5, 0.4, 0.44), (0.0, 0.0, 0.0))
    picture = camera.take(pose, 0).astype(float)
    for marker in markers:
        border = marker.size / 16.0
        inside = replace(marker, size=marker.size - 2.0 * border).corners()
        outside = replace(marker, size=marker.size + 0.8 * border).corners()
        dark, light = (
            [picture[round(v), round(u)] for u, v in project(camera, pose, corners)]
            for corners in (inside, outside)
        )
        assert max(dark) + 30.0 < min(light), marker


def project(camera, pose, points):
    return camera.camera.project(in_optical_frame(pose, points))


def test_the_free_camera_is_that_of_the_robot():
    camera, pose = FreeCamera("marker_panel"), camera_pose(1.0, 0.0)
    assert (camera.camera.width, camera.camera.height) == (640, 480)
    assert camera.camera.fx == pytest.approx(502.3, abs=0.1)
    picture, again, other = (camera.take(pose, number) for number in (5, 5, 6))
    assert picture.shape == (480, 640) and picture.dtype == np.uint8
    assert np.array_equal(picture, again)
    assert 0.0 < np.abs(picture.astype(float) - other).mean() < 6.0
