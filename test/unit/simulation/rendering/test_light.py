import math

import numpy as np
import pytest
from picture_worlds import CAMERA, plate, simulation_of, thing, write_plate

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.simulation.rendering.renderer import Shot
from bullet_lab.simulation.world.description import Attenuation, Box, Cone, Light

AHEAD = Pose((0.0, 0.0, 0.5))
BOX = thing("box", Box((1.0, 1.0, 1.0)), Pose((2.0, 0.0, 0.5)), (0.8, 0.4, 0.2, 1.0))
GREY = (0.25, 0.25, 0.25, 1.0)


def take(*models, pose=AHEAD, exposure=1.0, samples=1.0, **light):
    with simulation_of(*models, **light) as simulation:
        return simulation.renderer().picture(pose, Shot(CAMERA, samples=samples), exposure)


def middle(*models, **options):
    """The colour in the middle of the picture."""
    return take(*models, **options)[240, 320].astype(int)


def sun(direction, brightness=1.0):
    return Light("sun", "directional", Pose(), (brightness,) * 3 + (1.0,), direction)


def lamp(x, brightness=1.0, kind="point", **more):
    turned = Pose.from_rpy((x, 0.0, 0.5), (0.0, -math.pi / 2, 0.0))
    return Light("lamp", kind, turned, (brightness,) * 3 + (1.0,), **more)


def test_white_light_from_everywhere_leaves_colours_as_they_are():
    assert middle(BOX) == pytest.approx((204, 102, 51), abs=1)


@pytest.mark.parametrize("ambient", [0.5, 0.02])
def test_ambient_light(ambient):
    seen = middle(BOX, ambient=(ambient,) * 3 + (1.0,))
    assert seen == pytest.approx(ambient * np.array((204, 102, 51)), abs=1)


@pytest.mark.parametrize(
    ("direction", "cosine"),
    [((1.0, 0.0, 0.0), 1.0), ((0.6, 0.0, -0.8), 0.6), ((-1.0, 0, 0), 0.0), ((0, 0, -1.0), 0.0)],
)
def test_a_sun_by_the_cosine(direction, cosine):
    seen = middle(BOX, ambient=GREY, lights=(sun(direction, 0.7),))
    assert seen == pytest.approx((0.25 + 0.7 * cosine) * np.array((204, 102, 51)), abs=1.5)


def test_a_turned_box_is_lit_in_the_world():
    turned = thing("box", Box((1.0, 1.0, 1.0)), Pose.from_rpy((2.0, 0, 0.5), (0, 0, 0.5)))
    light = sun((1.0, 0.0, 0.0), 0.5)
    seen = middle(turned, ambient=GREY, lights=(light,))
    assert seen == pytest.approx((255 * (0.25 + 0.5 * math.cos(0.5)),) * 3, abs=1.5)


def test_suns_add_up_and_too_much_is_white():
    lights = (sun((1.0, 0.0, 0.0), 0.4), sun((0.8, 0.0, -0.6), 0.5))
    seen = middle(BOX, ambient=GREY, lights=lights)
    assert seen == pytest.approx((0.25 + 0.4 + 0.4) * np.array((204, 102, 51)), abs=2)
    glare = middle(BOX, ambient=GREY, lights=(sun((1.0, 0, 0), 3.0),))
    assert glare == pytest.approx((255, 255, 3.25 * 51), abs=3)


def test_a_lamp_fades_with_the_distance():
    fading = Attenuation(range=5.0, constant=0.5, linear=0.2, quadratic=0.3)
    # The box begins at x = 1.5.
    for x, wanted in ((0.5, 1.0), (-0.5, 1 / (0.5 + 0.4 + 1.2)), (-4.0, 0.0)):
        light = lamp(x, 0.6, attenuation=fading)
        seen = middle(BOX, ambient=GREY, lights=(light,))
        assert seen == pytest.approx((0.25 + 0.6 * wanted) * np.array((204, 102, 51)), abs=2.5)


def test_a_spot_has_an_edge():
    wall = thing("wall", Box((0.2, 6.0, 6.0)), Pose((2.1, 0.0, 0.5)))
    cone = Cone(inner=math.radians(20), outer=math.radians(30))
    steady = Attenuation(range=10.0)
    light = lamp(0.0, 0.7, kind="spot", cone=cone, attenuation=steady)
    row = take(wall, ambient=GREY, lights=(light,))[240, :, 0].astype(float)
    angles = np.degrees(np.arctan((np.arange(640) - 319.5) / CAMERA.fx))
    inside, outside = np.abs(angles) < 6, np.abs(angles) > 18
    lit = 255 * (0.25 + 0.7 * np.cos(np.radians(angles[inside])))
    assert row[inside] == pytest.approx(lit, abs=4)
    assert row[outside] == pytest.approx(np.full(outside.sum(), 64.0), abs=3)


def test_a_picture_on_a_plate_is_lit_too(tmp_path):
    path = write_plate(tmp_path, "grey", np.full((64, 64), 160, np.uint8), 1.0, 1.0)
    board = plate(path, Pose((1.5, 0.0, 0.5)))
    seen = middle(board, ambient=GREY, lights=(sun((0.8, 0.6, 0.0), 0.5),))
    assert seen == pytest.approx((160 * 0.65,) * 3, abs=2)


def test_exposure_scales_everything():
    options = {"ambient": GREY, "background": (0.5, 0.2, 0.1, 1.0)}
    for exposure in (0.5, 2.0, 3.0):
        picture = take(BOX, exposure=exposure, **options)
        assert picture[240, 320] == pytest.approx(
            np.minimum(255, exposure * 0.25 * np.array((204, 102, 51))), abs=2
        )
        sky = np.minimum(255, exposure * 255 * np.array((0.5, 0.2, 0.1)))
        assert picture[0, 0] == pytest.approx(sky, abs=1)


def test_robots_are_lit_from_above_whatever_their_heading():
    from bullet_lab.simulation.world.urdf import read_urdf

    text = """<robot name="cube"><link name="base">
      <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>
      <visual><geometry><box size="1 1 1"/></geometry></visual></link></robot>"""
    sunny = {"ambient": GREY, "lights": (sun((0.0, 0.0, -1.0), 0.5),)}
    above = Pose.from_rpy((2.0, 0.0, 3.0), (0.0, math.pi / 2, 0.0))
    with simulation_of(**sunny) as simulation:
        robot = simulation.add(read_urdf(text, "cube"), pose=Pose((2.0, 0.0, 0.5)))
        renderer = simulation.renderer()
        for yaw in (0.0, 1.0):
            robot.place(Pose.from_rpy((2.0, 0.0, 0.5), (0.0, 0.0, yaw)))
            top = renderer.picture(above, Shot(CAMERA))[240, 320]
            side = renderer.picture(AHEAD, Shot(CAMERA))[240, 320]
            assert top == pytest.approx((0.75 * 255,) * 3, abs=2)
            assert side == pytest.approx((0.25 * 255,) * 3, abs=2)


def test_standing_things_are_lit_where_they_are_put():
    light = sun((1.0, 0.0, 0.0), 0.5)
    with simulation_of(BOX, ambient=GREY, lights=(light,)) as simulation:
        renderer = simulation.renderer()
        levels = [renderer.picture(AHEAD, Shot(CAMERA))[240, 320, 0]]
        simulation.models["box"].place(Pose.from_rpy((2.0, 0.0, 0.5), (0.0, 0.0, 0.6)))
        levels.append(renderer.picture(AHEAD, Shot(CAMERA))[240, 320, 0])
    assert levels == pytest.approx([204 * 0.75, 204 * (0.25 + 0.5 * math.cos(0.6))], abs=2)


def test_lights_that_come_change_and_go_while_pictures_are_drawn():
    shot = Shot(CAMERA)
    wanted = {
        lights: take(BOX, ambient=GREY, lights=lights)
        for lights in ((), (sun((1.0, 0.0, 0.0), 0.5),), (sun((1.0, 0.0, 0.0), 0.2), lamp(0.0)))
    }
    none, one, two = wanted
    with simulation_of(BOX, ambient=GREY) as simulation:

        def seen():
            return simulation.renderer().picture(AHEAD, shot, 1.0)

        assert np.array_equal(seen(), wanted[none])
        simulation.set_light(one[0])
        assert np.array_equal(seen(), wanted[one])
        simulation.set_light(two[0])
        simulation.set_light(two[1])
        assert np.array_equal(seen(), wanted[two])
        simulation.remove_light("sun")
        simulation.remove_light("lamp")
        assert np.array_equal(seen(), wanted[none])
        with pytest.raises(LabError, match="not found"):
            simulation.remove_light("lamp")
