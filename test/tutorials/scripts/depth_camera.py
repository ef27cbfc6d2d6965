#!/usr/bin/env python3
"""Measures how far a crate is, with a depth camera."""

import math
import os
import struct

import rospy
from gazebo_msgs.srv import DeleteModel, SpawnModel
from geometry_msgs.msg import Point, Pose, Quaternion
from sensor_msgs import point_cloud2
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

HERE = os.path.dirname(os.path.abspath(__file__))
BLOCK = """<sdf version="1.6"><model name="block"><static>true</static><link name="link">
<visual name="v"><geometry><box><size>0.4 2 2</size></box></geometry>
<material><diffuse>0 1 0 1</diffuse><ambient>0 1 0 1</ambient></material></visual>
</link></model></sdf>"""

rospy.init_node("depth_camera")
rospy.wait_for_service("/gazebo/spawn_urdf_model")
with open(os.path.join(HERE, "..", "urdf", "lookout.urdf")) as f:
    pose = Pose(Point(0, 30, 0), Quaternion(0, 0, 0, 1))
    rospy.ServiceProxy("/gazebo/spawn_urdf_model", SpawnModel)("lookout", f.read(), "", pose, "")
pose = Pose(Point(2.36, 30, 0.5), Quaternion(0, 0, 0, 1))
rospy.ServiceProxy("/gazebo/spawn_sdf_model", SpawnModel)("block", BLOCK, "", pose, "")

depth = rospy.wait_for_message("kinect/depth/image_raw", Image, timeout=20)
middle = depth.height // 2 * depth.step + depth.width // 2 * 4
print("encoding:", depth.encoding)
print("frame:", depth.header.frame_id)
print("ahead: %.3f" % struct.unpack_from("f", depth.data, middle)[0])
values = struct.unpack("%df" % (depth.width * depth.height), depth.data)
print("sky:", math.isnan(values[0]))

cloud = rospy.wait_for_message("kinect/depth/points", PointCloud2, timeout=20)
pixel = (cloud.width // 2, cloud.height // 2)
(point,) = point_cloud2.read_points(cloud, ("x", "y", "z", "rgb"), uvs=[pixel])
colour = struct.unpack("I", struct.pack("f", point[3]))[0]
print("point: %.3f %.3f %.3f" % point[:3])
print("green:", (colour >> 8) & 255 > 2 * ((colour >> 16) & 255))
print("organised: %d %d" % (cloud.width, cloud.height))
info = rospy.wait_for_message("kinect/depth/camera_info", CameraInfo, timeout=20)
print("focal length: %.2f" % info.K[0])
for name in ("lookout", "block"):
    rospy.ServiceProxy("/gazebo/delete_model", DeleteModel)(name)
