import math

import pytest
from sensor_worlds import drive, record

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.world.urdf import read_urdf

MASS = 20.0  # kg: of a lighter robot, the default gains reverse the velocity in each step
MOMENT = 0.2  # kg m², about the vertical


def slider(tags="", file="libgazebo_ros_force_based_move.so"):
    """A block that slides without friction."""
    return read_urdf(
        '<robot name="slider"><link name="base"><inertial><origin xyz="0 0 0.025"/>'
        f'<mass value="{MASS}"/><inertia ixx="0.2" iyy="0.2" izz="{MOMENT}"/>'
        '</inertial><collision><origin xyz="0 0 0.025"/><geometry><box size="0.1 0.1 0.05"/>'
        '</geometry></collision></link><gazebo reference="base"><mu1>0</mu1></gazebo>'
        f'<gazebo><plugin name="move" filename="{file}">{tags}</plugin></gazebo></robot>',
        "slider",
    )


def test_the_missing_velocity_pushes_the_robot(world):
    gains = "<x_velocity_p_gain>400</x_velocity_p_gain><y_velocity_p_gain>200</y_velocity_p_gain>"
    robot = world.add(slider(gains))
    # Time constants are mass / gain: 0.05 s ahead, 0.1 s to the left.
    x, y, _ = drive(world, robot, 2.0, vx=0.2, vy=0.2).position
    assert x == pytest.approx(0.2 * (2.0 - 0.05), abs=1e-3)
    assert y == pytest.approx(0.2 * (2.0 - 0.1), abs=1e-3)


def test_it_turns_and_drives_ahead_of_itself(world):
    robot = world.add(slider("<yaw_velocity_p_gain>20</yaw_velocity_p_gain>"))
    turned = drive(world, robot, 2.0, wz=0.5).yaw
    assert turned == pytest.approx(0.5 * (2.0 - MOMENT / 20), abs=2e-3)
    still = drive(world, robot, 0.5).yaw
    x, y, _ = drive(world, robot, 2.0, vx=0.2).position
    assert math.hypot(x, y) == pytest.approx(0.4, abs=2e-3)
    assert math.atan2(y, x) == pytest.approx(still, abs=5e-3)


def test_unlike_planar_move_it_falls(world):
    robot = world.add(slider(), "", Pose((0.0, 0.0, 1.0)))
    robot.command("cmd_vel", PlanarCommand(vx=0.2))
    world.run_for(0.3)
    assert robot.pose().position[2] == pytest.approx(1.0 - 0.5 * 9.8 * 0.3**2, abs=5e-3)


@pytest.mark.parametrize("name", ["ridgeback", "nexus"])
def test_copies_forget_a_command_and_may_send_no_transform(world, name):
    tags = "<cmdVelTimeOut>0.25</cmdVelTimeOut><publishOdometryTf>0</publishOdometryTf>"
    robot = world.add(slider(tags, f"lib{name}_ros_force_based_move.so"))
    x, _, _ = drive(world, robot, 2.0, vx=0.4).position
    assert x == pytest.approx(0.1, abs=2e-3)
    (plugin,) = robot.plugins
    assert [output.topic for output in plugin.outputs] == ["odom"]


def test_odometry_starts_where_the_robot_starts_and_goes_on_where_it_is_placed(world):
    start = Pose.from_rpy((3.0, 2.0, 0.1), (0.0, 0.0, 1.0))
    robot = world.add(slider(), "", start)
    samples, transforms = record(robot, "odom"), record(robot, "/tf")
    drive(world, robot, 2.05, vx=0.2)
    # It turns at the first push, which does not act in its middle.
    there = start.inverse() * robot.pose()
    assert samples[-1].pose.position == pytest.approx((*there.position[:2], 0.0), abs=0.01)
    assert there.position[0] == pytest.approx(0.4, abs=0.02)
    assert samples[-1].velocity.vx == pytest.approx(0.2, abs=1e-3)
    robot.place(Pose((-5.0, 0.0, 0.0)))
    before = samples[-1].pose
    world.run_for(1.0)
    x, y, _ = (before.inverse() * samples[-1].pose).position
    assert (x, y) == pytest.approx((0.2, 0.0), abs=0.02)
    assert transforms[-1].pose == samples[-1].pose
    (plugin,) = robot.plugins
    here = plugin.origin * samples[-1].pose
    assert here.position[:2] == pytest.approx(robot.pose().position[:2], abs=0.02)
    world.reset_world()
    assert plugin.origin.position == pytest.approx(start.position)
