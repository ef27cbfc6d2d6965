import math

import pytest
from control_robots import CASES, listen, run, spawn
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.controllers import ControlError
from bullet_lab.simulation.plugins.controllers.diff_drive import SpeedLimiter
from bullet_lab.simulation.plugins.samples import PlanarCommand

WHEELS = CASES["drive"]["parameters"]


def drive(world, **parameters):
    """A robot whose controller runs; return robot, controller and the odometry to come."""
    robot, manager = spawn(world)
    controller = run(manager, "drive", **{**WHEELS, **parameters})
    return robot, controller, listen(controller.odometry)


def go(world, controller, seconds, vx=0.0, wz=0.0):
    """Command a velocity and let time pass."""
    controller.command(PlanarCommand(vx=vx, wz=wz))
    world.run_for(seconds)


def test_a_jerk_is_limited():
    limiter = SpeedLimiter(jerk=(-10.0, 10.0))
    speeds = [0.0, 0.0]
    for _ in range(3):
        speeds.append(limiter.limited(9.0, speeds[-1], speeds[-2], 0.1))
    # The step of the speed grows by 2 j dt2 = 0.2 each time, as in ros_controllers.
    assert speeds[2:] == pytest.approx([0.2, 0.6, 1.2])


def rim_speeds(world, controller, command):
    controller.command(command)
    world.run_for(0.002)
    return tuple(joint.command for joint in controller.joints)


def settings(controller, **changed):
    return {**{one.name: one.default for one in controller.adjustables}, **changed}


def test_it_is_adjusted_while_it_drives(world):
    _, controller, odometry = drive(
        world, wheel_radius_multiplier=1.2, publish_rate=20.0, cmd_vel_timeout=10.0
    )
    assert settings(controller) == {
        "left_wheel_radius_multiplier": 1.2,
        "right_wheel_radius_multiplier": 1.2,
        "wheel_separation_multiplier": 1.0,
        "publish_rate": 20.0,
        "enable_odom_tf": True,
    }
    transforms = listen(controller.transform)
    go(world, controller, 1.0, vx=0.3, wz=1.0)
    before = odometry[-1].pose.position
    adjusted = settings(
        controller,
        left_wheel_radius_multiplier=0.5,
        wheel_separation_multiplier=1.5,
        publish_rate=1500.0,
        enable_odom_tf=False,
    )
    controller.adjust(adjusted, world.step)
    odometry.clear()
    transforms.clear()
    world.run_for(0.01)
    # Nothing was driven by that, and each step is told of from now on.
    assert len(odometry) >= 9
    assert math.dist(odometry[0].pose.position, before) < 0.02
    assert transforms == []
    rims = rim_speeds(world, controller, PlanarCommand(vx=0.3, wz=1.0))
    assert rims == pytest.approx((0.075 / 0.03, 0.525 / 0.072))


@cases("""
name, value:
  - [wheel_separation_multiplier, .nan]
  - [right_wheel_radius_multiplier, 0.0]
  - [publish_rate, -1.0]
""")
def test_what_cannot_be_adjusted_changes_nothing(world, name, value):
    _, controller, _ = drive(world)
    before = controller.separation, controller.radii
    asked = {"wheel_separation_multiplier": 1.5, "left_wheel_radius_multiplier": 1.5, name: value}
    with pytest.raises(ControlError, match="have to be positive|publish_rate"):
        controller.adjust(settings(controller, **asked), world.step)
    controller.adjust(settings(controller), world.step)
    assert (controller.separation, controller.radii) == before


def test_a_robot_that_is_put_elsewhere_has_not_driven_and_a_reset_begins_again(world):
    robot, controller, odometry = drive(world, cmd_vel_timeout=10.0)
    go(world, controller, 0.5, vx=0.2)
    before = odometry[-1].pose.position[0]
    robot.place(Pose((3.0, 0.0, 0.0)))
    world.run_for(0.5)
    assert odometry[-1].pose.position[0] - before == pytest.approx(0.1, abs=0.01)
    world.reset_simulation()
    odometry.clear()
    world.run_for(0.2)
    assert len(odometry) == pytest.approx(10, abs=1)
    assert odometry[-1].pose.position[0] == pytest.approx(0.0, abs=1e-3)
    assert robot.pose().position[0] == pytest.approx(0.0, abs=1e-3)


def test_commands_that_make_no_sense_are_refused(manager):
    controller = run(manager, "drive", **WHEELS)
    with pytest.raises(ControlError, match="not finite"):
        controller.command(PlanarCommand(vx=math.nan))
    manager.switch([], ["drive"])
    with pytest.raises(ControlError, match="not running"):
        controller.command(PlanarCommand(vx=0.1))
