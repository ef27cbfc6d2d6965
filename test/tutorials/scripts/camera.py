#!/usr/bin/env python3
"""Looks at the red wall through the rover's camera."""

import rospy
from sensor_msgs.msg import CameraInfo, Image

rospy.init_node("camera")
image = rospy.wait_for_message("rover/camera/image_raw", Image, timeout=20)
info = rospy.wait_for_message("rover/camera/camera_info", CameraInfo, timeout=20)
row, column = image.height // 2, image.width // 2
start = row * image.step + 3 * column
red, green, blue = image.data[start : start + 3]
print("frame:", image.header.frame_id)
print("image: %d %d %s" % (image.width, image.height, image.encoding))
print("red:", red > 2 * green and red > 2 * blue)
print("focal length: %.2f" % info.K[0])
print("model:", info.distortion_model, len(info.D))
print("baseline: %.3f" % (-info.P[3] / info.P[0]))
