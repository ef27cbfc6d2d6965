import math
from dataclasses import replace

import pytest
import sensor_worlds
from contact_forces import pressures, strongest_place
from shared import cases

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


@cases("hidden: [collisions, visuals]")
def test_size(world, model, hidden):
    links = tuple(replace(link, **{hidden: ()}) for link in model.links)
    low, (x, y, z) = bounds(world.add(replace(model, links=links)))
    assert (*low, x, y) == pytest.approx((-0.20, -0.20, 0.0, 0.20, 0.20))
    assert 0.42 <= z <= 0.46


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
