import math

import pytest
from sensor_worlds import carrier, empty, readings, record, steps

from bullet_lab.core.pose import Pose

ARM = (
    '<link name="arm"><inertial><origin xyz="0.3 0 0"/><mass value="1e-3"/>'
    '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3"/></inertial></link>'
    '<joint name="j" type="continuous"><parent link="base"/><child link="arm"/>'
    '<origin xyz="1 0 0"/><axis xyz="0 0 1"/></joint>'
    '<link name="tip"/><joint name="f" type="fixed"><parent link="arm"/><child link="tip"/>'
    '<origin xyz="0 0.5 0"/></joint>'
)


def p3d(tags="", body="base", topic="<topicName>truth</topicName>"):
    plugin = (
        '<gazebo><plugin name="p3d" filename="libgazebo_ros_p3d.so">'
        f"<bodyName>{body}</bodyName>{topic}{tags}</plugin></gazebo>"
    )
    return carrier(plugin, links=ARM)


def motion(model, step=1, pose=None, linear=(0, 0, 0), angular=(0, 0, 0), joint=(0.0, 0.0)):
    with empty() as simulation:
        robot = simulation.add(model, pose=pose, namespace="ns", tf_prefix="robot")
        samples = record(robot, "/ns/truth")
        body = robot.bodies["base"]
        body.set_velocity(linear, angular)
        body.set_joint("j", *joint)
        simulation.run_until(step)
    return samples[-1]


def test_a_merged_link_on_a_moving_one_in_the_frame_of_another_link():
    tags = "<frameName>base</frameName>"
    start = Pose.from_rpy((5, 5, 5), (0.3, 0.2, 0.1))
    joint = (0.5 * math.pi, 2.0)
    sample = motion(p3d(tags, body="tip"), pose=start, joint=joint, angular=(0, 0, 0.7))
    assert (sample.frame, sample.child_frame) == ("robot/base", "robot/tip")
    assert sample.pose.yaw == pytest.approx(0.5 * math.pi + 0.002, abs=1e-4)
    assert sample.pose.position == pytest.approx((0.5, 0, 0), abs=2e-3)
    assert sample.linear == pytest.approx((0, -1.0, 0), abs=1e-2)
    assert sample.angular == pytest.approx((0, 0, 2.0), abs=1e-2)


def test_each_sample_waits_for_a_period():
    samples = readings(p3d("<updateRate>7</updateRate>"), "truth", 1.0)
    assert steps(samples) == [143 * k for k in range(1, 7)]
