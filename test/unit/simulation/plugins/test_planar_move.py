import dataclasses
import math

import numpy as np
import pytest
from sensor_worlds import box, drive, record, steps
from shared import BLOCK_ROBOT, cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins import PluginError
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import SimulationError
from bullet_lab.simulation.world.urdf import read_urdf

FRICTION_LOSS = 9.8e-3  # m/s at each step of 1 ms
HALF = 0.05
RADIUS = 0.0102


def block(tags="", more=""):
    """A block like the report's, without the can."""
    return read_urdf(
        '<robot name="block"><link name="base"><inertial><origin xyz="0 0 0.025"/>'
        '<mass value="4.5"/><inertia ixx="4.6875e-3" iyy="4.6875e-3" izz="7.5e-3"/></inertial>'
        '<collision><origin xyz="0 0 0.025"/><geometry><box size="0.1 0.1 0.05"/></geometry>'
        f'</collision></link><gazebo reference="base"><mu1>1</mu1></gazebo><gazebo>'
        f'<plugin name="move" filename="libgazebo_ros_planar_move.so">{tags}</plugin></gazebo>'
        f"{more}</robot>",
        "block",
    )


def test_figure_1a_points(published_run, figure_corners):
    # The figure's first side starts late: what it shows of it is the heading. From the first
    # corner on, lengths and headings of the sides can be compared, and the corners' places.
    _, corners = published_run
    ours, theirs = np.diff(corners, axis=0), np.diff(figure_corners, axis=0)
    # The last side ends where the robot stopped.
    assert np.hypot(*ours.T)[1:3] == pytest.approx(np.hypot(*theirs.T)[1:3], abs=0.003)

    def turns(sides):
        return np.degrees(-np.diff(np.unwrap(np.arctan2(sides[:, 1], sides[:, 0]))))

    assert turns(ours) == pytest.approx(turns(theirs), abs=0.45)
    assert turns(ours).mean() == pytest.approx(turns(theirs).mean(), abs=0.05)
    there = figure_corners[2:] - figure_corners[1]
    assert corners[2:] - corners[1] == pytest.approx(there, abs=0.02)


def test_a_command_times_out(world):
    world.run_until(137)
    robot = world.add(block("<cmdTimeout>0.1</cmdTimeout>"))
    for change in (lambda: None, lambda: None, world.reset_simulation):
        change()
        driven = drive(world, robot, 0.3, vx=0.2).position[0]
        # 100 steps, not one more or less.
        assert driven == pytest.approx(0.1 * (0.2 - FRICTION_LOSS), abs=5e-5)


def test_commands_that_are_not_finite_are_refused_and_the_old_one_stays(world, robot):
    robot.command("cmd_vel", PlanarCommand(vx=0.2))
    for bad in ({"vx": math.nan}, {"vy": -math.inf}, {"wz": 1e300}):
        with pytest.raises(PluginError, match="is not finite"):
            robot.command("cmd_vel", PlanarCommand(**bad))
    world.run_for(0.1)
    assert robot.pose().position[0] == pytest.approx(0.019, abs=1e-3)


@cases("yaw, speed: [[0.0, 0.2], [0.7, 1.0]]")
def test_a_wall_stops_the_block(world, robot, yaw, speed):
    world.add(box("0.2 20 1", f"0.5 0 0.5 0 0 {yaw}"))
    robot.command("cmd_vel", PlanarCommand(vx=speed))
    normal = np.array([math.cos(yaw), math.sin(yaw)])
    for _ in range(100):
        world.run_for(0.03)
        pose = robot.pose()
        reach = HALF * (abs(math.cos(pose.yaw - yaw)) + abs(math.sin(pose.yaw - yaw)))
        gap = -(np.array(pose.position[:2]) - (0.5, 0.0)) @ normal - 0.1 - reach
        assert gap > -5e-3
        assert abs(pose.position[2]) < 2e-3
        assert max(map(abs, pose.rpy()[:2])) < math.radians(2.0)
    # It has arrived there.
    assert gap < 5e-3


def test_no_spike_after_a_reset(world, robot):
    samples = record(robot, "odom")
    drive(world, robot, 1.025, vx=0.2, wz=0.2)
    samples.clear()
    world.reset_world()
    world.run_for(0.5)
    for sample in samples:
        assert dataclasses.astuple(sample.velocity) == pytest.approx((0, 0, 0), abs=1e-3)
        assert sample.pose.position == pytest.approx((0, 0, 0), abs=1e-4)
    assert steps(samples) == list(range(1071, 1526, 51))


def test_a_robot_that_is_put_elsewhere_drives_on_from_there(world, robot):
    samples = record(robot, "odom")
    drive(world, robot, 0.3, vx=0.2)
    for z in (2.0, 0.0):
        robot.place(Pose((3.0, 0.0, z)))
        world.run_for(0.25)
        there = 3.0 + 0.25 * (0.2 - FRICTION_LOSS)
        assert robot.pose().position[0] == pytest.approx(there, abs=3e-3)
    assert max(abs(sample.velocity.vx) for sample in samples) < 0.21


def test_tf_prefix_stands_before_the_frames(world):
    robot = world.add(block("<odometryFrame>/map</odometryFrame>"), tf_prefix="/one/")
    odometry, transforms = record(robot, "odom"), record(robot, "/tf")
    world.run_for(0.05)
    for sample in (*odometry, *transforms):
        assert (sample.frame, sample.child_frame) == ("map", "one/base_footprint")


def test_tf_prefix_may_depend_on_the_namespace_of_the_plugin(world):
    own = block("<robotNamespace>own</robotNamespace>")
    for name, model, frame in (("one", own, "own_tf/odom"), ("two", block(), "given_tf/odom")):
        robot = world.add(
            model, name, namespace="given", tf_prefix=lambda namespace: f"{namespace}_tf"
        )
        samples = record(robot, f"/{frame.replace('_tf', '')}")
        world.run_for(0.051)
        assert samples[0].frame == frame


def test_topics_are_known_by_their_full_names_only(world):
    robot = world.add(block("<robotNamespace>/own/</robotNamespace>"), namespace="given")
    record(robot, "/own/odom")
    robot.command("/own/cmd_vel", PlanarCommand(vx=0.1))
    with pytest.raises(SimulationError, match="has no input 'cmd_vel'"):
        robot.command("cmd_vel", PlanarCommand())
    with pytest.raises(SimulationError, match="has no output 'odom'"):
        record(robot, "odom")


def test_p3d_and_imu_tell_the_commanded_velocity_of_a_robot_that_friction_slows_down(world):
    # Gazebo's plugins read it before the solver; its model_states tell what is left.
    sensors = "".join(
        f'<gazebo><plugin name="{name}" filename="libgazebo_ros_{name}.so"><topicName>{name}'
        "</topicName><bodyName>base</bodyName><updateRate>50</updateRate></plugin></gazebo>"
        for name in ("p3d", "imu")
    )
    robot = world.add(block(more=sensors), pose=Pose.from_rpy((0, 0, 0), (0, 0, math.pi / 2)))
    truth, imu = record(robot, "p3d"), record(robot, "imu")
    drive(world, robot, 0.1, vx=0.2, wz=0.5)
    assert truth[0].linear == pytest.approx((0.0, 0.2, 0.0), abs=5e-3)
    for turning in (truth[0].angular, imu[0].angular_velocity):
        assert turning == pytest.approx((0.0, 0.0, 0.5), abs=1e-4)
    assert math.hypot(*imu[0].specific_force) == pytest.approx(10.0, abs=0.01)
    # While it sets out with 0.2 m/s, friction leaves 0.19 m/s on average.
    assert math.dist(robot.pose().position, (0.0, 0.0, 0.0)) == pytest.approx(0.019, abs=1e-4)


def test_a_command_is_latched_and_loses_friction(world, robot):
    x, y, _ = drive(world, robot, 2.0, vx=0.2, vy=-0.1).position
    speed = math.hypot(0.2, 0.1) - FRICTION_LOSS
    assert math.hypot(x, y) == pytest.approx(2.0 * speed, abs=2e-4)
    assert y / x == pytest.approx(-0.5, abs=1e-3)


def test_a_turn_loses_the_moment_of_the_patch(world, robot):
    turned = drive(world, robot, 1.0, wz=-0.5236)
    lost = 4.51 * 9.8 * RADIUS * 1e-3 / 7.5125e-3
    assert turned.yaw == pytest.approx(-(0.5236 - lost), abs=5e-4)
    assert math.hypot(*turned.position[:2]) < 1e-4


def test_velocities_turn_with_the_robot(world):
    robot = world.spawn(BLOCK_ROBOT, pose=Pose.from_rpy((1, 2, 0), (0, 0, math.pi / 2)))
    samples = record(robot, "odom")
    drive(world, robot, 0.1, vx=0.2, vy=0.05, wz=0.3)
    x, y, _ = robot.pose().position
    assert y > 2.015
    assert x < 0.998
    drive(world, robot, 0.2, vx=0.2)
    told = dataclasses.astuple(samples[-1].velocity)
    assert told == pytest.approx((0.2 - FRICTION_LOSS, 0.0, 0.0), abs=1e-3)


def test_a_command_moves_the_robot_in_the_very_next_step(world, robot):
    robot.command("cmd_vel", PlanarCommand(vx=0.2))
    world.run_until(1)
    assert robot.pose().position[0] == pytest.approx(1e-3 * (0.2 - FRICTION_LOSS), rel=0.06)
