from dataclasses import replace

import numpy as np
import pytest
from picture_worlds import CAMERA, checkers, plate, simulation_of, usable, write_plate
from test_rendering_geometry import errors_of_board

from bullet_lab.simulation.description import Mesh
from bullet_lab.simulation.pose import Pose
from bullet_lab.simulation.rendering.frame import Shot
from bullet_lab.simulation.rendering.surfaces import surfaces_of
from bullet_lab.simulation.rendering.texture_map import common_map
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.urdf_reader import read_urdf_file

AHEAD = Pose((0.0, 0.0, 0.5))
WORLDS = ("beacons", "docking", "docking_decoy", "docking_dots", "docking_nested", "marker_panel")


@pytest.fixture
def egl():
    return usable("egl")


def board(folder, name, squares=8, width=0.8):
    return write_plate(folder, name, checkers(squares, squares), width, width)


def surface(path, pose):
    (found,) = surfaces_of(Mesh(path, path.name))
    return found.moved(pose)


def pictures(models, renderers=("egl", "tiny"), pose=AHEAD, move=None):
    """What both renderers see, and whether EGL draws the fast way."""
    taken, fast = [], None
    for renderer in renderers:
        with simulation_of(*models, renderer=renderer) as simulation:
            photographer = simulation.photographer()
            if move is not None:
                photographer.take(pose, Shot(CAMERA))
                move(simulation)
            taken.append(photographer.take(pose, Shot(CAMERA)).astype(int))
            if renderer == "egl":
                fast = photographer._scene.texture_map is not None
    return taken, fast


def alike(one, other, mean=1.5):
    return np.abs(one - other).mean() < mean and (np.abs(one - other) > 100).mean() < 2e-3


@pytest.mark.parametrize("name", WORLDS)
def test_the_worlds_of_the_lab_are_drawn_fast(egl, name):
    with Simulation.of(f"package://bullet_lab/worlds/{name}.world", renderer=egl) as simulation:
        simulation.spawn("package://bullet_lab/urdf/camera_robot.urdf")
        photographer = simulation.photographer()
        photographer.take(AHEAD, Shot(CAMERA))
        assert photographer._scene.texture_map is not None


def test_a_single_picture_is_used_as_it_is(tmp_path):
    place = surface(board(tmp_path, "a"), Pose.from_rpy((3.0, 1.0, 0.5), (0.1, 0.2, 0.3)))
    found = common_map([place])
    here = np.column_stack((place.corners.reshape(-1, 3), np.ones(6))) @ found.matrix.T
    assert here == pytest.approx(place.picture.reshape(-1, 2), abs=1e-6)
    assert found.image(place) is place.texture


def test_pictures_on_parallel_planes(egl, tmp_path):
    turned = Pose.from_rpy((2.5, 0.6, 0.7), (0.4, 0.0, 0.0))
    models = [
        plate(board(tmp_path, "large", 10, 2.0), Pose((4.0, 0.0, 0.5))),
        plate(board(tmp_path, "small", 4, 0.5), Pose((3.0, -0.5, 0.4))),
        plate(board(tmp_path, "turned", 5, 0.4), turned),
    ]
    (one, other), fast = pictures(models)
    assert fast
    assert np.ptp(one) > 200
    assert alike(one, other)


def test_corners_on_a_plane_that_is_redrawn(egl, tmp_path):
    large = plate(board(tmp_path, "large", 10, 2.0), Pose((3.0, 2.0, 0.5)))
    offsets = errors_of_board(tmp_path, egl, [large])
    assert np.abs(offsets.mean(axis=0)).max() < 0.02
    assert np.hypot(*offsets.T).mean() < 0.1


@pytest.mark.parametrize("yaw", [0.5, 1.5])
def test_pictures_on_planes_across_each_other(egl, tmp_path, yaw):
    models = [
        plate(board(tmp_path, "a"), Pose((3.0, 0.5, 0.5))),
        plate(board(tmp_path, "b", 5), Pose.from_rpy((2.5, -0.4, 0.5), (0.0, 0.0, yaw))),
    ]
    (one, other), _ = pictures(models)
    assert np.ptp(one) > 200
    assert alike(one, other)


CART = """<robot name="cart"><link name="base">
  <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>
  <visual><geometry><mesh filename="a.obj"/></geometry></visual></link></robot>"""


@pytest.mark.parametrize("static", [True, False])
def test_a_picture_on_something_that_is_moved(egl, tmp_path, static):
    board(tmp_path, "a", 5)
    (tmp_path / "cart.urdf").write_text(CART)
    cart = replace(read_urdf_file(tmp_path / "cart.urdf"), pose=Pose((3, 0, 0.5)), static=static)

    def move(simulation):
        simulation.models["cart"].place(Pose.from_rpy((2.5, -0.33, 0.61), (0.2, 0.3, 0.4)))

    (one, other), fast = pictures([cart], move=move)
    assert fast is static
    assert np.ptp(one) > 200
    assert alike(one, other)


def test_pictures_that_come_later(egl, tmp_path):
    first = plate(board(tmp_path, "a"), Pose((3.0, 0.5, 0.5)))
    later = [
        plate(board(tmp_path, "b", 5, 1.6), Pose((3.5, -0.6, 0.5))),
        plate(board(tmp_path, "c", 3), Pose.from_rpy((2.0, -0.8, 0.5), (0, 0, np.pi / 2))),
    ]

    def move(simulation):
        for model in later:
            simulation.add(model)
            simulation.photographer().take(AHEAD, Shot(CAMERA))

    (one, other), fast = pictures([first], move=move)
    assert not fast
    assert alike(one, other)
    (one, other), fast = pictures([first], move=lambda simulation: simulation.add(later[0]))
    assert fast
    assert alike(one, other)


def test_a_picture_too_large_for_the_map(tmp_path):
    # On the scale of the large picture, the small one's would need too many pixels.
    large = surface(board(tmp_path, "large", 4, 50.0), Pose((9.0, 0.0, 0.0)))
    small = surface(board(tmp_path, "small", 4, 0.1), Pose((3.0, 0.0, 0.0)))
    assert common_map([large]) is not None
    assert common_map([large, small]) is None


def test_a_picture_over_several_periods_of_the_map(egl, tmp_path):
    tiled = board(tmp_path, "tiled", 4, 4.0)
    tiled.write_text(tiled.read_text().replace("vt 1 0", "vt 8 0").replace("vt 1 1", "vt 8 8"))
    tiled.write_text(tiled.read_text().replace("vt 0 1", "vt 0 8"))
    models = [
        plate(tiled, Pose((4.0, 0.0, 0.5))),
        plate(board(tmp_path, "over", 6, 1.2), Pose((3.0, -0.3, 0.5))),
    ]
    (one, other), fast = pictures(models)
    assert not fast
    # The many edges are smoothed in ways of their own.
    assert alike(one, other, mean=4.0)


def test_a_picture_that_is_bent_on_its_plane_has_no_map(tmp_path):
    path = board(tmp_path, "bent")
    path.write_text(path.read_text().replace("vt 1 1", "vt 0.8 0.6"))
    assert common_map([surface(path, AHEAD)]) is None
