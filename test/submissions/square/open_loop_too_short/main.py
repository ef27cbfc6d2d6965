#!/usr/bin/env python3
"""Turns for too short a time at each corner."""

import rospy
from geometry_msgs.msg import Twist

rospy.init_node("square")
velocities = rospy.Publisher("cmd_vel", Twist, queue_size=1)
while velocities.get_num_connections() == 0:
    rospy.rostime.wallsleep(0.01)
for _ in range(4):
    for forward, turn, seconds in ((0.2, 0.0, 5.0), (0.0, 0.5, 2.4)):
        twist = Twist()
        twist.linear.x, twist.angular.z = forward, turn
        velocities.publish(twist)
        rospy.sleep(seconds)
velocities.publish(Twist())
rospy.sleep(0.2)
