#!/usr/bin/env python3
"""Pushes a crate that slides without friction."""

import rospy
from gazebo_msgs.srv import ApplyBodyWrench, BodyRequest, DeleteModel, GetModelState, SpawnModel
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3, Wrench

CRATE = '<sdf version="1.6"><include><uri>model://crate</uri></include></sdf>'

rospy.init_node("push")
rospy.wait_for_service("/gazebo/spawn_sdf_model")
pose = Pose(Point(-5, -5, 0), Quaternion(0, 0, 0, 1))
rospy.ServiceProxy("/gazebo/spawn_sdf_model", SpawnModel)("puck", CRATE, "", pose, "")
get_state = rospy.ServiceProxy("/gazebo/get_model_state", GetModelState)
apply_wrench = rospy.ServiceProxy("/gazebo/apply_body_wrench", ApplyBodyWrench)
clear = rospy.ServiceProxy("/gazebo/clear_body_wrenches", BodyRequest)

# 4 N on 2 kg for half a second: 1 m/s.
push = Wrench(force=Vector3(4, 0, 0))
half = rospy.Duration(0.5)
print("pushed:", apply_wrench("puck::link", "", Point(), push, rospy.Time(), half).success)
rospy.sleep(0.7)
print("speed: %.3f" % get_state("puck", "").twist.linear.x)

# A push without an end, taken away at once.
apply_wrench("puck::link", "", Point(), push, rospy.Time(), rospy.Duration(-1))
clear("puck::link")
before = get_state("puck", "").twist.linear.x
rospy.sleep(0.2)
print("gained: %.3f" % (get_state("puck", "").twist.linear.x - before))
rospy.ServiceProxy("/gazebo/delete_model", DeleteModel)("puck")
