#!/usr/bin/env python3
"""Turns a joint by a torque and sets it back."""

import os

import rospy
from gazebo_msgs.srv import (
    ApplyJointEffort,
    DeleteModel,
    GetJointProperties,
    JointRequest,
    SetModelConfiguration,
    SpawnModel,
)
from geometry_msgs.msg import Point, Pose, Quaternion

HERE = os.path.dirname(os.path.abspath(__file__))

rospy.init_node("joint_effort")
rospy.wait_for_service("/gazebo/spawn_urdf_model")
with open(os.path.join(HERE, "..", "urdf", "pendulum.urdf")) as f:
    pose = Pose(Point(0, -6, 0.1), Quaternion(0, 0, 0, 1))
    rospy.ServiceProxy("/gazebo/spawn_urdf_model", SpawnModel)("swing", f.read(), "", pose, "")
joint = rospy.ServiceProxy("/gazebo/get_joint_properties", GetJointProperties)
effort = rospy.ServiceProxy("/gazebo/apply_joint_effort", ApplyJointEffort)

# 1 N m on 0.5 kg m2 for half a second: 1 rad/s.
print("applied:", effort("hinge", 1.0, rospy.Time(), rospy.Duration(0.5)).success)
rospy.sleep(0.7)
print("rate: %.3f" % joint("hinge").rate[0])
rospy.ServiceProxy("/gazebo/clear_joint_forces", JointRequest)("hinge")
print("unknown:", effort("elbow", 1.0, rospy.Time(), rospy.Duration(1)).success)
configure = rospy.ServiceProxy("/gazebo/set_model_configuration", SetModelConfiguration)
print("configured:", configure("swing", "robot_description", ["hinge"], [0.5]).success)
print("position: %.3f" % joint("hinge").position[0])
rospy.ServiceProxy("/gazebo/delete_model", DeleteModel)("swing")
