"""Controllers of bases on steered wheels, and steer_bot_hardware_gazebo; see controllers.yaml."""

import math

import pytest
from control_robots import CASES, control_of, listen, run, spawn_base
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.controllers import ControlError
from bullet_lab.simulation.plugins.samples import PlanarCommand


def start(world, name, **hardware):
    """Return the robot of a case and its controller, which runs."""
    case = CASES[name]
    given = {part: {**told, **hardware} for part, told in case.get("hardware", {}).items()}
    instance, manager = spawn_base(world, given, **case.get("spawned", {}))
    return instance, run(manager, "drive", **case["parameters"])


def test_a_command_that_is_not_finite_is_refused(world):
    _, controller = start(world, "base")
    with pytest.raises(ControlError, match="not finite"):
        controller.command(PlanarCommand(vy=math.nan))


def test_odometry_goes_on_where_the_robot_is_placed(world):
    instance, controller = start(world, "base_there_and_back")
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


@cases("""
hardware, complaint:
  - [{virtual_rear_wheels: null}, virtual_rear_wheels is missing or empty]
  - [{virtual_front_steers: []}, virtual_front_steers is missing or empty]
  - [{wheel_separation_h: 0}, wheel_separation_h has to be positive]
""")
def test_wrong_parameters_of_steer_bot_hardware_are_named(world, hardware, complaint):
    with pytest.raises(ControlError, match=f"hardware_gazebo/{complaint}"):
        start(world, "hardware", **hardware)
