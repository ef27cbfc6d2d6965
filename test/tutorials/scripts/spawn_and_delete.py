#!/usr/bin/env python3
"""Spawns a row of crates and deletes one of them again."""

import os

import rospy
from gazebo_msgs.srv import DeleteModel, GetWorldProperties, SpawnModel
from geometry_msgs.msg import Point, Pose, Quaternion

HERE = os.path.dirname(os.path.abspath(__file__))

rospy.init_node("spawn_and_delete")
for service in ("spawn_sdf_model", "delete_model", "get_world_properties"):
    rospy.wait_for_service("/gazebo/" + service)
spawn = rospy.ServiceProxy("/gazebo/spawn_sdf_model", SpawnModel)
delete = rospy.ServiceProxy("/gazebo/delete_model", DeleteModel)
world = rospy.ServiceProxy("/gazebo/get_world_properties", GetWorldProperties)

with open(os.path.join(HERE, "..", "models", "crate", "model.sdf")) as f:
    crate = f.read()
for i in range(3):
    pose = Pose(Point(i, 8, 0), Quaternion(0, 0, 0, 1))
    print("spawned:", spawn("crate_%d" % i, crate, "", pose, "world").status_message)
print("again:", spawn(model_name="crate_0", model_xml=crate).status_message)
print("deleted:", delete("crate_1").success, delete("crate_1").success)
print("left:", " ".join(name for name in world().model_names if name.startswith("crate")))
for name in ("crate_0", "crate_2"):
    delete(name)
