#!/usr/bin/env python3
"""Drives the cart through its controllers, and looks at what they say."""

import rospy
from control_msgs.msg import JointControllerState
from controller_manager_msgs.srv import ListControllers, LoadController, SwitchController
from gazebo_msgs.srv import GetModelState
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

rospy.init_node("ros_control")
manager = "/cart/controller_manager/"
rospy.wait_for_service(manager + "list_controllers", timeout=30)
listing = rospy.ServiceProxy(manager + "list_controllers", ListControllers)
deadline = rospy.get_time() + 30
while [one.state for one in listing().controller].count("running") < 3:
    if rospy.get_time() > deadline:
        break
    rospy.sleep(0.1)
for one in listing().controller:
    claimed = one.claimed_resources[0]
    print("controller:", one.name, one.state, claimed.hardware_interface, *claimed.resources)
load = rospy.ServiceProxy(manager + "load_controller", LoadController)
print("loaded:", load("arm").ok, load("nothing").ok)
switch = rospy.ServiceProxy(manager + "switch_controller", SwitchController)
print("switched:", switch(start_controllers=["nothing"], strictness=2).ok)

drive = rospy.Publisher("/cart/drive/cmd_vel", Twist, queue_size=10)
mast = rospy.Publisher("/cart/mast/command", Float64, queue_size=10)
while not (drive.get_num_connections() and mast.get_num_connections()):
    rospy.sleep(0.05)
start = rospy.wait_for_message("/cart/drive/odom", Odometry, timeout=10).pose.pose.position.x
command = Twist()
command.linear.x = 2.0
mast.publish(1.0)
rate = rospy.Rate(20)
for _ in range(30):
    drive.publish(command)
    rate.sleep()
joints = rospy.wait_for_message("/cart/joint_states", JointState, timeout=10)
# No more commands: the controller stops by itself.
rospy.sleep(1.0)
odom = rospy.wait_for_message("/cart/drive/odom", Odometry, timeout=10)
state = rospy.ServiceProxy("/gazebo/get_model_state", GetModelState)
print("frames:", odom.header.frame_id, odom.child_frame_id)
print("driven: %.3f" % (odom.pose.pose.position.x - start))
print("off: %.3f" % (odom.pose.pose.position.x - state("cart", "").pose.position.x - 20.0))
print("speed: %.3f" % odom.twist.twist.linear.x)
print("joints:", *joints.name)
print("wheels: %.2f %.2f" % tuple(joints.velocity[:2]))
turned = rospy.wait_for_message("/cart/mast/state", JointControllerState, timeout=10)
print("mast: %.3f %.3f %.1f" % (turned.set_point, turned.process_value, turned.p))
