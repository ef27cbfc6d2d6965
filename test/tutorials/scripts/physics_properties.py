#!/usr/bin/env python3
"""Takes the yard to the Moon, where things fall slowly, and back."""

import rospy
from gazebo_msgs.srv import (
    DeleteModel,
    GetModelState,
    GetPhysicsProperties,
    SetPhysicsProperties,
    SpawnModel,
)
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3

CRATE = '<sdf version="1.6"><include><uri>model://crate</uri></include></sdf>'

rospy.init_node("moon")
rospy.wait_for_service("/gazebo/get_physics_properties")
get_physics = rospy.ServiceProxy("/gazebo/get_physics_properties", GetPhysicsProperties)
set_physics = rospy.ServiceProxy("/gazebo/set_physics_properties", SetPhysicsProperties)
get_state = rospy.ServiceProxy("/gazebo/get_model_state", GetModelState)

earth = get_physics()
print("earth: %.2f" % earth.gravity.z)
print("step: %g" % earth.time_step)
moon = Vector3(0, 0, -1.62)
print("set:", set_physics(earth.time_step, earth.max_update_rate, moon, earth.ode_config).success)
pose = Pose(Point(0, 20, 100), Quaternion(0, 0, 0, 1))
rospy.ServiceProxy("/gazebo/spawn_sdf_model", SpawnModel)("stone", CRATE, "", pose, "")
first = get_state("stone", "")
rospy.sleep(1.0)
second = get_state("stone", "")
seconds = (second.header.stamp - first.header.stamp).to_sec()
gained = second.twist.linear.z - first.twist.linear.z
print("acceleration: %.3f" % (gained / seconds))
set_physics(earth.time_step, earth.max_update_rate, earth.gravity, earth.ode_config)
print("back: %.2f" % get_physics().gravity.z)
rospy.ServiceProxy("/gazebo/delete_model", DeleteModel)("stone")
