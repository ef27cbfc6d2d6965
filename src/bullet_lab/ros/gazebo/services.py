"""Gazebo's services on models, links and joints, and its topics that put them elsewhere."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, Callable

import rospy

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld, tf_prefixes
from bullet_lab.ros.bridge.stepper import StepperError
from bullet_lab.ros.gazebo.offers import Answer, offer, offer_between_steps
from bullet_lab.ros.messages.gazebo_types import msg, srv
from bullet_lab.ros.messages.poses import (
    InputError,
    normalised_pose,
    pose_message,
    set_time,
    twist_message,
    twist_of,
    vector_of,
)
from bullet_lab.ros.node.node import Refusals
from bullet_lab.simulation.forces import Effort, Period, Wrench
from bullet_lab.simulation.models import (
    WORLD_FRAMES,
    find_joint,
    find_link,
    find_model,
    frame_state,
    in_world,
    model_entity,
    move_link,
    relative_to,
)
from bullet_lab.simulation.world.description import FrameState, Light, Model
from bullet_lab.simulation.world.sdf import read_spawned

QUEUE_SIZE = 10


class SpawnError(LabError):
    """A model cannot be put into the world."""


class GazeboServices:
    """Offers the services and listens to the topics /gazebo/set_model_state and set_link_state."""

    def __init__(self, world: RunningWorld):
        self._world = world
        self._refusals = Refusals()
        offered = partial(offer_between_steps, world)
        spawn = (srv.SpawnModel, self._spawn, "SpawnModel: Successfully spawned entity")
        set_model, set_link = self._change(self._set_model), self._change(self._set_link)
        self._services = [
            # As in Gazebo, the text and not the service decides what is read.
            offer("spawn_sdf_model", *spawn, "SpawnModel: Failure - "),
            offer("spawn_urdf_model", *spawn, "SpawnModel: Failure - "),
            offer(
                "delete_model",
                srv.DeleteModel,
                self._change(self._delete),
                "DeleteModel: successfully deleted model",
            ),
            offer(
                "set_model_state",
                srv.SetModelState,
                lambda request: set_model(request.model_state),
                "SetModelState: set model state done",
            ),
            offer(
                "set_link_state",
                srv.SetLinkState,
                lambda request: set_link(request.link_state),
                "SetLinkState: success",
            ),
            offer(
                "set_model_configuration",
                srv.SetModelConfiguration,
                self._change(self._configure),
                "SetModelConfiguration: success",
            ),
            offered("get_world_properties", srv.GetWorldProperties, self._world_properties),
            offered("get_model_properties", srv.GetModelProperties, self._model_properties),
            offered("get_model_state", srv.GetModelState, self._model_state),
            offered("get_link_state", srv.GetLinkState, self._link_state, "got state"),
            offered("apply_body_wrench", srv.ApplyBodyWrench, self._apply_wrench, ""),
            offered("clear_body_wrenches", srv.BodyRequest, self._clear_wrenches, ""),
            offered("apply_joint_effort", srv.ApplyJointEffort, self._apply_effort, "effort set"),
            offered("clear_joint_forces", srv.JointRequest, self._clear_efforts, ""),
            # Gazebo knows it by this name, too.
            offered("clear_joint_efforts", srv.JointRequest, self._clear_efforts, ""),
        ]
        self._listen("set_model_state", msg.ModelState, set_model)
        self._listen("set_link_state", msg.LinkState, set_link)

    def _change(self, change: Callable[[Any], str]) -> Callable[[Any], Answer]:
        """Return what answers by a change between two steps, which names the changed model."""

        def answer(request: Any) -> Answer:
            self._world.change(partial(change, request))
            return {}

        return answer

    def _listen(self, name: str, kind: type, take: Callable[[Any], Answer]) -> None:
        topic = f"/gazebo/{name}"

        def receive(message: Any) -> None:
            try:
                take(message)
            except StepperError:
                raise
            except LabError as error:
                self._refusals.refuse(topic, str(error))

        self._world.topics.subscribe(topic, kind, receive, QUEUE_SIZE)

    def _spawn(self, request: Any) -> Answer:
        name = request.model_name
        pose = normalised_pose(request.initial_pose)
        # Read in this thread, so that the simulation does not wait for it.
        model = read_spawned(request.model_xml, f"model_xml of '{name}'")
        if isinstance(model, Light):
            self._world.do(lambda: self._add_light(replace(model, name=name or model.name)))
            return {}
        prefixes = tf_prefixes(model, request.robot_namespace, name)
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

    def _add_light(self, light: Light) -> None:
        simulation = self._world.simulation
        if light.name in (*simulation.models, *(one.name for one in simulation.world.lights)):
            raise SpawnError("entity already exists.")
        # It stays where its text has it, as in Gazebo.
        simulation.set_light(light)

    def _delete(self, request: Any) -> str:
        find_model(self._world.models, request.model_name)
        self._take_out(request.model_name)
        return request.model_name

    def _take_out(self, name: str) -> None:
        self._world.topics.disconnect(name)
        self._world.simulation.remove(name)

    def _set_model(self, message: Any) -> str:
        instance, state = find_model(self._world.models, message.model_name), self._asked(message)
        instance.move(state.pose, state.linear, state.angular)
        return instance.name

    def _set_link(self, message: Any) -> str:
        link, state = find_link(self._world.models, message.link_name), self._asked(message)
        move_link(link, state)
        return link.instance.name

    def _asked(self, message: Any) -> FrameState:
        """Return the state in the world that a message asks for; raises InputError."""
        state = FrameState(normalised_pose(message.pose), *twist_of(message.twist))
        return in_world(frame_state(self._world.models, message.reference_frame), state)

    def _configure(self, request: Any) -> str:
        if len(request.joint_names) != len(request.joint_positions):
            raise InputError("joint name and position list have different lengths")
        positions = dict(zip(request.joint_names, request.joint_positions))
        find_model(self._world.models, request.model_name).configure(positions)
        return request.model_name

    def _world_properties(self, _request: Any) -> Answer:
        simulation = self._world.simulation
        names = list(simulation.models)
        return {"sim_time": simulation.seconds, "model_names": names, "rendering_enabled": True}

    def _model_properties(self, request: Any) -> Answer:
        model = find_model(self._world.models, request.model_name).model
        return {
            "canonical_body_name": model.canonical_link().name,
            "body_names": [link.name for link in model.own_links()],
            "geom_names": [shape.name for link in model.links for shape in link.collisions],
            "joint_names": [joint.name for joint in model.joints],
            "is_static": model.static,
        }

    def _model_state(self, request: Any) -> Answer:
        entity = model_entity(find_model(self._world.models, request.model_name))
        header = srv.GetModelStateResponse().header
        set_time(header.stamp, self._world.simulation.step)
        header.frame_id = request.relative_entity_name or "world"
        frame = frame_state(self._world.models, request.relative_entity_name)
        state = relative_to(frame, entity.state())
        return {"header": header, "pose": pose_message(state.pose), "twist": twist_message(state)}

    def _link_state(self, request: Any) -> Answer:
        link, name = find_link(self._world.models, request.link_name), request.reference_frame
        state = relative_to(frame_state(self._world.models, name), link.state())
        place = (pose_message(state.pose), twist_message(state))
        return {"link_state": msg.LinkState(request.link_name, *place, name or "world")}

    def _apply_wrench(self, request: Any) -> Answer:
        force = vector_of(request.wrench.force, "the force")
        torque = vector_of(request.wrench.torque, "the torque")
        point = vector_of(request.reference_point, "the reference point")
        link = find_link(self._world.models, request.body_name)
        frame = frame_state(self._world.models, request.reference_frame)
        if request.reference_frame in WORLD_FRAMES:
            # As in Gazebo: the axes are the world's, the point is seen from the body.
            frame = FrameState(Pose(link.frame.pose().position))
        wrench = Wrench.at_point(frame, link, force, torque, point, self._period(request))
        self._world.simulation.forces.add(wrench)
        return {}

    def _clear_wrenches(self, request: Any) -> Answer:
        link = find_link(self._world.models, request.body_name)
        self._world.simulation.forces.clear(Wrench, (link.instance, link.link))
        return {}

    def _apply_effort(self, request: Any) -> Answer:
        joint = find_joint(self._world.models, request.joint_name)
        effort = Effort(*joint, request.effort, self._period(request))
        self._world.simulation.forces.add(effort)
        return {}

    def _clear_efforts(self, request: Any) -> Answer:
        joint = find_joint(self._world.models, request.joint_name)
        self._world.simulation.forces.clear(Effort, joint)
        return {}

    def _period(self, request: Any) -> Period:
        now = self._world.simulation.step
        return Period.after(now, request.start_time.to_sec(), request.duration.to_sec())
