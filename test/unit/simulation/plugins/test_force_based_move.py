import pytest
from sensor_worlds import drive, record

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.urdf import read_urdf


def slider():
    """A block that slides without friction."""
    return read_urdf(
        '<robot name="slider"><link name="base"><inertial><origin xyz="0 0 0.025"/>'
        '<mass value="20"/><inertia ixx="0.2" iyy="0.2" izz="0.2"/>'
        '</inertial><collision><origin xyz="0 0 0.025"/><geometry><box size="0.1 0.1 0.05"/>'
        '</geometry></collision></link><gazebo reference="base"><mu1>0</mu1></gazebo>'
        '<gazebo><plugin name="move" filename="libgazebo_ros_force_based_move.so"/></gazebo>'
        "</robot>",
        "slider",
    )


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
