import math
from dataclasses import replace

import numpy as np
import pytest
import sensor_worlds
from alike import assert_alike
from contact_forces import pressures, strongest_place

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.models import bounds
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import View, take_picture
from bullet_lab.simulation.world.urdf import read_urdf_file

CAMERA_ROBOT = "package://bullet_lab/urdf/camera_robot.urdf"
WHEEL_RADIUS, TORQUE = 0.14, 1.5
AHEAD = PlanarCommand(vx=0.2)
STOP = PlanarCommand()


@pytest.fixture
def robot(world):
    return world.spawn(CAMERA_ROBOT)


@pytest.fixture(scope="module")
def model(package):
    return read_urdf_file(package / "urdf" / "camera_robot.urdf")


def test_masses_and_inertias_are_those_of_the_parts(model):
    """Boxes, cylinders and a ball, each even: the base, the battery, the can, caster and camera."""
    base, *wheels = (link.inertia for link in model.links)
    matrix = ((0.142322941, 0, 0.025703686), (0, 0.174846557, 0), (0.025703686, 0, 0.169224866))
    assert base.mass == pytest.approx(8.85)
    assert base.centre == pytest.approx((0.057062147, 0.0, 0.165338983), abs=1e-6)
    assert base.matrix == pytest.approx(np.array(matrix), abs=2e-6)
    for wheel in wheels:
        assert wheel.mass == 0.5
        assert wheel.matrix == pytest.approx(np.diag((2.466667e-3, 4.9e-3, 2.466667e-3)), abs=1e-8)


@pytest.mark.parametrize("hidden", ["collisions", "visuals"])
def test_size(world, model, hidden):
    links = tuple(replace(link, **{hidden: ()}) for link in model.links)
    low, (x, y, z) = bounds(world.add(replace(model, links=links)))
    assert (*low, x, y) == pytest.approx((-0.20, -0.20, 0.0, 0.20, 0.20))
    assert 0.42 <= z <= 0.46


def test_frames(model):
    assert model.root_links()[0].name == "base_footprint"
    assert {parent for parent, _ in model.frames.values()} == {"base_footprint"}
    place = (0.16, 0.0, 0.44)
    assert_alike(Pose(place), model.frames["camera_link"][1], within=1e-9)
    # REP 103: z ahead, x to the right, y down.
    optical = Pose(place, (-0.5, 0.5, -0.5, 0.5))
    assert_alike(optical, model.frames["camera_optical_frame"][1], within=1e-9)


def test_tags(model):
    tags = {plugin.filename: plugin for plugin in model.plugins}
    drive, camera = (tags[f"libgazebo_ros_{kind}.so"] for kind in ("diff_drive", "camera"))
    told = ("wheelSeparation", "wheelDiameter", "wheelTorque", "updateRate")
    assert [float(drive.tags[tag]) for tag in told] == [0.38, 2 * WHEEL_RADIUS, TORQUE, 20.0]
    assert camera.link == "camera_link"
    told = ("cameraName", "imageTopicName", "cameraInfoTopicName", "frameName")
    assert [camera.tags[tag] for tag in told] == [
        "mycamera", "image_raw", "camera_info", "camera_optical_frame"
    ]  # fmt: skip
    sensor = camera.sensor
    assert sensor.get("type") == "camera"
    assert sensor.findtext("camera/image/format") == "R8G8B8"
    numbers = ("update_rate", "camera/image/width", "camera/image/height", "camera/horizontal_fov")
    assert [float(sensor.findtext(tag)) for tag in numbers] == pytest.approx(
        [30.0, 640.0, 480.0, math.radians(65.0)], abs=5e-6
    )
    # Where EGL's depth buffer of 16 bits still tells a marker from the wall behind it.
    assert float(sensor.findtext("camera/clip/near")) >= 0.1


def test_the_camera_does_not_see_its_own_robot(world, robot):
    # From nearer than its clipping plane, and with light from everywhere.
    eye, ahead = (0.16, 0.0, 0.44), (1.16, 0.0, 0.44)
    view = View(eye, ahead, near=0.001)
    seen = take_picture(world, view)
    everything = take_picture(world, replace(view, eye=(-1.0, 0.0, 0.44)))
    world.remove(robot.name)
    assert (take_picture(world, view) == seen).all()
    assert (take_picture(world, replace(view, eye=(-1.0, 0.0, 0.44))) != everything).any()


def test_it_does_not_nod(world, robot):
    for command in (PlanarCommand(vx=0.5), STOP, PlanarCommand(vx=-0.5), PlanarCommand(vx=0.5)):
        robot.command("cmd_vel", command)
        for _ in range(500):
            world.run_until(world.step + 1)
            roll, pitch, _ = robot.pose().rpy()
            # On its springs it leans by 0.014° under full torque.
            assert max(abs(roll), abs(pitch)) < math.radians(0.016)
            # Round wheels: it neither bumps nor sinks by more than its springs.
            assert abs(robot.pose().position[2]) < 6e-5


def test_it_pushes_a_kerb_with_the_torque_of_its_wheels(world, robot):
    world.add(sensor_worlds.box("0.2 4 0.1", "0.5 0 0.05 0 0 0", "kerb"))
    robot.command("cmd_vel", AHEAD)
    world.run_for(0.9)
    assert "kerb" not in world.contacts(robot.name)
    world.run_for(1.0)
    pressing = pressures(world, robot.name)["kerb"]
    assert pressing == pytest.approx(2 * TORQUE / WHEEL_RADIUS, rel=0.01)
    assert strongest_place(world, robot.name, "kerb")[0] == pytest.approx(0.4, abs=2e-3)
    assert robot.pose().position[0] == pytest.approx(0.2, abs=2e-3)
    robot.command("cmd_vel", PlanarCommand(vx=-0.2))
    world.run_for(0.5)
    assert world.contacts(robot.name) == {"ground_plane"}
