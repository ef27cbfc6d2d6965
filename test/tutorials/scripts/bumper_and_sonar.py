#!/usr/bin/env python3
"""A post that feels the ground and measures the distance of a crate."""

import os

import rospy
from gazebo_msgs.msg import ContactsState
from gazebo_msgs.srv import DeleteModel, SpawnModel
from geometry_msgs.msg import Point, Pose, Quaternion
from sensor_msgs.msg import Range

HERE = os.path.dirname(os.path.abspath(__file__))

rospy.init_node("bumper_and_sonar")
rospy.wait_for_service("/gazebo/spawn_urdf_model")
with open(os.path.join(HERE, "..", "urdf", "lookout.urdf")) as f:
    pose = Pose(Point(0, -30, 0), Quaternion(0, 0, 0, 1))
    spawn = rospy.ServiceProxy("/gazebo/spawn_urdf_model", SpawnModel)
    spawn("post", f.read(), "/post", pose, "world")
crate = '<sdf version="1.6"><include><uri>model://crate</uri></include></sdf>'
pose = Pose(Point(1.31, -30, 0.3), Quaternion(0, 0, 0, 1))
rospy.ServiceProxy("/gazebo/spawn_sdf_model", SpawnModel)("target", crate, "", pose, "")

reading = rospy.wait_for_message("/post/sonar", Range, timeout=10)
print("sonar: %.3f" % reading.range)
print("ultrasound:", reading.radiation_type == Range.ULTRASOUND)
contacts = rospy.wait_for_message("/post/bumper", ContactsState, timeout=10)
while not contacts.states:
    contacts = rospy.wait_for_message("/post/bumper", ContactsState, timeout=10)
state = contacts.states[0]
print("touches:", state.collision1_name, state.collision2_name)
print("weight: %.1f" % state.total_wrench.force.z)
for name in ("post", "target"):
    rospy.ServiceProxy("/gazebo/delete_model", DeleteModel)(name)
