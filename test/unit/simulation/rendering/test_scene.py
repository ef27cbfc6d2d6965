import itertools
import os
import subprocess
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
from heap import bytes_kept
from picture_worlds import CAMERA, checkers, plate, simulation_of, thing, write_plate
from shared import cases

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.simulation import rendering
from bullet_lab.simulation.rendering import RendererError, shared_graphics
from bullet_lab.simulation.rendering.renderer import Shot
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Box, Light, Plane

AHEAD = Pose((0.0, 0.0, 0.5))
BLUE = (0, 0, 255)
RED, GREEN = (1.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0)


def cube(name, colour, x=2.0):
    return thing(name, Box((0.5, 0.5, 0.5)), Pose((x, 0.0, 0.5)), colour)


def middle(simulation):
    return tuple(simulation.renderer().picture(AHEAD, Shot(CAMERA))[240, 320])


def test_physics_does_not_notice_the_pictures():
    ends = set()
    for looks in (0, 3):
        with Simulation.of("package://bullet_lab/worlds/docking.world") as simulation:
            robot = simulation.spawn("package://bullet_lab/urdf/camera_robot.urdf")
            for _ in range(10):
                simulation.run_for(0.05)
                for _ in range(looks):
                    simulation.renderer().picture(AHEAD, Shot(CAMERA))
            ends.add((robot.pose(), robot.bodies["base_footprint"].velocity()))
    assert len(ends) == 1


def board(folder, name="board"):
    return plate(write_plate(folder, name, checkers(8, 8), 1.0, 1.0), Pose((2.5, 0.3, 0.6)))


SUNNY = {
    "ambient": (0.3, 0.3, 0.3, 1.0),
    "lights": (Light("sun", "directional", Pose(), (0.6,) * 4, (0.6, 0.3, -0.7), True),),
}


def look(simulation, samples=1):
    return simulation.renderer().picture(AHEAD, Shot(CAMERA, samples=samples)).tobytes()


@cases("samples: [1, 4]")
def test_a_picture_does_not_depend_on_what_was_drawn_before(tmp_path, samples):
    models = (board(tmp_path), cube("a", RED, 2.0), thing("floor", Plane()))
    with simulation_of(*models, **SUNNY) as simulation:
        wanted = look(simulation, samples)
    for size in (64, 1280):
        shot = Shot(PinholeCamera(size, size, 300.0, 300.0, size / 2, size / 2))
        other = simulation_of(cube("b", GREEN), board(tmp_path, "other"), **SUNNY)
        beside = other.renderer().picture(AHEAD, shot)
        other.renderer().depths(AHEAD, shot)
        with simulation_of(*models, **SUNNY) as simulation:
            assert look(simulation, samples) == wanted
            assert np.array_equal(other.renderer().picture(AHEAD, shot), beside)
            other.close()
            # What came and went, or moved there and back, leaves nothing.
            simulation.add(cube("c", GREEN, 1.0))
            assert look(simulation, samples) != wanted
            simulation.remove("c")
            assert look(simulation, samples) == wanted
            simulation.models["a"].place(Pose((2.0, -0.5, 0.5)))
            assert look(simulation, samples) != wanted
            simulation.models["a"].place(simulation.models["a"].model.pose)
            assert look(simulation, samples) == wanted


def test_a_picture_stays_as_it_was_while_others_are_drawn():
    with simulation_of(cube("a", RED)) as simulation:
        kept = simulation.renderer().picture(AHEAD, Shot(CAMERA))
        copy = kept.copy()
        simulation.remove("a")
        simulation.renderer().picture(AHEAD, Shot(CAMERA))
        assert (kept == copy).all()


def test_any_thread_draws():
    with simulation_of(cube("a", RED)) as simulation:
        seen = [middle(simulation)]
        simulation.models["a"].place(Pose((2.0, 3.0, 0.5)))
        thread = threading.Thread(target=lambda: seen.append(middle(simulation)))
        thread.start()
        thread.join()
        simulation.reset_world()
        seen.append(middle(simulation))
    assert seen == [(255, 0, 0), BLUE, (255, 0, 0)]


@cases("alpha, seen: [[0.5, [128, 128, 0]], [0.0, [255, 0, 0]]]")
def test_glass_shows_what_is_behind_it_and_air_nothing(alpha, seen):
    with simulation_of(cube("pane", (0.0, 1.0, 0.0, alpha), 1.0), cube("a", RED)) as simulation:
        assert middle(simulation) == pytest.approx(seen, abs=1)


@cases("exposure: [0.5, 3.0]")
def test_exposure_scales_everything_up_to_white(exposure):
    colour, sky = np.array((0.8, 0.4, 0.2, 1.0)), np.array((0.5, 0.2, 0.1, 1.0))
    box = cube("box", tuple(colour))
    with simulation_of(box, ambient=(0.25,) * 4, background=tuple(sky)) as simulation:
        picture = simulation.renderer().picture(AHEAD, Shot(CAMERA), exposure)
    for seen, wanted in ((picture[240, 320], 0.25 * colour), (picture[0, 0], sky)):
        assert seen == pytest.approx(np.minimum(255, exposure * 255 * wanted[:3]), abs=1)


def test_lights_that_come_change_and_go_while_pictures_are_drawn():
    lamp, (sun,) = Light("lamp", "point", Pose((0.0, 0.0, 0.5))), SUNNY["lights"]
    with simulation_of(cube("a", RED)) as simulation:
        for lights in ([sun], [replace(sun, diffuse=(0.2,) * 4), lamp]):
            for light in lights:
                simulation.set_light(light)
            with simulation_of(cube("a", RED), lights=tuple(lights)) as fresh:
                assert look(simulation) == look(fresh)
        simulation.remove_light("sun")
        simulation.remove_light("lamp")
        with simulation_of(cube("a", RED)) as fresh:
            assert look(simulation) == look(fresh)
        with pytest.raises(LabError, match="not found"):
            simulation.remove_light("lamp")


def test_what_cannot_be_read_is_left_out_and_the_rest_is_drawn(tmp_path, caplog):
    path = write_plate(tmp_path, "p", checkers(2, 2), 0.5, 0.5)
    with simulation_of(cube("a", RED)) as simulation:
        simulation.add(plate(path, Pose((1.0, 0.0, 0.5))))
        path.write_text("v 0 0 x\n")
        assert [middle(simulation) for _ in range(3)] == [(255, 0, 0)] * 3
    (message,) = caplog.messages
    assert message.startswith("model 'p': link 'link' is not drawn completely: ")


def test_pictures_of_any_size_that_the_driver_has():
    with simulation_of(cube("a", RED)) as simulation:
        for width, height in ((1, 1), (4000, 3), (3, 4000), (2500, 2000)):
            camera = PinholeCamera(width, height, 3000.0, 3000.0, width / 2, height / 2)
            picture = simulation.renderer().picture(AHEAD, Shot(camera))
            assert picture.shape == (height, width, 3)
            assert tuple(picture[height // 2, width // 2]) == (255, 0, 0)
        camera = PinholeCamera(10**6, 2, 300.0, 300.0, 10.0, 1.0)
        with pytest.raises(RendererError, match="draws up to .* pixels along each side"):
            simulation.renderer().picture(AHEAD, Shot(camera))
        assert middle(simulation) == (255, 0, 0)


# What is gone leaves nothing behind


def test_pictures_and_shadow_maps_keep_no_bytes():
    # So many, since now and then another thread of the test's process keeps 1 or 2 kB.
    count = 400
    with simulation_of(cube("a", RED)) as simulation:
        assert bytes_kept(lambda: middle(simulation), count) < 10.0
    graphics = shared_graphics()
    assert bytes_kept(lambda: graphics.remove(graphics.shadow_target(64, (1, 1))), count) < 10.0


def test_buffers_and_shadow_maps_of_other_sizes_are_given_back():
    widths = itertools.count(800)
    with simulation_of(cube("a", RED), thing("floor", Plane()), **SUNNY) as simulation:

        def draw():
            camera = PinholeCamera(next(widths), 1000, 1000.0, 1000.0, 399.5, 499.5)
            simulation.renderer().picture(AHEAD, Shot(camera))
            # The shadow map grows from 256 to 4096 pixels along each side.
            simulation.add(cube("b", GREEN, 12.0))
            look(simulation)
            simulation.remove("b")

        # A buffer with its depths has 6 MB, a shadow map 64 MB.
        assert bytes_kept(draw, rendering.KEPT_BUFFERS) < 1e6


def test_textures_that_are_gone_are_given_back(tmp_path):
    random = np.random.default_rng(3)
    with simulation_of(cube("a", RED)) as simulation:

        def come_and_go():
            pixels = random.integers(0, 255, (200, 200, 3), dtype=np.uint8)
            path = write_plate(tmp_path, "panel", pixels, 1.0, 1.0)
            simulation.add(plate(path, Pose((2.0, 0.0, 0.5))))
            look(simulation)
            simulation.remove("panel")

        assert bytes_kept(come_and_go, 8) < 5e4


def test_a_driver_without_the_language_of_our_programs_is_refused(monkeypatch):
    monkeypatch.setattr(rendering, "GLSL", (9, 0))
    with pytest.raises(RendererError, match="has GLSL .*, 1.40 at least is needed"):
        rendering.Graphics()


def test_panda3d_is_loaded_for_the_first_picture_and_needs_a_driver():
    code = "import sys\nfrom bullet_lab.simulation.simulation import Simulation\n"
    code += "world = Simulation.of('package://bullet_lab/worlds/docking.world')\n"
    code += "world.spawn('package://bullet_lab/urdf/camera_robot.urdf'); world.run_for(0.1)\n"
    code += "print('panda3d' in sys.modules)\n"
    code += "from bullet_lab.simulation.rendering import driver_name, RendererError\n"
    code += "for _ in range(2):\n  try: driver_name()\n  except RendererError as e: print(e)"
    hidden = {"__EGL_VENDOR_LIBRARY_FILENAMES": os.devnull, "LIBGL_DRIVERS_PATH": os.devnull}
    path = os.pathsep.join(filter(None, sys.path))
    run = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **hidden, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    line = "pictures need EGL and a driver: on Debian, install libegl1 and libgl1-mesa-dri"
    assert (run.stdout.splitlines(), run.stderr) == (["False", line, line], "")
