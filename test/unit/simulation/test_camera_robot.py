import math
from dataclasses import replace

import numpy as np
import pytest
from contact_forces import pressures, strongest_place

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.physics import pybullet
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import View, take_picture
from bullet_lab.simulation.world.description import Box, Cylinder, Inertia, Sphere
from bullet_lab.simulation.world.sdf import read_spawned
from bullet_lab.simulation.world.tree import combine
from bullet_lab.simulation.world.urdf import read_urdf_file

CAMERA_ROBOT = "package://bullet_lab/urdf/camera_robot.urdf"
WHEEL_RADIUS, TRACK, TORQUE, G = 0.14, 0.38, 1.5, 9.8
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


def reach(shape):
    """How far a shape reaches to either side of its centre along the axes of its link."""
    turn = np.abs(shape.pose.rotation_matrix())
    if isinstance(shape.geometry, Sphere):
        return np.full(3, shape.geometry.radius)
    if isinstance(shape.geometry, Box):
        return turn @ np.array(shape.geometry.size) / 2
    radius, length = shape.geometry.radius, shape.geometry.length
    axis = turn[:, 2]
    return axis * length / 2 + radius * np.sqrt(np.clip(1 - axis**2, 0, None))


def extents(model, shapes):
    """Lowest and highest coordinates of the chosen shapes in the robot's frame."""
    ends = []
    for link in model.links:
        for shape in getattr(link, shapes):
            centre = np.array((link.pose * shape.pose).position)
            ends += [centre - reach(shape), centre + reach(shape)]
    return np.min(ends, axis=0), np.max(ends, axis=0)


def along_the_way(world, robot, seconds, call):
    """Return `call(robot)` after each step of a drive."""
    results = []
    for _ in range(round(1000 * seconds)):
        world.run_until(world.step + 1)
        results.append(call(robot))
    return np.array(results)


def test_masses_and_inertias_are_those_of_the_parts(model):
    at_base = Pose((0.0, 0.0, 0.20))
    body = [
        (box(4.4, 0.40, 0.36, 0.30), at_base),
        (box(4.0, 0.16, 0.24, 0.10), at_base * Pose((0.12, 0.0, -0.09))),
    ]
    others = [
        (cylinder(0.3, 0.145, 0.075), Pose((0.01, 0.0, 0.3875))),
        (Inertia(0.1, (0, 0, 0), 0.4 * 0.1 * 0.05**2 * np.eye(3)), Pose((0.15, 0.0, 0.05))),
        (box(0.05, 0.03, 0.03, 0.03), Pose((0.14, 0.0, 0.44))),
    ]
    expected = combine(body + others)
    root, left, right = model.links
    assert combine(body).mass == pytest.approx(8.4)
    assert root.inertia.mass == pytest.approx(expected.mass)
    assert root.inertia.centre == pytest.approx(expected.centre, abs=1e-6)
    assert root.inertia.matrix == pytest.approx(expected.matrix, abs=2e-6)
    wheel = cylinder(0.5, WHEEL_RADIUS, 0.02)
    for link in (left, right):
        assert link.inertia.mass == 0.5
        along_y = np.diag(wheel.matrix)[[0, 2, 1]]
        assert link.inertia.matrix == pytest.approx(np.diag(along_y), abs=1e-8)


@pytest.mark.parametrize("shapes", ["collisions", "visuals"])
def test_size(model, shapes):
    low, high = extents(model, shapes)
    assert low == pytest.approx((-0.20, -0.20, 0.0))
    assert high[:2] == pytest.approx((0.20, 0.20))
    assert 0.42 <= high[2] <= 0.46
    body = model.links[0].collisions[0]
    assert body.geometry == Box((0.40, 0.36, 0.30))
    left, right = model.links[1:]
    assert left.visuals[0].geometry == right.visuals[0].geometry == Cylinder(WHEEL_RADIUS, 0.02)
    assert left.pose.position == pytest.approx((0.0, TRACK / 2, WHEEL_RADIUS))
    assert right.pose.position == pytest.approx((0.0, -TRACK / 2, WHEEL_RADIUS))


def test_frames(model):
    assert model.root_links()[0].name == "base_footprint"
    assert {parent for parent, _ in model.frames.values()} == {"base_footprint"}
    camera = model.frames["camera_link"][1]
    assert camera.position == pytest.approx((0.16, 0.0, 0.44))
    assert camera.rotation_matrix() == pytest.approx(np.eye(3))
    optical = model.frames["camera_optical_frame"][1]
    assert optical.position == pytest.approx(camera.position)
    # REP 103: z ahead, x to the right, y down.
    assert optical.rotate((0, 0, 1)) == pytest.approx((1, 0, 0))
    assert optical.rotate((1, 0, 0)) == pytest.approx((0, -1, 0))
    assert optical.rotate((0, 1, 0)) == pytest.approx((0, 0, -1))


def test_camera_tags(model):
    (plugin,) = [p for p in model.plugins if p.filename == "libgazebo_ros_camera.so"]
    assert plugin.link == "camera_link"
    assert plugin.tags["cameraName"] == "mycamera"
    assert plugin.tags["imageTopicName"] == "image_raw"
    assert plugin.tags["cameraInfoTopicName"] == "camera_info"
    assert plugin.tags["frameName"] == "camera_optical_frame"
    sensor = plugin.sensor
    assert sensor.get("type") == "camera"
    assert float(sensor.findtext("update_rate")) == 30.0
    width = int(sensor.findtext("camera/image/width"))
    assert (width, int(sensor.findtext("camera/image/height"))) == (640, 480)
    assert sensor.findtext("camera/image/format") == "R8G8B8"
    angle = float(sensor.findtext("camera/horizontal_fov"))
    assert angle == pytest.approx(math.radians(65.0), abs=1e-9)
    assert width / (2 * math.tan(angle / 2)) == pytest.approx(502.3, abs=0.05)
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


def test_blue_body_green_wheels_red_camera(world, robot):
    picture = take_picture(world, View((-0.9, -0.9, 1.0), (0.0, 0.0, 0.2))).astype(int)
    # Floor and shadow are grey.
    shown = np.ptp(picture, axis=2) > 20
    brightest = picture.argmax(axis=2)[shown]
    counts = np.bincount(brightest, minlength=3)
    assert counts[2] > counts[1] > counts[0] > 0


def test_each_link_has_its_own_friction_and_nothing_is_damped(world, robot):
    (body,) = robot.bodies.values()
    infos = [pybullet.getDynamicsInfo(body.unique_id, link, world.client) for link in (-1, 0, 1)]
    # The ball rolls every way.
    assert [info[1] for info in infos] == [0.0, 1.0, 1.0]


def test_a_third_of_the_weight_rests_on_the_caster(world, robot):
    world.run_for(1.0)
    assert world.contacts(robot.name) == {"ground_plane"}
    weight = pressures(world, robot.name)["ground_plane"]
    assert weight == pytest.approx(9.85 * G, rel=1e-3)
    (body,) = robot.bodies.values()
    loads = {}
    for point in body.near_points():
        loads[point[3]] = loads.get(point[3], 0.0) + point[9]
    assert loads[-1] / weight == pytest.approx(1 / 3, abs=0.02)
    assert loads[0] == pytest.approx(loads[1], rel=0.01)


def test_two_metres_straight_ahead(world, robot):
    robot.command("cmd_vel", AHEAD)
    world.run_for(10.0)
    x, y, _ = robot.pose().position
    # Late by one period of 0.05 s, and by the time to speed up with the torque of both wheels.
    mass = 9.85 + 2 * 4.9e-3 / WHEEL_RADIUS**2
    speeding_up = 0.2 / (2 * TORQUE / WHEEL_RADIUS / mass)
    assert x == pytest.approx(0.2 * (9.95 - speeding_up / 2), abs=1e-3)
    assert abs(y) < 2e-3
    assert abs(math.degrees(robot.pose().yaw)) < 0.1


@pytest.mark.parametrize("speed", [0.3, -0.3, 1.0, -1.0])
def test_a_quarter_turn_on_the_spot(world, robot, speed):
    robot.command("cmd_vel", PlanarCommand(wz=speed))
    ticks = round(math.pi / 2 / abs(speed) / 0.05)
    world.run_for(0.05 * ticks)
    robot.command("cmd_vel", STOP)
    world.run_for(1.0)
    assert robot.pose().yaw == pytest.approx(0.05 * ticks * speed, rel=0.01)
    x, y, _ = robot.pose().position
    assert math.hypot(x, y) < 5e-4


@pytest.mark.parametrize(
    "command", [STOP, AHEAD, PlanarCommand(vx=-0.5), PlanarCommand(vx=0.1, wz=0.7)]
)
def test_it_really_stands_still_afterwards(world, robot, command):
    robot.command("cmd_vel", command)
    world.run_for(1.0)
    robot.command("cmd_vel", STOP)
    world.run_for(0.5)
    before = robot.pose()
    world.run_for(10.0)
    after = robot.pose()
    assert math.dist(before.position, after.position) < 1e-6
    assert abs(math.degrees(after.yaw - before.yaw)) < 1e-4


@pytest.mark.parametrize("speed", [0.5, -0.5])
def test_it_does_not_nod(world, robot, speed):
    for command in (PlanarCommand(vx=speed), STOP, PlanarCommand(vx=speed), PlanarCommand(-speed)):
        robot.command("cmd_vel", command)
        poses = along_the_way(
            world, robot, 0.5, lambda r: (*r.pose().rpy()[:2], r.pose().position[2])
        )
        assert np.abs(np.degrees(poses[:, :2])).max() < 0.005
        # Round wheels: it neither bumps nor sinks.
        assert np.abs(poses[:, 2]).max() < 5e-5


def test_it_pushes_a_kerb_with_the_torque_of_its_wheels(world, robot):
    world.add(
        read_spawned(
            '<sdf><model name="kerb"><static>true</static><pose>0.5 0 0.05 0 0 0</pose>'
            '<link name="l"><collision name="c"><geometry><box><size>0.2 4 0.1</size></box>'
            "</geometry></collision></link></model></sdf>",
            "kerb",
        )
    )
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
