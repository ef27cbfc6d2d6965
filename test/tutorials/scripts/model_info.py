#!/usr/bin/env python3
"""What the world and the rover are made of."""

import rospy
from gazebo_msgs.srv import GetLinkProperties, GetModelProperties, GetWorldProperties

rospy.init_node("model_info")
rospy.wait_for_service("/gazebo/get_world_properties")
world = rospy.ServiceProxy("/gazebo/get_world_properties", GetWorldProperties)()
print("models:", " ".join(world.model_names))
rover = rospy.ServiceProxy("/gazebo/get_model_properties", GetModelProperties)("rover")
print("bodies:", " ".join(sorted(rover.body_names)))
print("joints:", " ".join(sorted(rover.joint_names)))
print("static:", rover.is_static)
wheel = rospy.ServiceProxy("/gazebo/get_link_properties", GetLinkProperties)("rover::left_wheel")
print("mass: %.3f" % wheel.mass)
