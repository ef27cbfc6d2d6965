"""Gazebo's services on models, links and joints, and the topics that set their states."""

from __future__ import annotations

import traceback
from dataclasses import replace
from functools import partial
from typing import Any, Callable, Dict, Optional

import rospy

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld, tf_prefixes
from bullet_lab.ros.bridge.stepper import StepperError
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
# Status message of a getter that succeeded, after the type's name.
GOT = "got properties"

# Fields of a response besides success and status_message; None for no others.
Answer = Optional[Dict[str, Any]]


class SpawnError(LabError):
    """A model cannot be added to the world."""


def offer(
    name: str, kind: Any, answer: Callable[[Any], Answer], done: str = "", failed: str = ""
) -> rospy.Service:
    """Offer a service whose response to an error has no success and the error as status message.

    Args:
        name: of the service.
        kind: its type.
        answer: returns fields of the response to a request.
        done: status message after a success.
        failed: text before an error in the status message.
    """
    fields = kind._response_class.__slots__

    def handle(request: Any) -> Any:
        values: Dict[str, Any] = {"success": True, "status_message": done}
        try:
            values.update(answer(request) or {})
        except LabError as error:
            values = {"success": False, "status_message": f"{failed}{error}"}
        except rospy.ROSInterruptException:
            raise
        except Exception as error:
            # The client gets an answer whatever it sends, and the simulation continues.
            rospy.logerr("%s: %s", name, traceback.format_exc())
            values = {"success": False, "status_message": f"{failed}{error!r}"}
        if not values["success"] and "success" not in fields:
            rospy.logwarn("%s", values["status_message"])
        known = {key: value for key, value in values.items() if key in fields}
        return kind._response_class(**known)

    return rospy.Service(name, kind, handle)


def offer_between_steps(
    world: RunningWorld, name: str, kind: Any, answer: Callable[[Any], Answer], done: str
) -> rospy.Service:
    """Offer a service of /gazebo that the thread of the simulation answers between two steps.

    Its status messages begin with the name of its type, as Gazebo's do.
    """
    prefix = f"{kind.__name__}: "

    def between_steps(request: Any) -> Answer:
        return world.do(partial(answer, request))

    return offer(f"/gazebo/{name}", kind, between_steps, done and prefix + done, prefix)


class GazeboServices:
    """Offers the services and subscribes to /gazebo/set_model_state and set_link_state."""

    def __init__(self, world: RunningWorld):
        self._world = world
        self._refusals = Refusals()
        messages = ("SpawnModel: Successfully spawned entity", "SpawnModel: Failure - ")
        self._services = [
            # As in Gazebo, both services accept SDF and URDF.
            offer("/gazebo/spawn_sdf_model", srv.SpawnModel, self._spawn, *messages),
            offer("/gazebo/spawn_urdf_model", srv.SpawnModel, self._spawn, *messages),
        ]
        for name, kind, answer, done in (
            ("delete_model", srv.DeleteModel, self._delete, "successfully deleted model"),
            ("set_model_state", srv.SetModelState, self._set_model, "set model state done"),
            ("set_link_state", srv.SetLinkState, self._set_link, "success"),
            ("set_model_configuration", srv.SetModelConfiguration, self._configure, "success"),
            ("get_world_properties", srv.GetWorldProperties, self._world_properties, GOT),
            ("get_model_properties", srv.GetModelProperties, self._model_properties, GOT),
            ("get_model_state", srv.GetModelState, self._model_state, GOT),
            ("get_link_state", srv.GetLinkState, self._link_state, "got state"),
            ("apply_body_wrench", srv.ApplyBodyWrench, self._apply_wrench, ""),
            ("clear_body_wrenches", srv.BodyRequest, self._clear_wrenches, ""),
            ("apply_joint_effort", srv.ApplyJointEffort, self._apply_effort, "effort set"),
            ("clear_joint_forces", srv.JointRequest, self._clear_efforts, ""),
            # Gazebo has both names for it.
            ("clear_joint_efforts", srv.JointRequest, self._clear_efforts, ""),
        ):
            self._services.append(offer_between_steps(world, name, kind, answer, done))
        self._subscribe("/gazebo/set_model_state", msg.ModelState, self._move_model)
        self._subscribe("/gazebo/set_link_state", msg.LinkState, self._move_link)

    def _subscribe(self, topic: str, kind: type, move: Callable[[Any], None]) -> None:
        def receive(message: Any) -> None:
            try:
                self._world.do(partial(move, message))
            except StepperError:
                raise
            except LabError as error:
                self._refusals.refuse(topic, str(error))

        self._world.topics.subscribe(topic, kind, receive, QUEUE_SIZE)

    def _spawn(self, request: Any) -> None:
        name = request.model_name
        pose = normalised_pose(request.initial_pose)
        # Parsed in the service's own thread: the simulation does not wait for it.
        model = read_spawned(request.model_xml, f"model_xml of '{name}'")
        if isinstance(model, Light):
            self._world.do(lambda: self._add_light(replace(model, name=name or model.name)))
        else:
            prefixes = tf_prefixes(model, request.robot_namespace, name)
            self._world.do(lambda: self._add(model, pose, request, prefixes))

    def _add(self, model: Model, pose: Pose, request: Any, prefixes: Callable[[str], str]) -> None:
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
            self._world.simulation.remove(name)
            raise SpawnError(f"cannot connect its topics: {error}") from error
        self._world.notify(name)

    def _add_light(self, light: Light) -> None:
        simulation = self._world.simulation
        if light.name in (*simulation.models, *(one.name for one in simulation.world.lights)):
            raise SpawnError("entity already exists.")
        # As in Gazebo, the pose in the SDF counts and not the one in the request.
        simulation.set_light(light)

    def _delete(self, request: Any) -> None:
        instance = find_model(self._world.models, request.model_name)
        self._world.topics.disconnect_devices(instance.plugins)
        self._world.simulation.remove(request.model_name)
        self._world.notify(request.model_name)

    def _set_model(self, request: Any) -> None:
        self._move_model(request.model_state)

    def _move_model(self, message: Any) -> None:
        instance = find_model(self._world.models, message.model_name)
        state = self._state_in_world(message)
        instance.move(state.pose, state.linear, state.angular)
        self._world.notify(instance.name)

    def _set_link(self, request: Any) -> None:
        self._move_link(request.link_state)

    def _move_link(self, message: Any) -> None:
        link = find_link(self._world.models, message.link_name)
        move_link(link, self._state_in_world(message))
        self._world.notify(link.instance.name)

    def _state_in_world(self, message: Any) -> FrameState:
        """Return the requested pose and twist in the world frame; raises InputError."""
        state = FrameState(normalised_pose(message.pose), *twist_of(message.twist))
        return in_world(frame_state(self._world.models, message.reference_frame), state)

    def _configure(self, request: Any) -> None:
        if len(request.joint_names) != len(request.joint_positions):
            raise InputError("joint name and position list have different lengths")
        positions = dict(zip(request.joint_names, request.joint_positions))
        find_model(self._world.models, request.model_name).configure(positions)
        self._world.notify(request.model_name)

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

    def _apply_wrench(self, request: Any) -> None:
        force = vector_of(request.wrench.force, "the force")
        torque = vector_of(request.wrench.torque, "the torque")
        point = vector_of(request.reference_point, "the reference point")
        link = find_link(self._world.models, request.body_name)
        frame = frame_state(self._world.models, request.reference_frame)
        if request.reference_frame in WORLD_FRAMES:
            # As in Gazebo: force and torque in the world frame, the point relative to the body.
            frame = FrameState(Pose(link.frame.pose().position))
        wrench = Wrench.at_point(frame, link, force, torque, point, self._period(request))
        self._world.simulation.forces.add(wrench)

    def _clear_wrenches(self, request: Any) -> None:
        link = find_link(self._world.models, request.body_name)
        self._world.simulation.forces.clear(Wrench, (link.instance, link.link))

    def _apply_effort(self, request: Any) -> None:
        joint = find_joint(self._world.models, request.joint_name)
        effort = Effort(*joint, request.effort, self._period(request))
        self._world.simulation.forces.add(effort)

    def _clear_efforts(self, request: Any) -> None:
        joint = find_joint(self._world.models, request.joint_name)
        self._world.simulation.forces.clear(Effort, joint)

    def _period(self, request: Any) -> Period:
        now = self._world.simulation.step
        return Period.after(now, request.start_time.to_sec(), request.duration.to_sec())
