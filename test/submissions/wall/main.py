#!/usr/bin/env python3
"""Drives ahead until the ray ahead is shorter than a distance."""

import rospy
from geometry_msgs.msg import Twist
from sensor_msgs.msg import LaserScan

DISTANCE = 0.51

rospy.init_node("wall")
velocities = rospy.Publisher("cmd_vel", Twist, queue_size=1)
while velocities.get_num_connections() == 0:
    rospy.rostime.wallsleep(0.01)
while True:
    scan = rospy.wait_for_message("scan", LaserScan)
    ahead = scan.ranges[round(-scan.angle_min / scan.angle_increment)]
    twist = Twist()
    twist.linear.x = max(0.03, min(0.2, 0.5 * (ahead - DISTANCE)))
    if ahead < DISTANCE:
        break
    velocities.publish(twist)
velocities.publish(Twist())
rospy.sleep(0.2)
