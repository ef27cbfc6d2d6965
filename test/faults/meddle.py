"""Does to a job's ROS graph what its first word says, and says on standard output how far it is.

deaf: subscribe to all topics there are; who started this program then stops it.
clock SECONDS: have simulated time stand so long.
rest: tell which node first moves a robot, and, at the end of the input, what it sent last.
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
    heard = threading.Event()
    while not heard.is_set():
        topics, _, _ = rosgraph.Master("/deaf").getSystemState()
        for topic, _ in topics:
            if topic != "/rosout":
                rospy.Subscriber(topic, rospy.AnyMsg, lambda _: heard.set())
        heard.wait(1.0)
    print("heard", flush=True)
    threading.Event().wait()


def clock(seconds):
    """Have simulated time stand."""
    rospy.wait_for_service("/gazebo/pause_physics")
    rospy.ServiceProxy("/gazebo/pause_physics", Empty)()
    print("paused", flush=True)
    time.sleep(float(seconds))
    rospy.ServiceProxy("/gazebo/unpause_physics", Empty)()


def rest():
    """Tell who drives, and the last command of each topic."""
    last, subscribers = {}, {}

    def hear(message, topic):
        last[topic] = [message.linear.x, message.angular.z]
        if any(last[topic]) and not told.is_set():
            told.set()
            print(message._connection_header["callerid"], flush=True)

    def listen():
        while True:
            for topic, kind in rosgraph.Master("/rest").getPublishedTopics("/"):
                if kind == Twist._type and topic not in subscribers:
                    subscribers[topic] = rospy.Subscriber(topic, Twist, hear, topic)
            time.sleep(POLL_SECONDS)

    told = threading.Event()
    threading.Thread(target=listen, daemon=True).start()
    sys.stdin.read()
    print(json.dumps(last), flush=True)


rospy.init_node("meddler", anonymous=True, disable_signals=True)
{"deaf": deaf, "clock": clock, "rest": rest}[sys.argv[1]](*sys.argv[2:])
