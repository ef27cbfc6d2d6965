"""Gazebo's services on models, links, joints and lights, and the topics that set their states."""

from __future__ import annotations

import math
import traceback
from dataclasses import replace
from functools import partial
from typing import Any, Callable, Dict, Optional, Sequence

import rospy
from std_msgs.msg import ColorRGBA

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
    change_joint,
    change_link,
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
from bullet_lab.simulation.world.tree import INERTIA_KEYS, inertia_at

QUEUE_SIZE = 10
# Status message of a getter that succeeded, after the type's name.
GOT = "got properties"
SET = "properties set"
JOINT_TYPES = {
    "revolute": srv.GetJointPropertiesResponse.REVOLUTE,
    "continuous": srv.GetJointPropertiesResponse.CONTINUOUS,
    "prismatic": srv.GetJointPropertiesResponse.PRISMATIC,
}
# Properties of ODE joints that have no effect in PyBullet.
UNUSED = ("erp", "cfm", "stop_erp", "stop_cfm", "fudge_factor")

# Fields of a response besides success and status_message; None for no others.
Answer = Optional[Dict[str, Any]]


def offer(
    name: str, kind: Any, answer: Callable[[Any], Answer], done: str = "", failed: str = ""
) -> rospy.Service:
    """Offer a service whose response to an error has no success and the error as status message.

    `answer` returns fields of the response to a request. `done` is the status message after a
    success, and `failed` the text before an error.
    """
    fields = kind._response_class.__slots__

    def handle(request: Any) -> Any:
        values = {"success": True, "status_message": done}
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


def _spawn(world: RunningWorld, request: Any) -> None:
    name = request.model_name
    pose = normalised_pose(request.initial_pose)
    # Parsed in the service's own thread: the simulation does not wait for it.
    model = read_spawned(request.model_xml, f"model_xml of '{name}'")
    if isinstance(model, Light):
        world.do(lambda: _add_light(world, replace(model, name=name or model.name)))
    else:
        prefixes = tf_prefixes(model, request.robot_namespace, name)
        world.do(lambda: _add(world, model, pose, request, prefixes))


def _add(
    world: RunningWorld, model: Model, pose: Pose, request: Any, prefixes: Callable[[str], str]
) -> None:
    name = request.model_name or model.name
    if name in world.models:
        raise InputError("entity already exists.")
    place = frame_state(world.models, request.reference_frame).pose * pose * model.pose
    world.add(model, name, place, request.robot_namespace, prefixes)
    world.notify(name)


def _add_light(world: RunningWorld, light: Light) -> None:
    simulation = world.simulation
    if light.name in (*simulation.models, *(one.name for one in simulation.world.lights)):
        raise InputError("entity already exists.")
    # As in Gazebo, the pose in the SDF counts and not the one in the request.
    simulation.set_light(light)


def _delete(world: RunningWorld, request: Any) -> None:
    instance = find_model(world.models, request.model_name)
    world.topics.disconnect(instance.plugins)
    world.simulation.remove(request.model_name)
    world.notify(request.model_name)


def _move_model(world: RunningWorld, message: Any) -> None:
    instance = find_model(world.models, message.model_name)
    state = _state_in_world(world, message)
    instance.move(state.pose, state.linear, state.angular)
    world.notify(instance.name)


def _move_link(world: RunningWorld, message: Any) -> None:
    link = find_link(world.models, message.link_name)
    move_link(link, _state_in_world(world, message))
    world.notify(link.instance.name)


def _state_in_world(world: RunningWorld, message: Any) -> FrameState:
    """Return the requested pose and twist in the world frame; raises InputError."""
    state = FrameState(normalised_pose(message.pose), *twist_of(message.twist))
    return in_world(frame_state(world.models, message.reference_frame), state)


def _configure(world: RunningWorld, request: Any) -> None:
    if len(request.joint_names) != len(request.joint_positions):
        raise InputError("joint name and position list have different lengths")
    positions = dict(zip(request.joint_names, request.joint_positions))
    find_model(world.models, request.model_name).configure(positions)
    world.notify(request.model_name)


def _world_properties(world: RunningWorld, _request: Any) -> Answer:
    simulation = world.simulation
    names = list(simulation.models)
    return {"sim_time": simulation.seconds, "model_names": names, "rendering_enabled": True}


def _model_properties(world: RunningWorld, request: Any) -> Answer:
    model = find_model(world.models, request.model_name).model
    return {
        "canonical_body_name": model.canonical_link().name,
        "body_names": [link.name for link in model.own_links()],
        "geom_names": [shape.name for link in model.links for shape in link.collisions],
        "joint_names": [joint.name for joint in model.joints],
        "is_static": model.static,
    }


def _model_state(world: RunningWorld, request: Any) -> Answer:
    entity = model_entity(find_model(world.models, request.model_name))
    header = srv.GetModelStateResponse().header
    set_time(header.stamp, world.simulation.step)
    header.frame_id = request.relative_entity_name or "world"
    frame = frame_state(world.models, request.relative_entity_name)
    state = relative_to(frame, entity.state())
    return {"header": header, "pose": pose_message(state.pose), "twist": twist_message(state)}


def _link_state(world: RunningWorld, request: Any) -> Answer:
    link, name = find_link(world.models, request.link_name), request.reference_frame
    state = relative_to(frame_state(world.models, name), link.state())
    place = (pose_message(state.pose), twist_message(state))
    return {"link_state": msg.LinkState(request.link_name, *place, name or "world")}


def _apply_wrench(world: RunningWorld, request: Any) -> None:
    force = vector_of(request.wrench.force, "the force")
    torque = vector_of(request.wrench.torque, "the torque")
    point = vector_of(request.reference_point, "the reference point")
    link = find_link(world.models, request.body_name)
    name = request.reference_frame
    frame = None if name in WORLD_FRAMES else frame_state(world.models, name)
    wrench = Wrench.at_point(frame, link, force, torque, point, _period(world, request))
    world.simulation.forces.add(wrench)


def _clear_wrenches(world: RunningWorld, request: Any) -> None:
    link = find_link(world.models, request.body_name)
    world.simulation.forces.clear(Wrench, (link.instance, link.frame.link))


def _apply_effort(world: RunningWorld, request: Any) -> None:
    joint = find_joint(world.models, request.joint_name)
    effort = Effort(*joint, request.effort, _period(world, request))
    world.simulation.forces.add(effort)


def _clear_efforts(world: RunningWorld, request: Any) -> None:
    joint = find_joint(world.models, request.joint_name)
    world.simulation.forces.clear(Effort, joint)


def _period(world: RunningWorld, request: Any) -> Period:
    now = world.simulation.step
    return Period.after(now, request.start_time.to_sec(), request.duration.to_sec())


def _joint_properties(world: RunningWorld, request: Any) -> Answer:
    instance, name = find_joint(world.models, request.joint_name)
    state = instance.body_of_joint(name).joint_state(name)
    joint = next(j for j in instance.model.joints if j.name == name)
    return {
        "type": JOINT_TYPES[joint.kind],
        "damping": [joint.damping],
        "position": [state.position],
        "rate": [state.velocity],
    }


def _set_joint_properties(world: RunningWorld, request: Any) -> Answer:
    instance, name = find_joint(world.models, request.joint_name)
    config, keys = request.ode_joint_config, ("damping", "loStop", "hiStop", "vel", "fmax")
    damping, lower, upper, speed, effort = (_first(getattr(config, key), key) for key in keys)
    if damping is not None and damping < 0.0:
        raise InputError(f"a damping of {damping:g} is negative")
    change_joint(instance, name, damping, lower, upper)
    if speed is not None or effort is not None:
        # ODE's motor: it aims at the speed `vel` with an effort of `fmax` at most.
        instance.body_of_joint(name).drive_joint(name, speed or 0.0, abs(effort or 0.0))
    done = f"SetJointProperties: {SET}"
    unused = [key for key in UNUSED if len(getattr(config, key))]
    if unused:
        done += f"; {', '.join(unused)} do nothing here"
    return {"status_message": done}


def _link_properties(world: RunningWorld, request: Any) -> Answer:
    link = find_link(world.models, request.link_name)
    model = link.instance.model
    description = model.links_by_name()[link.frame.link]
    inertia = description.inertia
    if inertia is None:
        return {"com": pose_message(Pose())}
    gravity = description.gravity and not model.static
    values = {"gravity_mode": gravity, "mass": inertia.mass, **inertia.elements(inertia.axes)}
    # As in Gazebo, the moments are in the axes of the <inertial>, which the answer does not tell.
    return {"com": pose_message(Pose(inertia.centre)), **values}


def _set_link_properties(world: RunningWorld, request: Any) -> None:
    link = find_link(world.models, request.link_name)
    elements = {key: getattr(request, key) for key in INERTIA_KEYS}
    if not all(map(math.isfinite, (request.mass, *elements.values()))):
        raise InputError("mass or inertia is not finite")
    centre = vector_of(request.com.position, "the centre of mass")
    before = link.instance.model.links_by_name()[link.frame.link].inertia
    pose = Pose(centre, Pose.quaternion if before is None else before.axes)
    inertia = inertia_at(pose, request.mass, elements)
    change_link(link, inertia, request.gravity_mode)


def _light_properties(world: RunningWorld, request: Any) -> Answer:
    light = world.simulation.light(request.light_name)
    fade = light.attenuation
    return {
        "diffuse": ColorRGBA(*light.diffuse),
        "attenuation_constant": fade.constant,
        "attenuation_linear": fade.linear,
        "attenuation_quadratic": fade.quadratic,
    }


def _set_light_properties(world: RunningWorld, request: Any) -> None:
    light = world.simulation.light(request.light_name)
    keys = ("constant", "linear", "quadratic")
    fading = {key: getattr(request, f"attenuation_{key}") for key in keys}
    colour = tuple(getattr(request.diffuse, part) for part in "rgba")
    if not all(0.0 <= value < math.inf for value in (*fading.values(), *colour)):
        raise InputError("a colour or an attenuation is negative or not finite")
    direction = vector_of(request.direction, "the direction")
    changed = replace(
        light,
        pose=normalised_pose(request.pose),
        diffuse=colour,
        # (0, 0, 0) keeps the direction.
        direction=direction if any(direction) else light.direction,
        casts_shadows=request.cast_shadows,
        attenuation=replace(light.attenuation, **fading),
    )
    world.simulation.set_light(changed)


def _delete_light(world: RunningWorld, request: Any) -> Answer:
    world.simulation.remove_light(request.light_name)
    return {"status_message": f"DeleteLight: {request.light_name} successfully deleted"}


def _first(values: Sequence[float], name: str) -> float | None:
    """Return the value for a joint's first axis, None if there is none; raises InputError."""
    if not values:
        return None
    if math.isnan(values[0]):
        raise InputError(f"{name} is not a number")
    return values[0]


# Name, type, function and status message of the services that are answered between two steps.
SERVICES = (
    ("delete_model", srv.DeleteModel, _delete, "successfully deleted model"),
    (
        "set_model_state",
        srv.SetModelState,
        lambda world, request: _move_model(world, request.model_state),
        "set model state done",
    ),
    (
        "set_link_state",
        srv.SetLinkState,
        lambda world, request: _move_link(world, request.link_state),
        "success",
    ),
    ("set_model_configuration", srv.SetModelConfiguration, _configure, "success"),
    ("get_world_properties", srv.GetWorldProperties, _world_properties, GOT),
    ("get_model_properties", srv.GetModelProperties, _model_properties, GOT),
    ("get_model_state", srv.GetModelState, _model_state, GOT),
    ("get_link_state", srv.GetLinkState, _link_state, "got state"),
    ("apply_body_wrench", srv.ApplyBodyWrench, _apply_wrench, ""),
    ("clear_body_wrenches", srv.BodyRequest, _clear_wrenches, ""),
    ("apply_joint_effort", srv.ApplyJointEffort, _apply_effort, "effort set"),
    ("clear_joint_forces", srv.JointRequest, _clear_efforts, ""),
    ("get_joint_properties", srv.GetJointProperties, _joint_properties, GOT),
    ("set_joint_properties", srv.SetJointProperties, _set_joint_properties, SET),
    ("get_link_properties", srv.GetLinkProperties, _link_properties, GOT),
    ("set_link_properties", srv.SetLinkProperties, _set_link_properties, SET),
    # As in Gazebo, the next two have no status message after a success.
    ("get_light_properties", srv.GetLightProperties, _light_properties, ""),
    ("set_light_properties", srv.SetLightProperties, _set_light_properties, ""),
    ("delete_light", srv.DeleteLight, _delete_light, ""),
)


def offer_services(world: RunningWorld) -> None:
    """Offer the services on models, links, joints and lights."""
    spawn = partial(_spawn, world)
    messages = ("SpawnModel: Successfully spawned entity", "SpawnModel: Failure - ")
    # As in Gazebo, both services accept SDF and URDF.
    for name in ("spawn_sdf_model", "spawn_urdf_model"):
        offer(f"/gazebo/{name}", srv.SpawnModel, spawn, *messages)

    def between_steps(answer: Callable[[RunningWorld, Any], Answer]) -> Callable[[Any], Answer]:
        return lambda request: world.do(partial(answer, world, request))

    for name, kind, answer, done in SERVICES:
        offer_gazebo(name, kind, between_steps(answer), done)


def offer_gazebo(name: str, kind: Any, answer: Callable[[Any], Answer], done: str = "") -> None:
    """Offer a service of /gazebo whose status messages begin with the name of its type."""
    prefix = f"{kind.__name__}: "
    offer(f"/gazebo/{name}", kind, answer, done and prefix + done, prefix)


def subscribe_to_states(world: RunningWorld) -> None:
    """Subscribe to /gazebo/set_model_state and set_link_state."""
    refusals = Refusals()

    def subscribe(topic: str, kind: type, move: Callable[[RunningWorld, Any], None]) -> None:
        def receive(message: Any) -> None:
            try:
                world.do(partial(move, world, message))
            except StepperError:
                raise
            except LabError as error:
                refusals.refuse(topic, str(error))

        world.topics.subscribe(topic, kind, receive, QUEUE_SIZE)

    subscribe("/gazebo/set_model_state", msg.ModelState, _move_model)
    subscribe("/gazebo/set_link_state", msg.LinkState, _move_link)
