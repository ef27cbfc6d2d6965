"""Controllers send the same samples, and move their joints alike, as before.

A change that means to send others renews the text: see `assert_as_before`.
"""

import cmath
import math
from pathlib import Path

import pytest
import yaml
from alike import assert_as_before, lines_of
from arm_robots import arm_controller, trajectory
from control_robots import CAR, CASES, listen, run, spawn, spawn_base, spawn_car

from bullet_lab.simulation.plugins.controllers import ControlError
from bullet_lab.simulation.plugins.samples import Trajectory
from bullet_lab.simulation.simulation import Simulation

HERE = Path(__file__).parent
WAY = trajectory((0.2, 0.3, 0.5, 0.0), (0.6, 0.7, -0.2, 0.1))
FLOOR = "package://bullet_lab/worlds/empty.world"


SPAWN = {"bot": spawn, "car": spawn_car, "base": spawn_base}


def controller_of(world, name, robot="bot", parameters=(), hardware=None, spawned=()):
    """Return a controller that runs."""
    if robot == "arm":
        return arm_controller(world, name.partition("s_")[0], **dict(parameters))
    usual = CAR if robot == "car" else {}
    _, manager = SPAWN[robot](world, *([hardware] if hardware else ()), **dict(spawned))
    return run(manager, name, **{**usual, **dict(parameters)})


def check_drive(driven, told, velocity, seconds):
    """Compare a drive and the velocity that odometry tells with what was commanded."""
    ahead, left, turn = velocity
    half = 0.5 * turn * seconds
    chord = seconds * (math.sin(half) / half if half else 1.0) * cmath.rect(1.0, half)
    there = complex(ahead, left) * chord
    # The forks turn first.
    assert driven.position[:2] == pytest.approx((there.real, there.imag), abs=0.035)
    assert driven.yaw == pytest.approx(turn * seconds, abs=0.06)
    assert (told.vx, told.vy, told.wz) == pytest.approx(velocity, abs=0.02)


def test_states_are_as_before_and_commands_are_followed(caplog):
    told = []
    for name, given in CASES.items():
        case = dict(given)
        steps, followed = case.pop("steps", [[[0.8], 0.45]]), case.pop("as_commanded", False)
        with Simulation.of(FLOOR) as world:
            controller = controller_of(world, name, **case)
            (*_, robot) = world.models.values()
            told += lines_of([one.name for one in controller.joints], name)
            samples = {output.topic: listen(output) for output in controller.outputs}
            for command, seconds in steps:
                before = robot.pose()
                for entry in controller.inputs[-1:]:
                    entry.handle(WAY if entry.kind is Trajectory else entry.kind(*command))
                world.run_for(seconds)
                joints = [
                    (one.name, one.interface, one.position, one.velocity)
                    for one in controller.handles.values()
                ]
                told += lines_of([robot.pose(), *joints], name)
            if followed:
                odometry = next(k for topic, k in samples.items() if topic.endswith("odom"))
                driven = before.inverse() * robot.pose()
                check_drive(driven, odometry[-1].velocity, command, seconds)
        for topic, found in samples.items():
            told += [f"{topic}: {len(found)}", *lines_of(found[-1:], topic)]
    told += caplog.messages
    # Errors of controllers by efforts grow from one step to the next.
    assert_as_before(told, HERE / "controllers.txt", 1e-4)


def test_wrong_parameters_are_named_as_before():
    told = []
    for name, cases in yaml.safe_load((HERE / "wrong_controllers.yaml").read_text()).items():
        usual = CAR if name == "car" else {}
        for case in cases:
            with Simulation() as world:
                _, manager = SPAWN[name](world, **case.get("robot", {}))
                with pytest.raises(ControlError) as error:
                    run(manager, "drive", **{**usual, **case["parameters"]})
            assert not manager.controllers
            told.append(error.value)
    assert_as_before(told, HERE / "wrong_controllers.txt")
