#!/usr/bin/env python3
"""Drives to places by odometry."""

import math

import rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry

PLACES = ((1, 0), (1, 1), (0, 1), (0, 0))

rospy.init_node("places")
velocities = rospy.Publisher("cmd_vel", Twist, queue_size=1)
odometry = []
rospy.Subscriber("odom", Odometry, lambda m: odometry.append(m.pose.pose), queue_size=1)
while not odometry or velocities.get_num_connections() == 0:
    rospy.rostime.wallsleep(0.01)


def pose():
    q = odometry[-1].orientation
    return odometry[-1].position.x, odometry[-1].position.y, 2 * math.atan2(q.z, q.w)


def drive(forward, turn, seconds):
    twist = Twist()
    twist.linear.x, twist.angular.z = forward, turn
    velocities.publish(twist)
    rospy.sleep(seconds)


for x, y in PLACES:
    while True:
        px, py, yaw = pose()
        away = math.hypot(x - px, y - py)
        error = math.atan2(y - py, x - px) - yaw
        error = math.atan2(math.sin(error), math.cos(error))
        if away < 0.05:
            break
        drive(0.2 if abs(error) < 0.2 else 0.0, max(-0.8, min(0.8, 2 * error)), 0.05)
drive(0, 0, 0.2)
