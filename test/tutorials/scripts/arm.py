#!/usr/bin/env python3
"""Moves the arm along trajectories, by its action and by its topic, and closes its gripper."""

import subprocess

import actionlib
import rospy
from actionlib_msgs.msg import GoalStatus
from control_msgs.msg import (
    FollowJointTrajectoryAction,
    FollowJointTrajectoryGoal,
    GripperCommandAction,
    GripperCommandGoal,
    JointTrajectoryControllerState,
)
from control_msgs.srv import QueryTrajectoryState
from gazebo_msgs.srv import GetJointProperties
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectoryPoint

rospy.init_node("arm")
controller = "/arm/arm_controller"
arm = actionlib.SimpleActionClient(
    controller + "/follow_joint_trajectory", FollowJointTrajectoryAction
)
gripper = actionlib.SimpleActionClient("/arm/gripper_controller/gripper_cmd", GripperCommandAction)
state = rospy.wait_for_message(controller + "/state", JointTrajectoryControllerState, timeout=30)
print("servers:", arm.wait_for_server(rospy.Duration(30)), gripper.wait_for_server())
names = state.joint_names


def goal_of(*points):
    """Return a goal of points: seconds and the position of all joints."""
    goal = FollowJointTrajectoryGoal()
    # MoveIt's order of joints need not be the controller's.
    goal.trajectory.joint_names = names[::-1]
    for seconds, position in points:
        point = JointTrajectoryPoint(time_from_start=rospy.Duration(seconds))
        point.positions, point.velocities = 6 * [position], 6 * [0.0]
        goal.trajectory.points.append(point)
    return goal


feedback = []
arm.send_goal(goal_of((0.0, 0.0), (1.0, 0.3), (2.0, 0.5)), feedback_cb=feedback.append)
print("followed:", arm.wait_for_result(rospy.Duration(20)), arm.get_result().error_code)
joints = rospy.wait_for_message("/arm/joint_states", JointState, timeout=10)
print("at: %.3f %.3f" % (joints.position[0], joints.position[5]))
print("feedback:", len(feedback) > 20, *feedback[-1].joint_names[:1])
print("moved by then: %.1f" % max(feedback[-1].actual.positions))

print("too fast:", arm.send_goal_and_wait(goal_of((0.1, 3.0)), rospy.Duration(20)))
print("because:", arm.get_result().error_code, *arm.get_result().error_string.split(" is ")[:1])
wrong = goal_of((1.0, 0.0))
wrong.trajectory.joint_names[0] = "tail"
print("unknown joint:", arm.send_goal_and_wait(wrong), arm.get_result().error_code)
# The arm is still on its way there.
rospy.sleep(2.0)
arm.send_goal(goal_of((9.0, -1.0)))
while arm.get_state() == GoalStatus.PENDING:
    rospy.sleep(0.05)
arm.cancel_goal()
print("cancelled:", arm.wait_for_result(rospy.Duration(20)), arm.get_state())

text = "{joint_names: %s, points: [{positions: %s, time_from_start: {secs: 1}}]}"
subprocess.run(
    ("rostopic", "pub", "-1", controller + "/command", "trajectory_msgs/JointTrajectory")
    + (text % (names, 6 * [0.1]),),
    stdout=subprocess.DEVNULL,
    check=True,
)
deadline = rospy.get_time() + 20
while abs(joints.position[0] - 0.1) > 1e-3 and rospy.get_time() < deadline:
    joints = rospy.wait_for_message("/arm/joint_states", JointState, timeout=10)
print("by topic: %.3f" % joints.position[0])
query = rospy.ServiceProxy(controller + "/query_state", QueryTrajectoryState)
print("query: %s %.3f" % (query(rospy.Time.now()).name[0], query(rospy.Time.now()).position[0]))

close = GripperCommandGoal()
close.command.position, close.command.max_effort = 0.03, 10.0
print("gripper:", gripper.send_goal_and_wait(close, rospy.Duration(20)))
result = gripper.get_result()
print("closed: %.2f %s %s" % (result.position, result.reached_goal, result.stalled))
finger = rospy.ServiceProxy("/gazebo/get_joint_properties", GetJointProperties)
rospy.sleep(0.5)
print("other finger: %.3f" % finger("right_finger_joint").position[0])
