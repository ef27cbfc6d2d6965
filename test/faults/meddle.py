"""Disturbs the ROS graph of a job as its first argument demands, and prints its progress.

deaf: subscribe to all topics; the program that started this one then stops it.
clock SECONDS: pause simulated time for that long.
rest: print the node that first moves a robot and, at the end of the input, the last commands.
"""

import json
import sys
import threading
import time

import rosgraph
import rospy
from geometry_msgs.msg import Twist
from std_srvs.srv import Empty

POLL_SECONDS = 0.05


def deaf():
    """Subscribe to everything."""
    received = threading.Event()
    while not received.is_set():
        topics, _, _ = rosgraph.Master("/deaf").getSystemState()
        for topic, _ in topics:
            if topic != "/rosout":
                rospy.Subscriber(topic, rospy.AnyMsg, lambda _: received.set())
        received.wait(1.0)
    print("received", flush=True)
    threading.Event().wait()


def clock(seconds):
    """Pause simulated time."""
    rospy.wait_for_service("/gazebo/pause_physics")
    rospy.ServiceProxy("/gazebo/pause_physics", Empty)()
    print("paused", flush=True)
    time.sleep(float(seconds))
    rospy.ServiceProxy("/gazebo/unpause_physics", Empty)()


def rest():
    """Print the node that drives, and the last command of each topic."""
    last, subscribers = {}, {}

    def receive(message, topic):
        last[topic] = [message.linear.x, message.angular.z]
        if any(last[topic]) and not found.is_set():
            found.set()
            print(message._connection_header["callerid"], flush=True)

    def listen():
        while True:
            for topic, kind in rosgraph.Master("/rest").getPublishedTopics("/"):
                if kind == Twist._type and topic not in subscribers:
                    subscribers[topic] = rospy.Subscriber(topic, Twist, receive, topic)
            time.sleep(POLL_SECONDS)

    found = threading.Event()
    threading.Thread(target=listen, daemon=True).start()
    sys.stdin.read()
    print(json.dumps(last), flush=True)


rospy.init_node("meddler", anonymous=True, disable_signals=True)
{"deaf": deaf, "clock": clock, "rest": rest}[sys.argv[1]](*sys.argv[2:])
