#!/usr/bin/env python3
"""Sends commands without a pause."""

import rospy
from geometry_msgs.msg import Twist

rospy.init_node("floods")
velocities = rospy.Publisher("cmd_vel", Twist, queue_size=1)
while not rospy.is_shutdown():
    velocities.publish(Twist())
