"""Tests of walls and sight, against the stand-in's own arithmetic."""

import math
from dataclasses import replace
from pathlib import Path

import docking_standin as standin
import numpy as np
import pytest
from alike import assert_as_before, lines_of
from shared import cases

from bullet_lab.core import se2
from bullet_lab.docking.geometry import (
    MarkerVisibility,
    Viewpoint,
    clearance,
    corner_points,
    extent_of_walls,
    misfit,
    wall_boxes,
    whole_in_image,
)

STAND = standin.Stand((0.0, 0.0, 0.0), pixel_noise=0.0, dropout=0.0, tilt=0.0)
DOCK = standin.make_dock(STAND)
BOXES = wall_boxes(DOCK)
VISIBILITY = MarkerVisibility(DOCK, standin.CAMERA, standin.MOUNT.z).up_to(4.5, 0.0)


def test_sight_is_never_promised_where_there_is_none():
    rng = np.random.default_rng(4)
    places = rng.uniform((-6.0, -3.0, -1.2), (-0.2, 3.0, 1.2), (3000, 3))
    promised = [place for place in places if VISIBILITY.visible(place)]
    assert len(promised) > 100
    for robot in se2.compose(np.array(promised), (-standin.MOUNT.x, 0.0, 0.0)):
        assert standin.see_print(robot, standin.Print(), STAND, rng) is not None


PLACES = np.random.default_rng(5).uniform((-5.0, -1.5, -0.8), (0.5, 1.5, 0.8), (300, 3))
DISTANCES = np.linspace(0.2, 1.2, 101)


def test_walls_and_sight_are_as_before():
    mount = replace(standin.MOUNT, y=0.05, roll=0.1, pitch=-0.2, yaw=0.3)
    view = Viewpoint(standin.CAMERA, mount, (0.3, -0.2, 0.4))
    corners = corner_points(np.array([2.0, 0.3, 0.2, 0.6, 0.1]), 0.3)
    pixels = view.pixels(view.optical(corners))
    found = {"seen": (pixels, view.origin, view.line_of_sight(pixels, 0.3))}
    aside, above = replace(standin.CAMERA, cx=219.5), replace(standin.CAMERA, cy=339.5)
    for walls, camera in ((True, standin.CAMERA), (False, aside), (False, above)):
        dock = standin.make_dock(replace(STAND, walls=walls))
        sight = MarkerVisibility(dock, camera, 0.3)
        boxes, farther = wall_boxes(dock), sight.up_to(6.0, 0.4)
        found[f"{walls} {camera.cx}"] = {
            "boxes": (boxes, [extent_of_walls(boxes), sight.farthest]),
            "clear": clearance(PLACES[:, :2], boxes),
            "sight": (sight.visible(PLACES), sight.found(PLACES, 0.5), farther.visible(PLACES)),
            "angle": (sight.half_angle(-PLACES[:, 0]), farther.half_angle(-PLACES[:, 0])),
            "whole": whole_in_image(dock, camera, replace(mount, yaw=0.0), DISTANCES),
        }
    assert_as_before(lines_of(found, ""), Path(__file__).with_name("sight.txt"))


@cases("""
marker, mount, wanted, said:
  - [{}, {}, 0.40, null]
  # Its upper edge, 0.16 m above the camera, is 233.5 px above the middle of the image;
  # the camera is level, and turned down by 3 degrees.
  - [{}, {}, 0.20, 0.34918843683083517]
  - [{}, {pitch: 0.05235987755982989}, 0.40, 0.402372883559784]
  - [{size: 0.05}, {}, 2.0, 1.395]
  - [{height: 3.0}, {}, 0.40, .nan]
""")
def test_a_docked_robot_has_to_see_the_whole_marker(marker, mount, wanted, said):
    mount = replace(standin.MOUNT, **mount)
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
