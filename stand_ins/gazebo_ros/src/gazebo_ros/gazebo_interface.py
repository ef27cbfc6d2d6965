"""The functions that scripts call to spawn models and to set joints; each returns success."""

from __future__ import annotations

from typing import Any, Sequence

import rospy
from gazebo_msgs.srv import SetModelConfiguration, SpawnModel
from geometry_msgs.msg import Pose


def spawn_urdf_model_client(
    model_name: str,
    model_xml: str,
    robot_namespace: str,
    initial_pose: Pose,
    reference_frame: str,
    gazebo_namespace: str,
) -> bool:
    """Put a model, given as URDF, into the world."""
    wanted = (model_name, model_xml, robot_namespace, initial_pose, reference_frame)
    return _call(f"{gazebo_namespace}/spawn_urdf_model", SpawnModel, *wanted)


def spawn_sdf_model_client(
    model_name: str,
    model_xml: str,
    robot_namespace: str,
    initial_pose: Pose,
    reference_frame: str,
    gazebo_namespace: str,
) -> bool:
    """Put a model, given as SDF, into the world."""
    wanted = (model_name, model_xml, robot_namespace, initial_pose, reference_frame)
    return _call(f"{gazebo_namespace}/spawn_sdf_model", SpawnModel, *wanted)


def set_model_configuration_client(
    model_name: str,
    model_param_name: str,
    joint_names: Sequence[str],
    joint_positions: Sequence[float],
    gazebo_namespace: str,
) -> bool:
    """Put joints (rad or m) of a model somewhere; the parameter's name is of no consequence."""
    wanted = (model_name, model_param_name, joint_names, joint_positions)
    return _call(f"{gazebo_namespace}/set_model_configuration", SetModelConfiguration, *wanted)


def _call(service: str, kind: Any, *wanted: Any) -> bool:
    try:
        rospy.wait_for_service(service)
        answer = rospy.ServiceProxy(service, kind)(*wanted)
    except (rospy.ServiceException, rospy.ROSException) as error:
        # A node that is told to end while it waits ends without a traceback.
        if not rospy.is_shutdown():
            rospy.logerr("%s: %s", service, error)
        return False
    if not answer.success:
        rospy.logerr("%s: %s", service, answer.status_message)
    return answer.success
