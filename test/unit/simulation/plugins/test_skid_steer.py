import math
import re

import numpy as np
import pytest
from conftest import complains
from sensor_worlds import record

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins import PluginError
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation, SimulationError
from bullet_lab.simulation.world.urdf import read_urdf

FLOOR = "package://bullet_lab/worlds/empty.world"
SEPARATION, RADIUS = 0.5, 0.1
PLACES = {
    "left_front_joint": (0.2, 0.25),
    "right_front_joint": (0.2, -0.25),
    "left_rear_joint": (-0.2, 0.25),
    "right_rear_joint": (-0.2, -0.25),
}
SIZES = (
    f"<wheelSeparation>{SEPARATION}</wheelSeparation>"
    f"<wheelDiameter>{2 * RADIUS}</wheelDiameter>"
)
QUARTER = "1.5707963267948966"


def wheel(joint, x, y, kind="continuous"):
    return (
        f'<link name="{joint}_wheel"><inertial><mass value="0.5"/>'
        '<inertia ixx="2e-3" iyy="2.5e-3" izz="2e-3"/></inertial>'
        f'<collision><origin rpy="{QUARTER} 0 0" xyz="0 0 0"/><geometry>'
        f'<cylinder radius="{RADIUS}" length="0.05"/></geometry></collision></link>'
        f'<joint name="{joint}" type="{kind}"><parent link="base"/><child link="{joint}_wheel"/>'
        f'<origin xyz="{x} {y} {RADIUS}"/><axis xyz="0 1 0"/>'
        '<limit effort="9" velocity="9"/></joint>'
    )


def rover(tags=SIZES, kind="continuous"):
    wheels = "".join(wheel(joint, *place, kind) for joint, place in PLACES.items())
    return read_urdf(
        '<robot name="rover"><link name="base"><inertial><origin xyz="0 0 0.15"/>'
        '<mass value="8"/><inertia ixx="0.1" iyy="0.15" izz="0.2"/></inertial>'
        '<collision><origin xyz="0 0 0.2"/><geometry><box size="0.5 0.3 0.1"/></geometry>'
        f"</collision></link>{wheels}<gazebo><plugin name='drive' "
        f"filename='libgazebo_ros_skid_steer_drive.so'>{tags}</plugin></gazebo></robot>",
        "rover",
    )


def drive(command, seconds=3.0, tags=SIZES, start=None):
    with Simulation.of(FLOOR) as simulation:
        robot = simulation.add(rover(tags), pose=start)
        samples = record(robot, "odom")
        simulation.run_for(0.5)
        robot.command("cmd_vel", command)
        simulation.run_for(seconds)
        return samples, robot.pose()


def test_straight_ahead():
    samples, pose = drive(PlanarCommand(vx=0.4))
    assert pose.position[0] == pytest.approx(0.4 * 3.0, abs=0.03)
    assert pose.position[1] == pytest.approx(0.0, abs=0.01)
    assert samples[-1].velocity.vx == pytest.approx(0.4, abs=0.01)


def test_backwards():
    _, pose = drive(PlanarCommand(vx=-0.3))
    assert pose.position[0] == pytest.approx(-0.9, abs=0.03)


@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_on_the_spot_it_turns_but_less_than_commanded(turn):
    samples, pose = drive(PlanarCommand(wz=turn), 2.0)
    # By Coulomb's law it is b²/(a² + b²) of the command, with the wheels at (±a, ±b).
    rates = np.array([sample.velocity.wz for sample in samples[100:]])
    assert rates / turn == pytest.approx(0.25**2 / (0.2**2 + 0.25**2), rel=5e-3)
    assert math.hypot(*pose.position[:2]) < 2e-3


def test_the_wheels_of_a_side_turn_alike():
    with Simulation.of(FLOOR) as simulation:
        robot = simulation.add(rover())
        robot.command("cmd_vel", PlanarCommand(vx=0.3, wz=0.4))
        simulation.run_for(1.0)
        body = robot.bodies["base"]
        speeds = {joint: body.joint_state(joint).velocity for joint in PLACES}
    for side, sign in (("left", -1.0), ("right", 1.0)):
        wanted = (0.3 + sign * 0.5 * 0.4 * SEPARATION) / RADIUS
        assert speeds[f"{side}_front_joint"] == pytest.approx(wanted, rel=0.02)
        assert speeds[f"{side}_rear_joint"] == pytest.approx(wanted, rel=0.02)


def test_little_torque_does_not_move_it_far():
    _, weak = drive(PlanarCommand(vx=0.4), tags=SIZES + "<torque>0.005</torque>")
    _, none = drive(PlanarCommand(vx=0.4), tags=SIZES + "<torque>0</torque>")
    assert none.position[0] == pytest.approx(0.0, abs=1e-3)
    # 4 · 0.005 N m at 0.1 m, on 10 kg and what turns with it: 0.02 m/s².
    mass = 10.0 + 4 * 2.5e-3 / RADIUS**2
    assert weak.position[0] == pytest.approx(0.5 * 0.2 / mass * 3.0**2, rel=0.15)


def test_what_the_odometry_says():
    start = Pose.from_rpy((1, 2, 0), (0, 0, 0.5))
    tags = SIZES + (
        "<covariance_x>0.1</covariance_x><covariance_y>0.2</covariance_y>"
        "<covariance_yaw>0.3</covariance_yaw>"
    )
    samples, pose = drive(PlanarCommand(vx=0.3), 1.0, tags, start)
    last = samples[-1]
    assert last.pose.position == (*pose.position[:2], 0.0)
    assert last.pose.quaternion == pose.quaternion
    assert last.velocity.vy == pytest.approx(0.0, abs=0.01)
    assert last.pose_variances == last.twist_variances == (0.1, 0.2, 1e12, 1e12, 1e12, 0.3)
    assert (last.frame, last.child_frame) == ("odom", "base_footprint")


def test_defaults():
    with Simulation.of(FLOOR) as simulation:
        robot = simulation.add(rover(""))
        samples = record(robot, "odom")
        (device,) = robot.plugins
        robot.command("cmd_vel", PlanarCommand(vx=0.15, wz=1.0))
        simulation.run_for(1.0)
        speeds = [robot.bodies["base"].joint_state(joint).velocity for joint in PLACES]
        assert [output.topic for output in device.outputs] == ["odom"]
    assert len(samples) == 100
    assert samples[0].pose_variances == (1e-4, 1e-4, 1e12, 1e12, 1e12, 1e-2)
    # (v ∓ ω·0.4/2) / 0.075
    assert speeds == pytest.approx([-2 / 3, 14 / 3, -2 / 3, 14 / 3], rel=0.05)


def test_names_of_topics_and_frames():
    tags = SIZES + (
        "<commandTopic>go</commandTopic><odometryTopic>wheels</odometryTopic>"
        "<odometryFrame>start</odometryFrame><robotBaseFrame>base</robotBaseFrame>"
        "<broadcastTF>true</broadcastTF><updateRate>50</updateRate>"
    )
    with Simulation.of(FLOOR) as simulation:
        robot = simulation.add(rover(tags), namespace="ns", tf_prefix="one")
        odometry, transforms = record(robot, "/ns/wheels"), record(robot, "/tf")
        robot.command("/ns/go", PlanarCommand(vx=0.1))
        simulation.run_for(0.1)
    assert [(s.step, s.frame, s.child_frame) for s in odometry] == [
        (step, "one/start", "one/base") for step in (20, 40, 60, 80, 100)
    ]
    assert [(s.step, s.frame, s.child_frame) for s in transforms] == [
        (s.step, s.frame, s.child_frame) for s in odometry
    ]
    assert odometry[-1].pose.position[0] > 0.0


def test_without_broadcast_there_is_no_transform():
    with Simulation.of(FLOOR) as simulation, pytest.raises(SimulationError):
        record(simulation.add(rover()), "/tf")


@pytest.mark.parametrize("reset", ["reset_world", "reset_simulation"])
def test_a_reset_stops_it(reset):
    with Simulation.of(FLOOR) as simulation:
        robot = simulation.add(rover())
        robot.command("cmd_vel", PlanarCommand(vx=0.4))
        simulation.run_for(1.0)
        getattr(simulation, reset)()
        simulation.run_for(1.0)
        assert robot.pose().position[0] == pytest.approx(0.0, abs=5e-3)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_commands_that_are_not_finite_are_refused(bad):
    with Simulation.of(FLOOR) as simulation:
        robot = simulation.add(rover())
        for command in (PlanarCommand(vx=bad), PlanarCommand(wz=bad)):
            with pytest.raises(PluginError, match="is not finite"):
                robot.command("cmd_vel", command)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (lambda: rover("<leftFrontJoint>x</leftFrontJoint>"), "<leftFrontJoint>: no movable joint"),
        (
            lambda: rover("<rightRearJoint>left_rear_joint</rightRearJoint>"),
            "<rightRearJoint>: the four joints must be different",
        ),
        (lambda: rover("<wheelDiameter>0</wheelDiameter>"), "<wheelDiameter>: 0 is not positive"),
        (lambda: rover("<torque>-1</torque>"), "<torque>: -1 is negative"),
        (lambda: rover("<covariance_x>-1</covariance_x>"), "<covariance_x>: -1 is negative"),
        (lambda: rover("<broadcastTF>maybe</broadcastTF>"), "<broadcastTF>: 'maybe'"),
        (lambda: rover(kind="prismatic"), "is prismatic; it must be continuous or revolute"),
    ],
)
def test_refusals(model, message):
    with Simulation.of(FLOOR) as simulation, complains(re.escape(message)):
        simulation.add(model())
