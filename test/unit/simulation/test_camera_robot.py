import math
from dataclasses import replace

import numpy as np
import pytest
import sensor_worlds
from contact_forces import pressures, strongest_place

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.models import bounds
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import View, take_picture
from bullet_lab.simulation.world.description import Inertia
from bullet_lab.simulation.world.tree import combine
from bullet_lab.simulation.world.urdf import read_urdf_file

CAMERA_ROBOT = "package://bullet_lab/urdf/camera_robot.urdf"
WHEEL_RADIUS, TRACK, TORQUE = 0.14, 0.38, 1.5
AHEAD = PlanarCommand(vx=0.2)
STOP = PlanarCommand()


@pytest.fixture
def robot(world):
    return world.spawn(CAMERA_ROBOT)


@pytest.fixture(scope="module")
def model(package):
    return read_urdf_file(package / "urdf" / "camera_robot.urdf")


def box(mass, x, y, z):
    return Inertia(
        mass, (0, 0, 0), mass / 12 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
    )


def cylinder(mass, radius, length):
    """A cylinder along z."""
    across = mass * (3 * radius**2 + length**2) / 12
    return Inertia(mass, (0, 0, 0), np.diag([across, across, mass * radius**2 / 2]))


def test_masses_and_inertias_are_those_of_the_parts(model):
    at_base = Pose((0.0, 0.0, 0.20))
    parts = [
        (box(4.4, 0.40, 0.36, 0.30), at_base),
        (box(4.0, 0.16, 0.24, 0.10), at_base * Pose((0.12, 0.0, -0.09))),
        (cylinder(0.3, 0.145, 0.075), Pose((0.01, 0.0, 0.3875))),
        (Inertia(0.1, (0, 0, 0), 0.4 * 0.1 * 0.05**2 * np.eye(3)), Pose((0.15, 0.0, 0.05))),
        (box(0.05, 0.03, 0.03, 0.03), Pose((0.14, 0.0, 0.44))),
    ]
    expected, root = combine(parts), model.links[0].inertia
    assert root.mass == pytest.approx(expected.mass)
    assert root.centre == pytest.approx(expected.centre, abs=1e-6)
    assert root.matrix == pytest.approx(expected.matrix, abs=2e-6)
    along_y = np.diag(cylinder(0.5, WHEEL_RADIUS, 0.02).matrix)[[0, 2, 1]]
    for link in model.links[1:]:
        assert link.inertia.mass == 0.5
        assert link.inertia.matrix == pytest.approx(np.diag(along_y), abs=1e-8)


@pytest.mark.parametrize("hidden", ["collisions", "visuals"])
def test_size(world, model, hidden):
    links = tuple(replace(link, **{hidden: ()}) for link in model.links)
    low, high = bounds(world.add(replace(model, links=links)))
    assert low == pytest.approx((-0.20, -0.20, 0.0))
    assert high[:2] == pytest.approx((0.20, 0.20))
    assert 0.42 <= high[2] <= 0.46


def test_frames(model):
    assert model.root_links()[0].name == "base_footprint"
    assert {parent for parent, _ in model.frames.values()} == {"base_footprint"}
    camera = model.frames["camera_link"][1]
    assert camera.position == pytest.approx((0.16, 0.0, 0.44))
    assert camera.rotation_matrix() == pytest.approx(np.eye(3))
    optical = model.frames["camera_optical_frame"][1]
    assert optical.position == pytest.approx(camera.position)
    # REP 103: z ahead, x to the right, y down.
    assert optical.rotation_matrix() == pytest.approx(
        np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]), abs=1e-9
    )


def test_drive_tags(model):
    (plugin,) = [p for p in model.plugins if p.filename == "libgazebo_ros_diff_drive.so"]
    told = ("wheelSeparation", "wheelDiameter", "wheelTorque", "updateRate")
    assert [float(plugin.tags[tag]) for tag in told] == [TRACK, 2 * WHEEL_RADIUS, TORQUE, 20.0]


def test_camera_tags(model):
    (plugin,) = [p for p in model.plugins if p.filename == "libgazebo_ros_camera.so"]
    assert plugin.link == "camera_link"
    told = ("cameraName", "imageTopicName", "cameraInfoTopicName", "frameName")
    assert [plugin.tags[tag] for tag in told] == [
        "mycamera", "image_raw", "camera_info", "camera_optical_frame"
    ]  # fmt: skip
    sensor = plugin.sensor
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
