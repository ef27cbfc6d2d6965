"""gazebo_ros's spawn_model: puts a model into the running world, as launch files have it.

Usage: spawn_model -urdf|-sdf -file FILE|-param NAME|-database MODEL|-stdin -model NAME
    [-x -y -z -R -P -Y NUMBER] [-reference_frame NAME] [-robot_namespace NAME]
    [-gazebo_namespace NAME] [-wait MODEL] [-unpause] [-J JOINT POSITION] [-package_to_model] [-b]

There is no database on the network: -database looks in the simulation's GAZEBO_MODEL_PATH.

:ROS Service clients: /gazebo/spawn_urdf_model or spawn_sdf_model (gazebo_msgs/SpawnModel),
    set_model_configuration, unpause_physics, delete_model
:ROS Subscribers: /gazebo/model_states (gazebo_msgs/ModelStates), with -wait
"""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import Any, List

import rospy
from std_srvs.srv import Empty

from bullet_lab.ros.conversions import pose_message
from bullet_lab.ros.gazebo_client import call
from bullet_lab.ros.gazebo_types import msg, srv
from bullet_lab.ros.node import NodeError, run_node, wait_until
from bullet_lab.ros.spawn_arguments import (
    SpawnArguments,
    SpawnArgumentsError,
    database_text,
    packages_to_models,
    parse_spawn_arguments,
)
from bullet_lab.simulation.xml_input import read_text

USAGE_STATUS = 2


def description_of(told: SpawnArguments) -> str:
    """Return the text that describes the model; raises LabError where there is none."""
    if told.source == "file":
        text = read_text(Path(told.source_name))
    elif told.source == "param":
        text = str(rospy.get_param(told.source_name, ""))
    elif told.source == "database":
        text = database_text(told.source_name)
    else:
        text = sys.stdin.read()
    if not text.strip():
        raise NodeError(f"-{told.source} {told.source_name}: there is nothing in it")
    return packages_to_models(text) if told.package_to_model else text


def spawn(told: SpawnArguments) -> str:
    """Put the model into the world and return what was answered; raises LabError."""
    gazebo = told.gazebo_namespace
    if told.wait:
        _wait_for(told.wait, f"{gazebo}/model_states")
    service = f"{gazebo}/spawn_{'urdf' if told.urdf else 'sdf'}_model"
    answer = call(
        service,
        srv.SpawnModel,
        told.model,
        description_of(told),
        told.robot_namespace,
        pose_message(told.pose),
        told.reference_frame,
    )
    if told.joints:
        names, positions = zip(*told.joints.items())
        configure = f"{gazebo}/set_model_configuration"
        call(configure, srv.SetModelConfiguration, told.model, "", names, positions)
    if told.unpause:
        _unpause(f"{gazebo}/unpause_physics")
    return answer.status_message


def _unpause(service: str) -> None:
    rospy.wait_for_service(service)
    try:
        rospy.ServiceProxy(service, Empty)()
    except rospy.ServiceException as error:
        raise NodeError(f"{service}: {error}") from error


def _wait_for(model: str, topic: str) -> None:
    """Wait until a model is in the world; in wall time, since simulated time may stand still."""
    seen: List[Any] = []

    def look(states: Any) -> None:
        if model in states.name:
            seen.append(model)

    subscriber = rospy.Subscriber(topic, msg.ModelStates, look, queue_size=1)
    wait_until(lambda: seen, f"model '{model}'")
    subscriber.unregister()


def _delete_at_the_end(told: SpawnArguments) -> None:
    """Wait until ROS shuts down, then take the model out again."""

    def delete() -> None:
        # The simulation may be gone already.
        with contextlib.suppress(rospy.ServiceException, rospy.ROSException):
            rospy.ServiceProxy(f"{told.gazebo_namespace}/delete_model", srv.DeleteModel)(told.model)

    rospy.on_shutdown(delete)
    rospy.spin()


def main() -> None:
    """Run the node."""
    words = rospy.myargv(sys.argv)[1:]
    if not words or words[0] in ("-h", "-help", "--help"):
        print(__doc__.split("\n\n")[1])
        sys.exit(0 if words else USAGE_STATUS)
    try:
        told = parse_spawn_arguments(words, rospy.get_namespace())
    except SpawnArgumentsError as error:
        print(f"spawn_model: {error}", file=sys.stderr)
        sys.exit(USAGE_STATUS)

    def body() -> None:
        rospy.loginfo("spawn_model: %s", spawn(told))
        if told.bond:
            _delete_at_the_end(told)

    run_node("spawn_model", body)
