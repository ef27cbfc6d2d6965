"""Ambient light, exposure and lights that change; test_reference.py has each kind of light."""

import numpy as np
import pytest
from picture_worlds import CAMERA, simulation_of, thing

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.simulation.rendering.renderer import Shot
from bullet_lab.simulation.world.description import Box, Light

AHEAD = Pose((0.0, 0.0, 0.5))
BOX = thing("box", Box((1.0, 1.0, 1.0)), Pose((2.0, 0.0, 0.5)), (0.8, 0.4, 0.2, 1.0))
GREY = (0.25, 0.25, 0.25, 1.0)


def take(exposure=1.0, **light):
    with simulation_of(BOX, **light) as simulation:
        return simulation.renderer().picture(AHEAD, Shot(CAMERA), exposure)


def sun(brightness):
    colour = (brightness,) * 3 + (1.0,)
    return Light("sun", "directional", Pose(), colour, (1.0, 0.0, 0.0), casts_shadows=True)


@pytest.mark.parametrize("ambient", [1.0, 0.02])
def test_ambient_light(ambient):
    seen = take(ambient=(ambient,) * 3 + (1.0,))[240, 320]
    assert seen == pytest.approx(ambient * np.array((204, 102, 51)), abs=1)


def test_too_much_light_is_white():
    seen = take(ambient=GREY, lights=(sun(3.0),))[240, 320]
    assert seen == pytest.approx((255, 255, 3.25 * 51), abs=3)


def test_exposure_scales_everything():
    options = {"ambient": GREY, "background": (0.5, 0.2, 0.1, 1.0)}
    for exposure in (0.5, 3.0):
        picture = take(exposure, **options)
        assert picture[240, 320] == pytest.approx(
            np.minimum(255, exposure * 0.25 * np.array((204, 102, 51))), abs=2
        )
        sky = np.minimum(255, exposure * 255 * np.array((0.5, 0.2, 0.1)))
        assert picture[0, 0] == pytest.approx(sky, abs=1)


def test_lights_that_come_change_and_go_while_pictures_are_drawn():
    lamp = Light("lamp", "point", Pose((0.0, 0.0, 0.5)))
    with simulation_of(BOX, ambient=GREY) as simulation:

        def is_lit_by(*lights):
            seen = simulation.renderer().picture(AHEAD, Shot(CAMERA))
            return np.array_equal(seen, take(ambient=GREY, lights=lights))

        assert is_lit_by()
        for lights in ([sun(0.5)], [sun(0.2), lamp]):
            for light in lights:
                simulation.set_light(light)
            assert is_lit_by(*lights)
        simulation.remove_light("sun")
        simulation.remove_light("lamp")
        assert is_lit_by()
        with pytest.raises(LabError, match="not found"):
            simulation.remove_light("lamp")
