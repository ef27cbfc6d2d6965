"""Which things throw shadows, and when; test_reference.py has where shadows lie."""

import math
from dataclasses import replace

import numpy as np
import pytest
from picture_worlds import CAMERA, picture_of, plate, simulation_of, thing, write_plate

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.rendering.renderer import Shot
from bullet_lab.simulation.world.description import Attenuation, Box, Cone, Inertia, Light, Plane

HALF = (0.5, 0.5, 0.5, 1.0)
SUN = Light("sun", "directional", Pose(), HALF, (0.8, 0.0, -0.6), casts_shadows=True)
FAR_REACHING = {"casts_shadows": True, "attenuation": Attenuation(range=50.0)}
LAMP = Light("lamp", "point", Pose((0.0, 0.0, 4.0)), HALF, **FAR_REACHING)
SPOT = Light("spot", "spot", Pose((-2.0, 0.0, 4.0)), HALF, cone=Cone(2.0, 2.8), **FAR_REACHING)
LIGHT = {"ambient": (0.25, 0.25, 0.25, 1.0), "lights": (SUN,)}
FLOOR = thing("floor", Plane())
# From 1 m above the floor on: no side of it is seen from above but the upper one.
BOX = thing("box", Box((0.4, 0.4, 0.4)), Pose((0.0, 0.0, 1.2)))
FAR = thing("far", Box((0.4, 0.4, 0.4)), Pose((90.0, 0.0, 60.0)))
HEAVY = Inertia(1.0, (0.0, 0.0, 0.0), np.eye(3))
ROBOT = replace(BOX, links=(replace(BOX.links[0], inertia=HEAVY),), static=False)
DOWN = Pose.from_rpy((0.0, 0.0, 5.0), (0.0, math.pi / 2, 0.0))


def take(*models, pose=DOWN, **light):
    return picture_of(*models, eye=pose, **{**LIGHT, **light})[..., 0].astype(int)


def at(picture, x, y):
    """The brightness of the floor at (x, y), seen from above with x up in the picture."""
    return picture[round(239.5 - CAMERA.fy * x / 5.0), round(319.5 - CAMERA.fx * y / 5.0)]


def extent(dark):
    """Least and greatest x and y of the floor where a picture from above is dark."""
    rows, columns = np.nonzero(dark)
    x, y = (239.5 - rows) * 5.0 / CAMERA.fy, (319.5 - columns) * 5.0 / CAMERA.fx
    return x.min(), x.max(), y.min(), y.max()


def box_with(**look):
    (link,) = BOX.links
    return replace(BOX, links=(replace(link, visuals=(replace(link.visuals[0], **look),)),))


@pytest.mark.parametrize(
    ("box", "light"),
    [
        (BOX, {"shadows": False}),
        (BOX, {"lights": (replace(SUN, casts_shadows=False),)}),
        (box_with(casts_shadows=False), {}),
        (box_with(colour=(1.0, 1.0, 1.0, 0.5)), {}),
    ],
)
def test_shadows_that_are_off(box, light):
    bare, seen, shaded = take(FLOOR)[:150], take(FLOOR, box, **light)[:150], take(FLOOR, BOX)[:150]
    assert np.array_equal(seen, bare)
    assert not np.array_equal(shaded, bare)


def test_a_picture_on_a_wall_lies_in_shadow_too(tmp_path):
    path = write_plate(tmp_path, "grey", np.full((64, 64), 160, np.uint8), 2.0, 2.0)
    wall = plate(path, Pose((2.0, 0.0, 1.0)))
    # It hides the light of the wall's left half, above and beside what is seen.
    blind = thing("blind", Box((0.02, 3.0, 3.0)), Pose((0.5, 1.5, 2.5)))
    row = take(wall, blind, pose=Pose((0.8, 0.0, 1.0)))[240]
    assert row[[300, 100]] == pytest.approx((160 * 0.25,) * 2, abs=2)
    assert row[[340, 540]] == pytest.approx((160 * (0.25 + 0.5 * 0.8),) * 2, abs=2)


@pytest.mark.parametrize(("light", "others"), [(SUN, [FAR]), (LAMP, []), (SPOT, []), (SPOT, [FAR])])
def test_where_nothing_throws_a_shadow_there_is_none(light, others):
    bare = take(FLOOR, lights=(replace(light, casts_shadows=False),))
    assert np.array_equal(take(FLOOR, *others, lights=(light,)), bare)


def test_a_floor_that_is_a_huge_box_leaves_shadows_sharp():
    slab = thing("floor", Box((400.0, 400.0, 1.0)), Pose((0.0, 0.0, -0.5)))
    seen = take(slab, BOX)
    dark = np.abs(seen - 0.25 * 255) < 3
    wanted = (4 / 3 - 0.2, 1.4 * 4 / 3 + 0.2, -0.2, 0.2)
    assert extent(dark) == pytest.approx(wanted, abs=0.02)
    assert at(seen, -1.0, 0.5) == pytest.approx(255 * (0.25 + 0.5 * 0.6), abs=2)


def test_more_lights_with_shadows_than_there_are_maps(caplog):
    lights = tuple(replace(SUN, name=f"sun{k}", diffuse=(0.05,) * 4) for k in range(12))
    seen = take(FLOOR, BOX, lights=lights)
    # Seven throw shadows, with a map for what stands still and one for what moves.
    assert at(seen, 1.6, 0.0) == pytest.approx(255 * (0.25 + 5 * 0.05 * 0.6), abs=2)
    assert at(seen, -1.0, 0.5) == pytest.approx(255 * (0.25 + 12 * 0.05 * 0.6), abs=2)
    assert caplog.text.count("casts no shadows; 15 maps are the limit") == 5


def look(simulation, pose=DOWN):
    return simulation.renderer().picture(pose, Shot(CAMERA)).tobytes()


def fresh(*models, pose=DOWN):
    return picture_of(*models, eye=pose, **LIGHT).tobytes()


@pytest.mark.parametrize("box", [BOX, ROBOT])
def test_a_shadow_goes_with_what_throws_it(box):
    moved = replace(box, pose=Pose((0.0, -1.0, 1.2)))
    other = replace(box, name="other", pose=Pose((0.0, 1.5, 1.2)))
    with simulation_of(FLOOR, box, **LIGHT) as simulation:
        assert look(simulation) == fresh(FLOOR, box) != fresh(FLOOR)
        simulation.models["box"].place(moved.pose)
        assert look(simulation) == fresh(FLOOR, moved)
        simulation.add(other)
        assert look(simulation) == fresh(FLOOR, moved, other)
        simulation.remove("other")
        assert look(simulation) == fresh(FLOOR, moved)
        simulation.remove("box")
        assert look(simulation) == fresh(FLOOR)


def test_shadows_do_not_depend_on_what_was_in_view_before():
    robot = replace(ROBOT, name="robot", pose=Pose((0.0, 4.0, 3.5)))
    post = thing("post", Box((0.3, 0.3, 0.8)), Pose((0.0, 0.0, 0.4)))
    other = thing("other", Box((0.4, 0.4, 0.4)), Pose((-9.0, 0.0, 1.2)))
    beside = Pose.from_rpy((3.0, 4.0, 5.0), (0.0, math.pi / 2, 0.0))
    models = [FLOOR, post, robot]
    with simulation_of(*models, **LIGHT) as simulation:
        # What moves is seen beside only, where its shadow is.
        for pose in (DOWN, beside, DOWN):
            assert look(simulation, pose) == fresh(*models, pose=pose)
        # What stands still changes while what moves is out of view.
        simulation.add(other)
        for pose in (DOWN, beside):
            assert look(simulation, pose) == fresh(*models, other, pose=pose)
