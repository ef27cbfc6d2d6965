#!/usr/bin/env python3
"""The robot job says what of somebody's robot acts, and drives it a metre and a turn."""

import json
import os
import tempfile
import unittest

import rostest
from lab_testing import PACKAGE, run_job

FOLDER = tempfile.TemporaryDirectory()
TUTORIALS = PACKAGE / "test" / "tutorials"
# Two driven wheels with their own odometry, a sonar of somebody else's make, and a tag too many.
CART = """<robot name="cart" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="rate" default="10"/>
  <xacro:macro name="part" params="name mass size radius z">
    <link name="${name}">
      <inertial><origin xyz="0 0 ${z}"/><mass value="${mass}"/>
        <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial>
      <visual><origin xyz="0 0 ${z}"/><geometry><box size="${size}"/></geometry></visual>
      <xacro:if value="${radius > 0}">
        <collision><geometry><sphere radius="${radius}"/></geometry></collision></xacro:if>
    </link>
  </xacro:macro>
  <xacro:part name="base" mass="4" size="0.4 0.25 0.1" radius="0" z="0.08"/>
  <xacro:macro name="wheel" params="side y">
    <xacro:part name="${side}_wheel" mass="0.5" size="0.1 0.02 0.1" radius="0.06" z="0"/>
    <joint name="${side}_joint" type="continuous"><parent link="base"/>
      <child link="${side}_wheel"/><origin xyz="0 ${y} 0.06"/><axis xyz="0 1 0"/></joint>
  </xacro:macro>
  <xacro:wheel side="left" y="0.15"/>
  <xacro:wheel side="right" y="-0.15"/>
  <xacro:macro name="ball" params="x">
    <xacro:part name="ball_${x}" mass="0.1" size="0.02 0.02 0.02" radius="0.03" z="0"/>
    <joint name="ball_joint_${x}" type="fixed"><parent link="base"/><child link="ball_${x}"/>
      <origin xyz="${x} 0 0.03"/></joint>
    <gazebo reference="ball_${x}"><mu1>0</mu1><mu2>0</mu2></gazebo>
  </xacro:macro>
  <xacro:ball x="0.17"/>
  <xacro:ball x="-0.17"/>
  <gazebo>
    <plugin name="wheels" filename="libgazebo_ros_diff_drive.so">
      <leftJoint>left_joint</leftJoint><rightJoint>right_joint</rightJoint>
      <wheelSeparation>0.3</wheelSeparation><wheelDiameter>0.12</wheelDiameter>
      <commandTopic>go</commandTopic><odometryTopic>wheels/odom</odometryTopic>
      <odometrySource>encoder</odometrySource><updateRate>$(arg rate)</updateRate>
      <warpFactor>9</warpFactor>
    </plugin>
    <plugin name="sonar" filename="libsomebodys_sonar.so"/>
  </gazebo>
</robot>"""


class RobotJobTest(unittest.TestCase):
    """One run for each kind of file."""

    def run_job(self, *words):
        out, printed = run_job("robot", *words, folder=FOLDER.name)
        for name in ("robot.png", "robot.md", "truth.tum"):
            self.assertTrue((out / name).stat().st_size, name)
        return json.loads((out / "summary.json").read_text()), printed

    def test_xacro(self):
        path = os.path.join(FOLDER.name, "cart.urdf.xacro")
        with open(path, "w") as file:
            file.write(CART)
        summary, printed = self.run_job(f"urdf:={path}", "args:=rate:=25")
        wheels, sonar = summary["robot"]["plugins"]
        self.assertEqual((["/go"], True), (wheels["inputs"], wheels["acts"]))
        self.assertEqual(["warpFactor"], wheels["tags_not_simulated"])
        self.assertFalse(sonar["acts"])
        self.assertEqual(["sonar (libsomebodys_sonar.so)"], summary["left_out"])
        self.assertIn("libsomebodys_sonar.so", printed)
        self.assertAlmostEqual(25.0, summary["topics"]["/wheels/odom"]["seen_hz"], delta=0.1)
        self.assertEqual(([], []), (summary["silent"], summary["off_rate"]))
        metre, turn = summary["drive"]["metre"], summary["drive"]["turn"]
        self.assertAlmostEqual(1.0, metre["truth"]["ahead_m"], delta=0.05)
        self.assertLess(metre["odometry_error_percent"], 2.0)
        self.assertAlmostEqual(360.0, turn["odometry"]["turned_deg"], delta=10.0)
        self.assertTrue(turn["moved"])
        self.assertLess(summary["tilt_deg"], 1.0)

    def test_launch_file_that_spawns(self):
        # Its package is not in ROS_PACKAGE_PATH.
        world = "world:=package://bullet_lab/worlds/empty.world"
        file = TUTORIALS / "launch" / "rover.launch"
        # The rover, and not the first that comes.
        summary, printed = self.run_job(f"urdf:={file}", world, "model:=rover", "speed:=0.5")
        self.assertEqual("rover", summary["robot"]["name"])
        self.assertTrue(summary["drive"]["metre"]["moved"], printed)
        self.assertEqual([], summary["silent"])

    def test_what_cannot_be_driven_is_shown(self):
        summary, printed = self.run_job(f"urdf:={TUTORIALS / 'urdf' / 'pendulum.urdf'}")
        self.assertEqual({}, summary["drive"])
        self.assertIn("it is shown, not driven", printed)

    def test_a_file_that_is_not_there(self):
        _, printed = run_job("robot", "urdf:=nothing.urdf", folder=FOLDER.name, status=2)
        self.assertIn("urdf is 'nothing.urdf': it must be a file that exists", printed)


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "robot_job_test", "__main__")
