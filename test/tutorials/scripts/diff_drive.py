#!/usr/bin/env python3
"""Drives the rover forward and compares its odometry with the truth; reads its joints."""

import rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState

rospy.init_node("diff_drive")
publisher = rospy.Publisher("cmd_vel", Twist, queue_size=10)
command = Twist()
command.linear.x = 0.5
rate = rospy.Rate(20)


def odometry():
    return rospy.wait_for_message("odom", Odometry, timeout=10)


def drive():
    for _ in range(20):
        publisher.publish(command)
        rate.sleep()
    return odometry()


# Commands take a moment to arrive: the first second is for that.
start, end = drive(), drive()
joints = rospy.wait_for_message("joint_states", JointState, timeout=10)
turning = dict(zip(joints.name, joints.velocity))
publisher.publish(Twist())
seconds = (end.header.stamp - start.header.stamp).to_sec()
driven = end.pose.pose.position.x - start.pose.pose.position.x
rospy.sleep(1.0)
odom = odometry()
truth = rospy.wait_for_message("ground_truth", Odometry, timeout=10)
print("frames:", odom.header.frame_id, odom.child_frame_id)
print("driven in a second: %.3f" % (driven / seconds))
print("off: %.3f" % abs(odom.pose.pose.position.x - truth.pose.pose.position.x))
print("truth in:", truth.header.frame_id)
print("joints:", " ".join(joints.name))
print("wheels: %.2f %.2f" % (turning["left_wheel_joint"], turning["right_wheel_joint"]))
