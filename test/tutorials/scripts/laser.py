#!/usr/bin/env python3
"""Reads the laser scanner of the rover."""

import rospy
from sensor_msgs.msg import LaserScan

rospy.init_node("laser")
scan = rospy.wait_for_message("scan", LaserScan, timeout=10)
ahead = scan.ranges[len(scan.ranges) // 2]
print("frame:", scan.header.frame_id)
print("rays:", len(scan.ranges))
print("ahead: %.3f" % ahead)
print("free:", sum(r == float("inf") for r in scan.ranges))
print("angles: %.3f %.3f" % (scan.angle_min, scan.angle_max))
print("ranges: %.1f %.1f" % (scan.range_min, scan.range_max))
