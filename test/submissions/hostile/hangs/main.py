#!/usr/bin/env python3
"""Waits for a message that never comes."""

import rospy
from std_msgs.msg import Empty

rospy.init_node("hangs")
rospy.wait_for_message("nobody_publishes_this", Empty)
