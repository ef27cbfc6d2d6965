"""The tricycle drive, on a tricycle written anew."""

import math
from dataclasses import replace

import pytest
from sensor_worlds import drive, record

from bullet_lab.simulation.world.urdf import read_urdf_file

LENGTH, RADIUS = 0.6, 0.1


@pytest.fixture
def tricycle(world, package):
    """Put the tricycle with some tags changed into the world."""
    model = read_urdf_file(package / "test/drives/tricycle.urdf")

    def add(**tags):
        (plugin,) = model.plugins
        robot = world.add(replace(model, plugins=(replace(plugin, tags={**plugin.tags, **tags}),)))
        world.run_for(0.2)
        return robot

    return add


def joint(robot, name):
    (body,) = robot.bodies.values()
    return body.joint_state(f"{name}_joint")


@pytest.mark.parametrize("source", ["encoder", "world"])
def test_it_drives_a_metre(world, tricycle, source):
    robot = tricycle(odometrySource=source)
    odometry = record(robot, "odom")
    driven = drive(world, robot, 4.0, 0.25)
    # The grip of the front wheel, with a third of the load, speeds it up.
    assert driven.position[:2] == pytest.approx((1.0, 0.0), abs=0.02)
    assert odometry[-1].pose.position[:2] == pytest.approx(driven.position[:2], abs=3e-3)
    assert odometry[-1].velocity.vx == pytest.approx(0.25, rel=0.02)
    assert (odometry[-1].frame, odometry[-1].child_frame) == ("odom", "base_link")
    assert odometry[-1].pose_variances == (1e-5, 1e-5, 1e12, 1e12, 1e12, 1e-3)


@pytest.mark.parametrize("angle", [-0.5, 0.2, 0.9])
def test_the_radius_of_the_circle_is_that_of_the_steering_angle(world, tricycle, angle):
    robot = tricycle()
    odometry = record(robot, "odom")
    driven = drive(world, robot, 3.0, 0.2, angle)
    x, y, _ = driven.position
    # The front wheel has the commanded speed; the middle of the rear axle is slower.
    radius = math.hypot(x, y) / (2.0 * math.sin(0.5 * driven.yaw))
    assert radius == pytest.approx(LENGTH / math.tan(angle), rel=0.02)
    assert radius * driven.yaw == pytest.approx(0.6 * math.cos(angle), rel=0.03)
    assert odometry[-1].pose.position[:2] == pytest.approx((x, y), abs=0.01)
    assert odometry[-1].pose.yaw == pytest.approx(driven.yaw, rel=0.03)


def test_the_steering_speed_and_its_tolerance(world, tricycle):
    robot = tricycle(steeringSpeed="0.5", steeringAngleTolerance="0.05")
    for seconds, angle, reached, within in (
        (0.4, 0.4, 0.2, 0.03),
        (1.0, 0.4, 0.4, 0.06),
        (4.0, 9.0, 0.5 * math.pi, 0.1),
    ):
        drive(world, robot, seconds, 0.0, angle)
        assert joint(robot, "steering").position == pytest.approx(reached, abs=within)


def test_acceleration_and_deceleration_of_the_wheel(world, tricycle):
    robot = tricycle(wheelAcceleration="2", wheelDeceleration="8")
    for seconds, speed, reached, within in (
        (0.5, 0.4, 1.0, 0.1),
        (2.0, 0.4, 4.0, 0.1),
        (0.25, 0.0, 2.0, 0.2),
    ):
        drive(world, robot, seconds, speed)
        assert joint(robot, "front_wheel").velocity == pytest.approx(reached, abs=within)


def test_all_four_joints_are_shown(world, tricycle):
    robot = tricycle(publishWheelJointState="true", publishWheelTF="true")
    states, transforms = record(robot, "joint_states"), record(robot, "/tf")
    drive(world, robot, 1.0, 0.2, 0.3)
    shown = dict(zip(states[-1].names, states[-1].positions))
    assert shown["steering_joint"] == pytest.approx(0.3, abs=0.01)
    assert shown["front_wheel_joint"] == pytest.approx(2.0, rel=0.05)
    wheels = {f"{side}_wheel_joint" for side in ("front", "left", "right")}
    assert shown.keys() == {"steering_joint", *wheels}
    children = {sample.child_frame for sample in transforms}
    assert children == {"base_link", "fork", "front_wheel", "left_wheel", "right_wheel"}
