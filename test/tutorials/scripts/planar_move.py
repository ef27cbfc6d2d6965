#!/usr/bin/env python3
"""Two hovercraft, each in a namespace of its own; one of them moves sideways."""

import os

import rospy
from gazebo_msgs.srv import DeleteModel, SpawnModel
from geometry_msgs.msg import Point, Pose, Quaternion, Twist
from nav_msgs.msg import Odometry

HERE = os.path.dirname(os.path.abspath(__file__))

rospy.init_node("hover")
rospy.wait_for_service("/gazebo/spawn_urdf_model")
spawn = rospy.ServiceProxy("/gazebo/spawn_urdf_model", SpawnModel)
with open(os.path.join(HERE, "..", "urdf", "hovercraft.urdf")) as f:
    robot = f.read()
for name, x in (("one", -10), ("two", -12)):
    pose = Pose(Point(x, 0, 0), Quaternion(0, 0, 0, 1))
    print("spawned:", spawn(name, robot, name, pose, "").success)

publisher = rospy.Publisher("one/cmd_vel", Twist, queue_size=1)
command = Twist()
command.linear.y = 0.5
while publisher.get_num_connections() == 0:
    rospy.sleep(0.01)
publisher.publish(command)
rospy.sleep(1.0)
publisher.publish(Twist())
one = rospy.wait_for_message("one/odom", Odometry, timeout=10)
two = rospy.wait_for_message("two/odom", Odometry, timeout=10)
print("one: %.2f %.2f" % (one.pose.pose.position.x, one.pose.pose.position.y))
print("two: %.2f %.2f" % (two.pose.pose.position.x, two.pose.pose.position.y))
for name in ("one", "two"):
    rospy.ServiceProxy("/gazebo/delete_model", DeleteModel)(name)
