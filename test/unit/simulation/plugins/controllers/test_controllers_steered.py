"""Controllers of bases on steered wheels, and steer_bot_hardware_gazebo, on bases written anew."""

import math

import pytest
import yaml
from control_robots import LENGTH, PLACES, RADIUS, control_of, listen, run, spawn_base
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.controllers import ControlError
from bullet_lab.simulation.plugins.samples import PlanarCommand

# Parameters of controllers, and what robots differ in.
KNOWN = yaml.safe_load("""
base: &base
  type: steered_wheel_base_controller/SteeredWheelBaseController
  pid_gains: &gains
    fl_steering: &gain {p: 60.0, d: 1.0}
    fr_steering: *gain
    rl_steering: *gain
    rr_steering: *gain
  wheels:
    - {steering_joint: fl_steering, axle_joint: fl_axle, diameter: 0.12}
    - {steering_joint: fr_steering, axle_joint: fr_axle, diameter: 0.12}
    - {steering_joint: rl_steering, axle_joint: rl_axle, diameter: 0.12}
    - {steering_joint: rr_steering, axle_joint: rr_axle, diameter: 0.12}
by efforts:
  <<: *base
  pid_gains:
    {<<: *gains, fl_axle: &axle {p: 2.0, i: 0.0}, fr_axle: *axle, rl_axle: *axle, rr_axle: *axle}
four:
  type: four_wheel_steering_controller/FourWheelSteeringController
  front_steering: [fl_steering, fr_steering]
  rear_steering: [rl_steering, rr_steering]
  front_wheel: [fl_axle, fr_axle]
  rear_wheel: [rl_axle, rr_axle]
  pose_covariance_diagonal: [0.1, 0.1, 0.1, 0.1, 0.1, 0.1]
  twist_covariance_diagonal: &twist [0.2, 0.2, 0.2, 0.2, 0.2, 0.2]
ackermann:
  type: ackermann_steering_controller/AckermannSteeringController
  wheel_separation_h: 0.5
  wheel_radius: 0.06
  pose_covariance_diagonal: [0.1, 0.1, 0.1, 0.1, 0.1, 0.1]
  twist_covariance_diagonal: *twist
  cmd_vel_timeout: 60.0
# As in the original, the right one of the steers first.
hardware:
  virtual_rear_wheels: [rl_axle, rr_axle]
  virtual_front_wheels: [fl_axle, fr_axle]
  virtual_front_steers: [fr_steering, fl_steering]
  wheel_separation_h: 0.5
  wheel_separation_w: 0.4
car: {kind: revolute, rear: fixed, fork: none, axle: none}
fast: {linear_acceleration_limit: -1.0, yaw_acceleration_limit: -1.0}
""")
BASE, FAST = KNOWN["base"], KNOWN["fast"]


def start(world, given, parameters=None, **robot):
    """Return the robot and its controller, which runs."""
    instance, manager = spawn_base(world, parameters, **robot)
    return instance, run(manager, "drive", **given)


def drive(world, given, velocity, seconds, **robot):
    """Return how a robot has moved, and its odometry, after a drive."""
    instance, controller = start(world, {"cmd_vel_timeout": 60.0, **given}, **robot)
    samples = listen(controller.odometry)
    world.run_for(0.3)
    before = instance.pose()
    controller.command(PlanarCommand(*velocity))
    world.run_for(seconds)
    return before.inverse() * instance.pose(), samples[-1]


def expected(vx, vy, wz, seconds):
    """The pose after a drive at a velocity."""
    half = 0.5 * wz * seconds
    chord = seconds * (math.sin(half) / half if half else 1.0)
    x, y = (math.cos(half) * vx - math.sin(half) * vy, math.sin(half) * vx + math.cos(half) * vy)
    return chord * x, chord * y, wz * seconds


@cases("""
given, robot, velocity:
  # A controller, what differs of the robot, and the velocity.
  - [base, {}, [0.25, 0, 0]]
  - [base, {}, [-0.25, 0, 0]]
  - [base, {}, [0, 0.25, 0]]
  - [base, {}, [0.1, -0.2, 0]]
  - [base, {}, [0, 0, 0.5]]
  - [base, {}, [0.2, 0.1, -0.3]]
  - [base, &forks {fork: PositionJointInterface, kind: revolute}, [0, -0.25, 0.2]]
  - [base, {<<: *forks, least: -0.1, most: 3.1}, [0, -0.2, 0]]
  - [by efforts, {axle: EffortJointInterface}, [0.2, 0.1, 0.3]]
  - [four, *forks, [0.25, 0, 0]]
  - [four, *forks, [0.3, 0, 0.4]]
  - [four, *forks, [-0.3, 0, 0.4]]
  - [four, {<<: *forks, offset: 0.05}, [0.3, 0, 0.4]]
  - [four, *forks, [0.2, 0.1, 0]]
""")
def test_it_drives_as_commanded_and_reports_it(world, given, robot, velocity):
    driven, told = drive(world, {**KNOWN[given], **FAST}, velocity, 2.0, **robot)
    x, y, yaw = expected(*velocity, 2.0)
    # The forks turn first.
    assert driven.position[:2] == pytest.approx((x, y), abs=0.035)
    assert driven.yaw == pytest.approx(yaw, abs=0.06)
    assert told.pose.position[:2] == pytest.approx(driven.position[:2], abs=0.02)
    assert told.pose.yaw == pytest.approx(driven.yaw, abs=0.03)
    last = told.velocity
    assert (last.vx, last.vy, last.wz) == pytest.approx(velocity, abs=0.02)


def test_a_command_that_is_not_finite_is_refused(world):
    _, controller = start(world, BASE)
    with pytest.raises(ControlError, match="not finite"):
        controller.command(PlanarCommand(vy=math.nan))


def test_odometry_goes_on_where_the_robot_is_placed(world):
    instance, controller = start(world, {**BASE, **FAST, "cmd_vel_timeout": 0})
    samples = listen(controller.odometry)
    controller.command(PlanarCommand(vx=0.2))
    world.run_for(1.0)
    before = samples[-1].pose.position[0]
    instance.place(Pose((5.0, 5.0, 0.0)))
    control_of(instance).placed()
    world.run_for(0.5)
    assert samples[-1].pose.position[:2] == pytest.approx((before + 0.1, 0.0), abs=0.02)
    world.reset_world()
    world.run_for(0.05)
    assert samples[-1].pose.position[:2] == pytest.approx((0.0, 0.0), abs=0.01)


HARDWARE = "steer_bot_hardware_gazebo/SteerBotHardwareGazebo"


def car(world, velocity, seconds, **hardware):
    """Return a car of steer_bot_hardware_gazebo, its controller and its odometry after a drive."""
    tags = f"<robotSimType>{HARDWARE}</robotSimType>"
    parameters = {"steer_bot_hardware_gazebo": {**KNOWN["hardware"], **hardware}}
    instance, controller = start(world, KNOWN["ackermann"], parameters, **KNOWN["car"], tags=tags)
    samples = listen(controller.odometry)
    controller.command(PlanarCommand(*velocity))
    world.run_for(seconds)
    return instance, controller, samples[-1]


@cases("""
hardware, angle, left, right:
  - [{}, 0.0, 0.0, 0.0]
  # tan(0.3) / (1 -+ 0.2 tan(0.3)) for a width of 0.8 lengths.
  - [{}, 0.3, 0.31851, 0.28347]
  - [{}, -0.3, -0.28347, -0.31851]
  - [{enable_ackermann_link: false}, 0.3, 0.3, 0.3]
""")
def test_a_car_of_steer_bot_hardware_drives_and_steers(world, hardware, angle, left, right):
    instance, controller, told = car(world, (0.25, 0.0, angle), 2.0, **hardware)
    assert [joint.name for joint in controller.joints] == ["rear_wheel_joint", "front_steer_joint"]
    handles = controller.handles
    found = [handles[f"f{side}_steering"].position for side in "lr"]
    assert found == pytest.approx([left, right], abs=0.01)
    rates = [handles[f"{name}_axle"].velocity for name in PLACES]
    assert rates == pytest.approx([0.25 / RADIUS] * 4, rel=0.02)
    assert told.velocity.wz == pytest.approx(0.25 * math.tan(angle) / LENGTH, rel=0.02, abs=1e-3)
    pose = instance.pose()
    assert math.hypot(*pose.position[:2]) == pytest.approx(0.5, rel=0.1)
    assert pose.yaw == pytest.approx(told.pose.yaw, abs=0.08)


@cases("""
hardware, complaint:
  - [{virtual_rear_wheels: null}, virtual_rear_wheels is missing or empty]
  - [{virtual_front_steers: []}, virtual_front_steers is missing or empty]
  - [{wheel_separation_h: 0}, wheel_separation_h has to be positive]
""")
def test_wrong_parameters_of_steer_bot_hardware_are_named(world, hardware, complaint):
    with pytest.raises(ControlError, match=f"hardware_gazebo/{complaint}"):
        car(world, (0.0, 0.0, 0.0), 0.1, **hardware)
