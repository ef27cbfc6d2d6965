#!/usr/bin/env python3
"""Spawns a crate by the functions of gazebo_ros."""

import os

import rospkg
import rospy
from gazebo_msgs.srv import DeleteModel
from gazebo_ros import gazebo_interface
from geometry_msgs.msg import Pose

rospy.init_node("spawner")
path = rospkg.RosPack().get_path("tutorials")
with open(os.path.join(path, "models", "crate", "model.sdf")) as f:
    crate = f.read()
pose = Pose()
pose.position.x = 33.0
spawn = gazebo_interface.spawn_sdf_model_client
for _ in range(2):
    print("spawned:", spawn("boxed", crate, "", pose, "world", "/gazebo"))
rospy.ServiceProxy("/gazebo/delete_model", DeleteModel)("boxed")
