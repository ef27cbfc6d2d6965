#!/usr/bin/env python3
"""Adds up the noise of all messages, as the odometry of the lab does."""

import random

import rospy
from nav_msgs.msg import Odometry

random.seed(1)
error = [0.0, 0.0]


def add_noise(message):
    for k in range(2):
        error[k] += random.gauss(0.0, 0.1)
    message.pose.pose.position.x += error[0]
    message.pose.pose.position.y += error[1]
    noisy.publish(message)


rospy.init_node("noise")
noisy = rospy.Publisher("noisy_odom", Odometry, queue_size=10)
rospy.Subscriber("odom", Odometry, add_noise)
rospy.spin()
