#!/usr/bin/env python3
"""Moves a model about, by service and by topic, and asks where it is."""

import rospy
from gazebo_msgs.msg import LinkState, ModelState, ModelStates
from gazebo_msgs.srv import (
    DeleteModel,
    GetLinkState,
    GetModelState,
    SetLinkState,
    SetModelState,
    SpawnModel,
)
from geometry_msgs.msg import Point, Pose, Quaternion

CRATE = '<sdf version="1.6"><include><uri>model://crate</uri></include></sdf>'

rospy.init_node("states")
rospy.wait_for_service("/gazebo/spawn_sdf_model")
# Beside the rover, which is at the origin.
rospy.ServiceProxy("/gazebo/spawn_sdf_model", SpawnModel)(
    model_name="mover",
    model_xml=CRATE,
    initial_pose=Pose(Point(-3.0, 6.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0)),
)
get_state = rospy.ServiceProxy("/gazebo/get_model_state", GetModelState)
set_state = rospy.ServiceProxy("/gazebo/set_model_state", SetModelState)

state = ModelState()
state.model_name = "mover"
state.reference_frame = "world"
state.pose.position.x = -3.0
state.pose.position.y = 4.0
state.pose.position.z = 0.15
state.pose.orientation.w = 1.0
print("set:", set_state(state).success)
place = get_state("mover", "").pose.position
print("at: %.3f %.3f %.3f" % (place.x, place.y, place.z))
place = get_state("mover", "wall").pose.position
print("from the wall: %.3f %.3f" % (place.x, place.y))
print("unknown:", get_state("nobody", "").success)

publisher = rospy.Publisher("/gazebo/set_model_state", ModelState, queue_size=1)
while publisher.get_num_connections() == 0:
    rospy.sleep(0.01)
state.pose.position.x = -5.0
publisher.publish(state)
while True:
    states = rospy.wait_for_message("/gazebo/model_states", ModelStates)
    x = states.pose[states.name.index("mover")].position.x
    if abs(x + 5.0) < 0.01:
        break
print("by topic: %.3f" % x)

link = LinkState()
link.link_name = "mover::link"
link.pose = state.pose
link.pose.position.y = 6.0
print("link set:", rospy.ServiceProxy("/gazebo/set_link_state", SetLinkState)(link).success)
found = rospy.ServiceProxy("/gazebo/get_link_state", GetLinkState)("mover::link", "world")
print("link at: %.3f" % found.link_state.pose.position.y)
rospy.ServiceProxy("/gazebo/delete_model", DeleteModel)("mover")
