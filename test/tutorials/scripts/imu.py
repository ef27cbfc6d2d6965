#!/usr/bin/env python3
"""Feels gravity."""

import rospy
from sensor_msgs.msg import Imu

rospy.init_node("imu_listener")
imu = rospy.wait_for_message("imu", Imu, timeout=10)
print("frame:", imu.header.frame_id)
print("up: %.2f" % imu.linear_acceleration.z)
print("turning: %.3f" % imu.angular_velocity.z)
print("level: %.3f" % imu.orientation.w)
