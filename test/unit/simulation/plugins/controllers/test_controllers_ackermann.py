"""ackermann_steering_controller on a car written anew."""

import math

import pytest
from control_robots import CAR, listen, run, spawn_car
from shared import cases

from bullet_lab.simulation.plugins.samples import PlanarCommand

LENGTH = 0.6


@pytest.fixture
def car(world):
    """The car, and the manager of its controllers."""
    return spawn_car(world)


def drive(world, car, vx, angle, seconds, **parameters):
    """Return the robot's motion and the odometry after a drive."""
    robot, manager = car
    controller = run(manager, "drive", **{**CAR, "cmd_vel_timeout": 60.0, **parameters})
    samples = listen(controller.odometry)
    world.run_for(0.5)
    start = robot.pose()
    controller.command(PlanarCommand(vx=vx, wz=angle))
    world.run_for(seconds)
    return start.inverse() * robot.pose(), samples[-1]


@cases("""
kind:
  - ackermann_steering_controller/AckermannSteeringController
  - steer_drive_controller/SteerDriveController
""")
def test_it_drives_a_metre(world, car, kind):
    driven, told = drive(world, car, 0.25, 0.0, 4.0, type=kind)
    assert driven.position[:2] == pytest.approx((1.0, 0.0), abs=0.01)
    assert told.pose.position[:2] == pytest.approx(driven.position[:2], abs=2e-3)
    assert told.velocity.vx == pytest.approx(0.25, rel=0.01)
    assert (told.frame, told.child_frame) == ("odom", "base_link")
    assert told.pose_variances == (0.001, 0.001, 1e6, 1e6, 1e6, 0.03)


@cases("angle: [-0.5, 0.2, 0.9]")
def test_the_radius_of_the_circle_is_that_of_the_steering_angle(world, car, angle):
    driven, told = drive(world, car, 0.2, angle, 3.0)
    x, y, _ = driven.position
    # The chord of an arc whose tangent has turned by the yaw.
    radius = math.hypot(x, y) / (2.0 * math.sin(0.5 * driven.yaw))
    assert radius == pytest.approx(LENGTH / math.tan(angle), rel=0.02)
    assert told.pose.position[:2] == pytest.approx((x, y), abs=0.01)
    assert told.pose.yaw == pytest.approx(driven.yaw, abs=0.01)
    assert told.velocity.wz == pytest.approx(0.2 * math.tan(angle) / LENGTH, rel=0.02)


def test_it_stops_after_the_timeout_and_claims_both_joints(world, car):
    driven, _ = drive(world, car, 0.2, 0.3, 2.0, cmd_vel_timeout=0.5)
    assert math.hypot(*driven.position) == pytest.approx(0.1, abs=0.01)
    (controller,) = car[1].controllers.values()
    assert [(joint.name, joint.interface) for joint in controller.joints] == [
        ("rear_wheel_joint", "VelocityJointInterface"),
        ("steering_joint", "PositionJointInterface"),
    ]
