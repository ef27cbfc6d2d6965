#!/usr/bin/env python
"""Finds a marker beside the camera's picture, shows both, and asks tf where the laser is."""

import cv2
import numpy as np
import rospy
import tf
from cv2 import aruco
from cv_bridge import CvBridge
from sensor_msgs.msg import Image

rospy.init_node("marker_window")
listener = tf.TransformListener()
message = rospy.wait_for_message("rover/camera/image_raw", Image, timeout=20)
picture = CvBridge().imgmsg_to_cv2(message, "bgr8")

dictionary = aruco.Dictionary_get(aruco.DICT_4X4_50)
marker = cv2.copyMakeBorder(aruco.drawMarker(dictionary, 7, 120), 20, 20, 20, 20, 0, value=255)
picture[:160, :160] = cv2.cvtColor(marker, cv2.COLOR_GRAY2BGR)
parameters = aruco.DetectorParameters_create()
corners, ids, rejected = aruco.detectMarkers(picture, dictionary, parameters=parameters)
rvecs, tvecs, _ = aruco.estimatePoseSingleMarkers(corners, 0.1, np.eye(3), np.zeros(5))
aruco.drawDetectedMarkers(picture, corners, ids)
aruco.drawAxis(picture, np.eye(3), np.zeros(5), rvecs[0], tvecs[0], 0.05)
cv2.imshow("camera", picture)
cv2.waitKey(100)

listener.waitForTransform("base_footprint", "laser", rospy.Time(0), rospy.Duration(10))
(x, y, z), rotation = listener.lookupTransform("base_footprint", "laser", rospy.Time(0))
angles = tf.transformations.euler_from_quaternion(rotation)

print("opencv:", cv2.__version__.split(".")[0])
print("marker:", ids.tolist(), len(tvecs))
print("window:", cv2.getWindowProperty("camera", cv2.WND_PROP_AUTOSIZE) > 0)
print("laser: %.3f %.3f %.3f" % (x, y, z))
print("turned: %.3f" % max(map(abs, angles)))
