#!/usr/bin/env python3
"""Drives on the topics that programs for them use: a Kobuki, and a car in the root namespace."""

from bridge_testing import at, call, place_of, spawn, twist
from controller_manager_msgs.srv import LoadController, SwitchController
from geometry_msgs.msg import Twist
from kobuki_msgs.msg import BumperEvent, MotorPower, SensorState
from lab_testing import PACKAGE, NodeTest, run_tests, wait_for
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu
from std_msgs.msg import Empty

SPACE = "<robotNamespace>/car</robotNamespace>"
ROOT_SPACE = "<robotNamespace>/</robotNamespace><robotParam>/car/robot_description</robotParam>"


class DrivesTest(NodeTest):
    """Each robot is spawned by the services that launch files use."""

    @classmethod
    def setUpClass(cls):
        """Spawn the robots, and start the car's controller."""
        for name, path, y in (
            ("kobuki", "urdf/kobuki_robot.urdf", 0.0),
            ("car", "test/drives/car.urdf", -8.0),
        ):
            text = (PACKAGE / path).read_text().replace(SPACE, ROOT_SPACE)
            answer = spawn(name, text, at(0.0, y, 0.0), service="spawn_urdf_model")
            assert answer.success, answer.status_message
        assert call("/controller_manager/load_controller", LoadController, "drive").ok
        switch = (["drive"], [], 2, False, 10.0)
        assert call("/controller_manager/switch_controller", SwitchController, *switch).ok

    def drive(self, velocity, until, what, *topics):
        """Command a velocity on topics until something holds, then stop."""
        commands = [self.publisher(topic, Twist) for topic in topics]

        def holds():
            for one in commands:
                one.publish(velocity)
            return until()

        wait_for(holds, what)
        for one in commands:
            one.publish(Twist())

    def test_a_kobuki_bumps_into_a_wall(self):
        bumper = self.topic("mobile_base/events/bumper", BumperEvent)
        core = self.topic("mobile_base/sensors/core", SensorState)
        imu = self.topic("mobile_base/sensors/imu_data", Imu).wait(1)[0]
        self.assertEqual(("base_link", 0.05), (imu.header.frame_id, imu.orientation_covariance[8]))
        odometry = self.topic("odom", Odometry)
        touches = (lambda: bumper.messages, "the wall to be touched")
        self.drive(twist(0.3), *touches, "mobile_base/commands/velocity")
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
        self.assertAlmostEqual(at_the_wall, place_of("kobuki")[0], delta=0.05)
        self.publisher("mobile_base/commands/motor_power", MotorPower).publish(MotorPower.OFF)
        zero = self.publisher("mobile_base/commands/reset_odometry", Empty)

        def is_zero():
            # Again, as the wheels may still slip when the first one comes.
            zero.publish()
            return abs(odometry.position().x) < 0.01

        wait_for(is_zero, "the odometry")

    def test_joint_limits_in_the_root_namespace_count(self):
        odometry = self.topic("drive/odom", Odometry)
        begun = place_of("car")[0]

        def drives():
            return odometry.wait(1) and odometry.position().x > 0.3

        self.drive(twist(1.0), drives, "the car to drive", "drive/cmd_vel")
        speeds = [message.twist.twist.linear.x for message in odometry.messages]
        self.assertAlmostEqual(0.1, max(speeds), delta=0.005)
        self.assertGreater(place_of("car")[0], begun + 0.25)


if __name__ == "__main__":
    run_tests()
