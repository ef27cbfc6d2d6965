"""The base of a TurtleBot2, on a robot written anew."""

import math
from dataclasses import replace

import pytest
from sensor_worlds import box, drive, record, saved_again

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.samples import MotorPower, Trigger
from bullet_lab.simulation.world.urdf import read_urdf_file

COMMANDS = "mobile_base/commands"
LEFT, CENTRE, RIGHT = range(3)


@pytest.fixture(scope="module")
def model(package):
    return read_urdf_file(package / "urdf" / "kobuki_robot.urdf")


@pytest.fixture
def robot(world, model):
    robot = world.add(model)
    world.run_for(0.5)
    return robot


def with_tags(model, **tags):
    """The model with other tags of its Kobuki; None leaves one out."""

    def changed(tag):
        if tag.filename != "libgazebo_ros_kobuki.so":
            return tag
        return replace(tag, tags={k: v for k, v in {**tag.tags, **tags}.items() if v is not None})

    return replace(model, plugins=tuple(map(changed, model.plugins)))


def go(world, robot, vx, wz, seconds):
    """Command a velocity ten times a second."""
    for _ in range(round(10 * seconds)):
        drive(world, robot, 0.1, vx, wz, topic=f"{COMMANDS}/velocity")


@pytest.mark.parametrize("vx, wz, seconds", [(0.25, 0.0, 4.0), (0.0, 1.0, math.pi), (0.2, 0.5, 4)])
def test_it_drives_and_its_odometry_is_right(world, robot, vx, wz, seconds):
    odometry, start = record(robot, "odom"), robot.pose()
    go(world, robot, vx, wz, seconds)
    world.run_for(1.5)
    driven = start.inverse() * robot.pose()
    # It drives on until the timeout of 0.6 s, less the last 0.1 s.
    turned = math.remainder(wz * (round(10 * seconds) / 10 + 0.5), math.tau)
    assert math.remainder(driven.yaw - turned, math.tau) == pytest.approx(0.0, abs=0.02)
    if wz == 0.0:
        assert driven.position[0] == pytest.approx(vx * (seconds + 0.5), abs=0.01)
    told = odometry[-1].pose
    assert told.position[:2] == pytest.approx(driven.position[:2], abs=0.01)
    assert told.yaw == pytest.approx(driven.yaw, abs=0.01)


# A cliff sensor that leans sees no side of the thin plate below its edge.
WALL, PLATE = box("0.1 4 1", "0.4 0 0.5 0 0 0"), box("1 4 0.04", "0 0 0.18 0 0 0")


@pytest.mark.parametrize("yaw, side, bit", [(0.0, CENTRE, 2), (-1.0, LEFT, 4), (1.0, RIGHT, 1)])
@pytest.mark.parametrize(
    "kind, thing, start, speed",
    [("bumper", WALL, (0.0, 0.0, 0.0), 0.2), ("cliff", PLATE, (0.2, 0.0, 0.2), 0.1)],
)
def test_a_wall_presses_a_bumper_and_an_edge_is_a_cliff(
    world, model, kind, thing, start, speed, yaw, side, bit
):
    world.add(thing)
    robot = world.add(model, pose=Pose.from_rpy(start, (0.0, 0.0, yaw)))
    events, drops = (record(robot, f"mobile_base/events/{name}") for name in (kind, "wheel_drop"))
    core = record(robot, "mobile_base/sensors/core")
    world.run_for(0.5)
    assert not events
    while not events and world.seconds < 5.0:
        go(world, robot, speed, 0.0, 0.1)
    # Beyond its greatest range a cliff sensor sees nothing: the converter reads 0.
    assert (events[0].number, events[0].on, events[0].reading) == (side, True, 0)
    assert bit in {getattr(sample, f"{kind}s") for sample in core}
    go(world, robot, -speed, 0.0, 1.0)
    assert (side, False) in [(event.number, event.on) for event in events[1:]]
    assert len(events) == 2 or kind == "bumper"
    assert getattr(core[-1], f"{kind}s") == 0 and not drops


def test_a_lifted_robot_drops_its_wheels(world, robot):
    drops = record(robot, "mobile_base/events/wheel_drop")
    robot.place(Pose((0.0, 0.0, 0.3)))
    world.run_for(0.1)
    assert [(event.number, event.on) for event in drops] == [(LEFT, True), (1, True)]
    world.run_for(1.0)
    assert {(event.number, event.on) for event in drops[2:]} >= {(LEFT, False), (1, False)}


def test_the_motors_and_the_odometry_have_switches(world, robot):
    odometry = record(robot, "odom")
    robot.command(f"{COMMANDS}/motor_power", MotorPower(False))
    go(world, robot, 0.2, 0.0, 1.0)
    assert robot.pose().position[0] == pytest.approx(0.0, abs=1e-3)
    robot.command(f"{COMMANDS}/motor_power", MotorPower(True))
    go(world, robot, 0.2, 0.0, 1.0)
    assert odometry[-1].pose.position[0] > 0.15
    robot.command(f"{COMMANDS}/reset_odometry", Trigger())
    world.run_for(0.05)
    assert odometry[-1].pose.position[0] < 0.02


def test_robots_without_wheel_drop_sensors(world, model):
    sides = {f"wheel_drop_{side}_sensor_name": None for side in ("left", "right")}
    robot = world.add(with_tags(model, **sides))
    drops = record(robot, "mobile_base/events/wheel_drop")
    go(world, robot, 0.2, 0.0, 1.0)
    assert robot.pose().position[0] > 0.15 and not drops


def test_it_drives_again_in_a_saved_world(world, robot, tmp_path):
    with saved_again(world, tmp_path) as again:
        # A sensor has no plugin of its own.
        assert 'filename=""' not in (tmp_path / "again.world").read_text()
        robot = again.models[robot.name]
        go(again, robot, 0.2, 0.0, 1.0)
        assert robot.pose().position[0] > 0.15
