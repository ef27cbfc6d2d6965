#!/usr/bin/env python3
"""The robot job lists what of a robot is simulated, and drives it a metre and a turn."""

import os
import tempfile
import unittest

from lab_testing import PACKAGE, run_job, run_tests

FOLDER = tempfile.TemporaryDirectory()
TUTORIALS = PACKAGE / "test" / "tutorials"
# Two driven wheels with their own odometry, a sonar that is not simulated, and a tag too many.
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

# A robot that stands in the world file, before a wall; one arm of it has a strange controller.
LINK = """<link name="{0}"><pose>{1} 0 0 0</pose><inertial><mass>5</mass></inertial>
  <collision name="c"><geometry><box><size>{2}</size></box></geometry>
    <surface><friction><ode><mu>0</mu></ode></friction></surface></collision></link>"""
WORLD = f"""<sdf version="1.6"><world name="lab"><include><uri>model://ground_plane</uri></include>
  <model name="house"><static>1</static>{LINK.format("wall_3", "0.9 0 0.5", "0.1 4 1")}</model>
  <model name="rover">{LINK.format("base", "0 0 0.1", "0.3 0.3 0.2")}
    <link name="arm"><pose>0 0 0.5 0 0 0</pose></link>
    <joint name="hinge" type="revolute"><parent>base</parent><child>arm</child>
      <axis><xyz>0 0 1</xyz></axis></joint>
    <plugin name="wheels" filename="libgazebo_ros_planar_move.so"/>
    <plugin name="control" filename="libgazebo_ros_control.so">
      <robotNamespace>/</robotNamespace></plugin>
  </model></world></sdf>"""
KIND = "pos_vel_controllers/JointTrajectoryController"
LAUNCH = f"""<launch>
  <include file="$(find gazebo_ros)/launch/empty_world.launch">
    <arg name="world_name" value="{FOLDER.name}/lab.world"/><arg name="gui" value="false"/>
    <arg name="paused" value="true"/></include>
  <param name="robot_description" value="&lt;robot name='rover'>&lt;link name='base'/>&lt;/robot>"/>
  <param name="arm/type" value="{KIND}"/>
  <node name="load" pkg="rosservice" type="rosservice"
        args="call --wait /controller_manager/load_controller arm"/>
  <node name="map" pkg="gmapping" type="slam_gmapping"/>
  <node name="fails" pkg="rostopic" type="rostopic" args="bogus"/>
</launch>"""


class RobotJobTest(unittest.TestCase):
    """One run for each kind of file."""

    def run_job(self, *words, status=0):
        run = run_job("robot", *words, status=status)
        for name in ("robot.png", "robot.md", "truth.tum"):
            self.assertTrue((run.out / name).stat().st_size, name)
        return run.summary, run.printed

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
        self.assertNotIn("without a picture", printed)
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

    def test_what_goes_wrong_is_said(self):
        for name, text in (("lab.world", WORLD), ("lab.launch", LAUNCH)):
            with open(os.path.join(FOLDER.name, name), "w") as file:
                file.write(text)
        file = os.path.join(FOLDER.name, "lab.launch")
        summary, printed = self.run_job(f"urdf:={file}", "speed:=0.5", "turn_rate:=2", status=1)
        self.assertEqual("rover", summary["robot"]["name"])
        self.assertTrue(summary["finished"])
        self.assertEqual([f"arm ({KIND})"], summary["left_out"])
        self.assertIn(f"controller 'arm': the type '{KIND}' is not simulated", printed)
        missing, died = summary["not_started"]
        self.assertIn("gmapping/slam_gmapping: there is no ROS package 'gmapping'", missing)
        self.assertRegex(died, r"fails-\d+ has died \(exit code \d+\)")
        metre = summary["drive"]["metre"]
        self.assertIn("touches house::wall_3", metre["reasons"])
        self.assertIn("metre: 0.70 of 1 m: touches house::wall_3", printed)
        self.assertFalse(summary["drive"]["turn"]["failed"])

    def test_what_cannot_be_driven_is_shown(self):
        summary, printed = self.run_job(f"urdf:={TUTORIALS / 'urdf' / 'pendulum.urdf'}")
        self.assertEqual({}, summary["drive"])
        self.assertIn("it is shown, not driven", printed)


if __name__ == "__main__":
    run_tests(node=False)
