"""Services that put models into the world, take them out and say what they are made of.

/gazebo/spawn_sdf_model, spawn_urdf_model, delete_model, get_world_properties,
get_model_properties.
"""

from __future__ import annotations

from typing import Any, Callable

import rospy

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld, tf_prefixes
from bullet_lab.ros.gazebo.services import Answer, between_steps, changing, offer
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.messages.poses import normalised_pose
from bullet_lab.simulation.models import find_model, frame_state
from bullet_lab.simulation.world.description import Model
from bullet_lab.simulation.world.sdf import read_description


class SpawnError(LabError):
    """A model cannot be put into the world."""


class GazeboModels:
    """Offers the services on models as a whole."""

    def __init__(self, world: RunningWorld):
        self._world = world
        spawned = {
            "done": "SpawnModel: Successfully spawned entity",
            "failed": "SpawnModel: Failure - ",
        }
        self.services = [
            # As in Gazebo, the text and not the service decides what is read.
            offer("spawn_sdf_model", srv.SpawnModel, self._spawn, **spawned),
            offer("spawn_urdf_model", srv.SpawnModel, self._spawn, **spawned),
            offer(
                "delete_model",
                srv.DeleteModel,
                changing(world, self._delete),
                "DeleteModel: successfully deleted model",
            ),
            offer(
                "get_world_properties",
                srv.GetWorldProperties,
                between_steps(world, self._world_properties),
                "GetWorldProperties: got properties",
            ),
            offer(
                "get_model_properties",
                srv.GetModelProperties,
                between_steps(world, self._model_properties),
                "GetModelProperties: got properties",
            ),
        ]

    def _spawn(self, request: Any) -> Answer:
        name = request.model_name
        pose = normalised_pose(request.initial_pose)
        # Read in this thread, so that the simulation does not wait for it.
        model = read_description(request.model_xml, f"model_xml of '{name}'")
        prefixes = tf_prefixes(model, request.robot_namespace)
        self._world.change(lambda: self._add(model, pose, request, prefixes))
        return {}

    def _add(self, model: Model, pose: Pose, request: Any, prefixes: Callable[[str], str]) -> str:
        name = request.model_name or model.name
        if name in self._world.models:
            raise SpawnError("entity already exists.")
        frame = frame_state(self._world.models, request.reference_frame).pose
        instance = self._world.simulation.add(
            model, name, frame * pose * model.pose, request.robot_namespace, prefixes
        )
        try:
            self._world.topics.connect(instance)
        except (LabError, ValueError, rospy.ROSException) as error:
            self._take_out(name)
            raise SpawnError(f"cannot connect its topics: {error}") from error
        return name

    def _delete(self, request: Any) -> str:
        find_model(self._world.models, request.model_name)
        self._take_out(request.model_name)
        return request.model_name

    def _take_out(self, name: str) -> None:
        self._world.topics.disconnect(name)
        self._world.simulation.remove(name)

    def _world_properties(self, _request: Any) -> Answer:
        simulation = self._world.simulation
        names = list(simulation.models)
        return {"sim_time": simulation.seconds, "model_names": names, "rendering_enabled": True}

    def _model_properties(self, request: Any) -> Answer:
        model = find_model(self._world.models, request.model_name).model
        return {
            "canonical_body_name": model.root_links()[0].name,
            "body_names": [link.name for link in model.links],
            "geom_names": [shape.name for link in model.links for shape in link.collisions],
            "joint_names": [joint.name for joint in model.joints],
            "is_static": model.static,
        }
