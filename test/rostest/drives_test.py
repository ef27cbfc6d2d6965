#!/usr/bin/env python3
"""A Kobuki on the topics that programs for it use."""


import rospy
import rostest
from bridge_testing import call, spawn, twist
from gazebo_msgs.srv import GetModelState
from geometry_msgs.msg import Twist
from kobuki_msgs.msg import BumperEvent, MotorPower, SensorState
from lab_testing import PACKAGE, NodeTest, wait_for
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu
from std_msgs.msg import Empty


def place(model):
    """Return the place of a model in the world."""
    return call("/gazebo/get_model_state", GetModelState, model, "world").pose.position


class DrivesTest(NodeTest):
    """The robot is spawned by the service that launch files use."""

    @classmethod
    def setUpClass(cls):
        """Spawn the robot."""
        text = (PACKAGE / "urdf" / "kobuki_robot.urdf").read_text()
        answer = spawn("kobuki", text, service="spawn_urdf_model")
        assert answer.success, answer.status_message

    def test_a_kobuki_bumps_into_a_wall(self):
        bumper = self.topic("mobile_base/events/bumper", BumperEvent)
        core = self.topic("mobile_base/sensors/core", SensorState)
        imu = self.topic("mobile_base/sensors/imu_data", Imu).wait(1)[0]
        self.assertEqual(("base_link", 0.05), (imu.header.frame_id, imu.orientation_covariance[8]))
        odometry = self.topic("odom", Odometry)
        command = self.publisher("mobile_base/commands/velocity", Twist)
        wait_for(lambda: command.publish(twist(0.3)) or bumper.messages, "the wall to be touched")
        command.publish(twist())
        event = bumper.messages[0]
        self.assertEqual((BumperEvent.CENTER, BumperEvent.PRESSED), (event.bumper, event.state))

        def pressed():
            return [m for m in core.messages if m.bumper == SensorState.BUMPER_CENTRE]

        wait_for(pressed, "core")
        # Afterwards, the wheels slip until the command to stop comes.
        touched = pressed()[0].header.stamp
        wait_for(lambda: odometry.messages[-1].header.stamp >= touched, "odometry")
        before = [m for m in odometry.messages if m.header.stamp <= touched]
        at_the_wall = 0.95 - 0.177
        self.assertAlmostEqual(at_the_wall, before[-1].pose.pose.position.x, delta=0.05)
        self.assertAlmostEqual(at_the_wall, place("kobuki").x, delta=0.05)
        self.publisher("mobile_base/commands/motor_power", MotorPower).publish(MotorPower.OFF)
        zero = self.publisher("mobile_base/commands/reset_odometry", Empty)

        def is_zero():
            # Again, as the wheels may still slip when the first one comes.
            zero.publish()
            return abs(odometry.messages[-1].pose.pose.position.x) < 0.01

        wait_for(is_zero, "the odometry")

if __name__ == "__main__":
    rospy.init_node("drives_test")
    rostest.rosrun("bullet_lab", "drives_test", DrivesTest)
