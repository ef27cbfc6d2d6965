import math
from dataclasses import replace

import numpy as np
import pytest
from sensor_worlds import box, drive, record, steps

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.physics import pybullet
from bullet_lab.simulation.plugins import PluginError
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.plugins.wheel_drives import DeadReckoning
from bullet_lab.simulation.world.description import PluginTag
from bullet_lab.simulation.world.urdf import read_urdf_file

FILENAME = "libgazebo_ros_diff_drive.so"
RADIUS, TRACK, MASS, WHEEL_MOMENT, G = 0.14, 0.38, 9.85, 4.9e-3, 9.8
# What a force has to move ahead: the robot, and both wheels' rotation.
ROLLING_MASS = MASS + 2.0 * WHEEL_MOMENT / RADIUS**2
TORQUE = 1.5
ACCELERATION = 2.0 * TORQUE / RADIUS / ROLLING_MASS
TAGS = {
    "leftJoint": "left_wheel_joint",
    "rightJoint": "right_wheel_joint",
    "wheelSeparation": str(TRACK),
    "wheelDiameter": str(2 * RADIUS),
    "wheelTorque": str(TORQUE),
    "updateRate": "20",
}


@pytest.fixture(scope="module")
def model(package):
    return read_urdf_file(package / "urdf" / "camera_robot.urdf")


@pytest.fixture
def spawn(world, model):
    """Put the camera robot into the world, with a diff_drive of the given tags and no more."""

    def add(pose=Pose(), links=model.links, file=FILENAME, **tags):  # noqa: B008
        plugin = PluginTag(file, "drive", {**TAGS, **tags})
        return world.add(replace(model, plugins=(plugin,), links=links), pose=pose)

    return add


def speeds(robot):
    """Speeds at the rims of the left and right wheel, m/s."""
    (body,) = robot.bodies.values()
    return np.array([RADIUS * body.joint_state(name).velocity for name in body.joint_names])


def way(speed, seconds):
    """How far the robot gets from rest, speeding up as its torque lets it."""
    return speed * (seconds - speed / ACCELERATION / 2)


# What it drives


def on_a_slope(world, spawn, torque):
    """Return a robot that 9.85 N have pulled ahead for 1.2 s, and where it was after 0.2 s."""
    robot = spawn(wheelTorque=torque)
    pybullet.setGravity(1.0, 0.0, -G, world.client)
    world.run_for(0.2)
    before = robot.pose().position[0]
    world.run_for(1.0)
    return robot, before


def test_a_brake_holds(world, spawn):
    robot, before = on_a_slope(world, spawn, str(TORQUE))
    assert robot.pose().position[0] == pytest.approx(before, abs=1e-5)


def test_a_brake_holds_no_more_than_its_torque(world, spawn):
    robot, before = on_a_slope(world, spawn, "0.05")
    rolled = robot.pose().position[0] - before
    acceleration = (MASS - 2 * 0.05 / RADIUS) / ROLLING_MASS
    # Since the first step.
    assert rolled == pytest.approx(0.5 * acceleration * (1.2**2 - 0.2**2), rel=0.01)
    # It stops where it is when nothing pushes any more, and does not come back.
    pybullet.setGravity(0.0, 0.0, -G, world.client)
    moving = speeds(robot)[0]
    braking = 2 * 0.05 / RADIUS / ROLLING_MASS
    world.run_for(moving / braking + 0.2)
    stopped = robot.pose().position[0]
    assert stopped == pytest.approx(before + rolled + moving**2 / braking / 2, rel=0.02)
    world.run_for(0.3)
    assert robot.pose().position[0] == pytest.approx(stopped, abs=1e-5)


def test_encoders_count_what_slips_on_a_slippery_floor(world, spawn, model):
    grip = 0.02
    links = tuple(
        replace(link, collisions=tuple(replace(shape, friction=grip) for shape in link.collisions))
        if link.name.endswith("wheel")
        else link
        for link in model.links
    )
    robot = spawn(links=links, odometrySource="encoder")
    samples = record(robot, "odom")
    drive(world, robot, 1.0, vx=-1.0)
    # The wheels spin at 1 m/s at once; the floor moves the robot by friction at two thirds of
    # its weight.
    acceleration = grip * (2 / 3) * G
    true = 0.5 * acceleration * 0.95**2
    assert robot.pose().position[0] == pytest.approx(-true, rel=0.05)
    assert samples[-1].pose.position[0] == pytest.approx(-0.95, abs=0.02)
    assert samples[-1].velocity.vx == pytest.approx(-1.0, abs=0.01)


def test_encoders_start_where_the_robot_starts_and_notice_no_lift(world, spawn):
    robot = spawn(Pose((3.0, 0.0, 0.0)), odometrySource="encoder")
    samples = record(robot, "odom")
    drive(world, robot, 1.0, vx=0.2)
    before = samples[-1].pose.position[0]
    robot.place(Pose((-1.0, 4.0, 0.0)))
    # The command is still in force.
    world.run_for(1.0)
    expected = (before + way(0.2, 0.95), 0.0, 0.0)
    assert samples[-1].pose.position == pytest.approx(expected, abs=2e-3)
    world.reset_world()
    world.run_for(0.1)
    assert samples[-1].pose.position == pytest.approx((0, 0, 0), abs=1e-4)


def test_dead_reckoning_is_exact_for_arcs():
    v, w, dt = 0.4, 1.3, 0.5
    reckoning = DeadReckoning(TRACK, RADIUS)
    left, right = ((v - w * TRACK / 2) * dt / RADIUS, (v + w * TRACK / 2) * dt / RADIUS)
    for number in range(1, 9):
        assert reckoning.advance(number * left, number * right) == pytest.approx((v * dt, w * dt))
        yaw = number * w * dt
        x, y = v / w * math.sin(yaw), v / w * (1.0 - math.cos(yaw))
        assert reckoning.pose == pytest.approx((x, y, math.remainder(yaw, math.tau)), abs=1e-12)
    # The other way the whole arc at once.
    assert reckoning.advance(0.0, 0.0) == pytest.approx((-8 * v * dt, -8 * w * dt))
    assert reckoning.pose == pytest.approx((0, 0, 0), abs=1e-12)


# What it refuses


def test_commands_that_are_not_finite_are_refused(spawn):
    robot = spawn()
    for bad in (PlanarCommand(vx=math.nan), PlanarCommand(wz=1e300)):
        with pytest.raises(PluginError, match="is not finite"):
            robot.command("cmd_vel", bad)


@pytest.mark.parametrize("file", [FILENAME, "libcreate_diff_drive.so"])
def test_commands_act_at_the_next_update_and_are_latched(world, spawn, file):
    robot = spawn(file=file)
    world.run_until(51)
    robot.command("cmd_vel", PlanarCommand(vx=0.2))
    world.run_until(100)
    assert speeds(robot) == pytest.approx((0, 0), abs=1e-4)
    world.run_until(110)
    # By its own speed: the wheels' includes how the body leans back on its springs.
    (body,) = robot.bodies.values()
    assert body.velocity()[0][0] == pytest.approx(ACCELERATION * 0.01, rel=0.01)
    world.run_until(3000)
    assert speeds(robot) == pytest.approx((0.2, 0.2), abs=1e-3)
    assert robot.pose().position[0] == pytest.approx(way(0.2, 2.9), abs=1e-3)


def test_the_defaults_are_gazebos(world, model):
    renamed = {"left_wheel_joint": "left_joint", "right_wheel_joint": "right_joint"}
    joints = tuple(replace(joint, name=renamed[joint.name]) for joint in model.joints)
    robot = world.add(replace(model, joints=joints, plugins=(PluginTag(FILENAME, "drive", {}),)))
    samples = record(robot, "odom")
    assert [output.topic for output in robot.plugins[0].outputs] == ["odom", "/tf"]
    robot.command("cmd_vel", PlanarCommand(vx=0.15, wz=0.5))
    world.run_until(11)
    (body,) = robot.bodies.values()
    assert body.joint_state("right_joint").effort == pytest.approx(5.0)
    world.run_until(1000)
    assert steps(samples) == list(range(10, 1001, 10))
    assert (samples[0].frame, samples[0].child_frame) == ("odom", "base_footprint")
    # Separation 0.34 m, diameter 0.15 m; its real wheels are larger.
    expected = np.array([0.15 - 0.5 * 0.17, 0.15 + 0.5 * 0.17]) * RADIUS / 0.075
    assert speeds(robot) == pytest.approx(expected, rel=5e-3)


def test_odometry_of_the_world(world, spawn):
    world.add(box("4 4 0.2", "5 5 0.1 0 0 0"))
    robot = spawn(Pose.from_rpy((5.0, 5.0, 0.2), (0.0, 0.0, math.pi / 2)))
    samples = record(robot, "odom")
    drive(world, robot, 2.0, vx=0.2, wz=0.4)
    last = samples[-1]
    assert last.pose == robot.pose()
    assert robot.plugins[0].origin == Pose()
    assert last.pose.position[2] == pytest.approx(0.2, abs=1e-4)
    # Of the base frame's origin; the centre of mass, 5 cm ahead of it, moves sideways as well.
    assert (last.velocity.vx, last.velocity.vy) == pytest.approx((0.2, 0.0), abs=5e-4)
    assert last.velocity.wz == pytest.approx(0.4, abs=1e-3)
    assert last.pose_variances == (1e-5, 1e-5, 1e12, 1e12, 1e12, 1e-3)


def test_encoders_agree_with_the_world_where_nothing_slips(world, spawn):
    start = Pose.from_rpy((1.0, 2.0, 0.0), (0.0, 0.0, 0.7))
    robot = spawn(start, odometrySource="encoder")
    samples, transforms = record(robot, "odom"), record(robot, "/tf")
    # Reverse reads negative.
    for v, w in ((0.3, 0.2), (-0.2, 0.5), (0.0, -1.0)):
        drive(world, robot, 1.0, v, w)
        last = samples[-1]
        assert (transforms[-1].step, transforms[-1].pose) == (last.step, last.pose)
        driven = robot.plugins[0].origin.inverse() * robot.pose()
        assert last.pose.position[:2] == pytest.approx(driven.position[:2], abs=3e-3)
        assert last.pose.position[2] == 0.0
        assert last.pose.yaw == pytest.approx(driven.yaw, abs=4e-3)
        assert last.velocity.vx == pytest.approx(v, abs=2e-3)
        assert (last.velocity.vy, last.velocity.wz) == pytest.approx((0, w), abs=5e-3)
