#!/usr/bin/env python3
"""Stops time, lets it go on, and puts everything back to where it was."""

import time

import rospy
from gazebo_msgs.srv import DeleteModel, GetModelState, SpawnModel
from geometry_msgs.msg import Point, Pose, Quaternion
from std_srvs.srv import Empty

CRATE = '<sdf version="1.6"><include><uri>model://crate</uri></include></sdf>'

rospy.init_node("pause_and_reset")
rospy.wait_for_service("/gazebo/pause_physics")
pause = rospy.ServiceProxy("/gazebo/pause_physics", Empty)
unpause = rospy.ServiceProxy("/gazebo/unpause_physics", Empty)
get_state = rospy.ServiceProxy("/gazebo/get_model_state", GetModelState)

pause()
spawn = rospy.ServiceProxy("/gazebo/spawn_sdf_model", SpawnModel)
pose = Pose(Point(0, 50, 5), Quaternion(0, 0, 0, 1))
print("while paused:", spawn("faller", CRATE, "", pose, "").success)
first = get_state("faller", "").header.stamp
time.sleep(0.2)
print("stands: %.3f" % (get_state("faller", "").header.stamp - first).to_sec())
unpause()
rospy.sleep(0.4)
state = get_state("faller", "")
print("fallen:", state.pose.position.z < 5.0)
rospy.ServiceProxy("/gazebo/reset_world", Empty)()
pause()
after = get_state("faller", "")
print("back:", after.pose.position.z > 5.0)
print("time goes on:", after.header.stamp >= state.header.stamp)
rospy.ServiceProxy("/gazebo/reset_simulation", Empty)()
print("time from zero: %.3f" % get_state("faller", "").header.stamp.to_sec())
unpause()
rospy.ServiceProxy("/gazebo/delete_model", DeleteModel)("faller")
