#!/usr/bin/env python3
"""Adds normal noise to each message."""

import random

import rospy
from nav_msgs.msg import Odometry

random.seed(1)


def add_noise(message):
    message.pose.pose.position.x += random.gauss(0.0, 0.1)
    message.pose.pose.position.y += random.gauss(0.0, 0.1)
    noisy.publish(message)


rospy.init_node("noise")
noisy = rospy.Publisher("noisy_odom", Odometry, queue_size=10)
rospy.Subscriber("odom", Odometry, add_noise)
rospy.spin()
