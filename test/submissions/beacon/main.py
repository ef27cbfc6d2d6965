#!/usr/bin/env python3
"""Measures the distance to a beacon along a drive."""

import math

import rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from std_msgs.msg import Float64

BEACON = 1.0, 1.0
EVERY = 1

rospy.init_node("beacon")
velocities = rospy.Publisher("cmd_vel", Twist, queue_size=1)
distances = rospy.Publisher("distance", Float64, queue_size=1)
least, count = math.inf, 0
ahead = Twist()
ahead.linear.x = 0.2
while distances.get_num_connections() == 0 or velocities.get_num_connections() == 0:
    rospy.rostime.wallsleep(0.01)
messages = []
rospy.Subscriber("odom", Odometry, messages.append)
while not messages or messages[-1].pose.pose.position.x < 1.98:
    while len(messages) <= count:
        rospy.rostime.wallsleep(0.001)
    place = messages[-1].pose.pose.position
    count = len(messages)
    velocities.publish(ahead)
    distance = math.hypot(BEACON[0] - place.x, BEACON[1] - place.y)
    if count % EVERY == 0:
        distances.publish(distance)
    least = min(least, distance)
velocities.publish(Twist())
with open("least.txt", "w") as file:
    file.write(f"{least:.3f}\n")
rospy.sleep(0.2)
