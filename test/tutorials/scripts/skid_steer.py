#!/usr/bin/env python3
"""A robot on four wheels turns on the spot; its description is xacro."""

import math
import os
import subprocess

import rospkg
import rospy
from gazebo_msgs.srv import DeleteModel, SpawnModel
from geometry_msgs.msg import Point, Pose, Quaternion, Twist
from nav_msgs.msg import Odometry

path = os.path.join(rospkg.RosPack().get_path("tutorials"), "urdf", "four_wheels.urdf.xacro")
robot = subprocess.check_output(["rosrun", "xacro", "xacro", path]).decode()

rospy.init_node("skid_steer")
rospy.wait_for_service("/gazebo/spawn_urdf_model")
pose = Pose(Point(-20, 0, 0.1), Quaternion(0, 0, 0, 1))
spawn = rospy.ServiceProxy("/gazebo/spawn_urdf_model", SpawnModel)
print("spawned:", spawn("four_wheels", robot, "four", pose, "world").success)

publisher = rospy.Publisher("four/cmd_vel", Twist, queue_size=1)
while publisher.get_num_connections() == 0:
    rospy.sleep(0.01)
command = Twist()
command.linear.x = 0.4
publisher.publish(command)
rospy.sleep(0.6)
print("ahead: %.2f" % rospy.wait_for_message("four/odom", Odometry).twist.twist.linear.x)
command.linear.x = 0.0
command.angular.z = 1.0
publisher.publish(command)
rospy.sleep(1.2)
turn = rospy.wait_for_message("four/odom", Odometry).pose.pose.orientation
print("turned: %.2f" % (2.0 * math.atan2(turn.z, turn.w)))
rospy.ServiceProxy("/gazebo/delete_model", DeleteModel)("four_wheels")
