"""Gazebo's services on the properties of joints, links, lights and the physics engine."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Dict, List, Optional, Sequence

import rospy
from geometry_msgs.msg import Vector3
from std_msgs.msg import ColorRGBA

from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.gazebo.reconfigure import Reconfigurable, Setting, Values
from bullet_lab.ros.gazebo.services import GOT, Answer, offer, offer_between_steps
from bullet_lab.ros.messages.gazebo_types import msg, srv
from bullet_lab.ros.messages.poses import InputError, normalised_pose, pose_message, vector_of
from bullet_lab.simulation.models import change_joint, change_link, find_joint, find_link
from bullet_lab.simulation.physics.physics import STEP_SECONDS
from bullet_lab.simulation.world.description import Inertia, Light
from bullet_lab.simulation.world.tree import INERTIA_KEYS, matrix_from_elements
from bullet_lab.srv import SetRtf

JOINT_TYPES = {
    "revolute": srv.GetJointPropertiesResponse.REVOLUTE,
    "continuous": srv.GetJointPropertiesResponse.CONTINUOUS,
    "prismatic": srv.GetJointPropertiesResponse.PRISMATIC,
}
# Properties of ODE joints that have no effect in PyBullet.
UNUSED = ("erp", "cfm", "stop_erp", "stop_cfm", "fudge_factor")
SET = "properties set"


def _joint(world: RunningWorld, request: Any) -> Answer:
    instance, name = find_joint(world.models, request.joint_name)
    state = instance.body_of_joint(name).joint_state(name)
    joint = next(j for j in instance.model.joints if j.name == name)
    return {
        "type": JOINT_TYPES[joint.kind],
        "damping": [joint.damping],
        "position": [state.position],
        "rate": [state.velocity],
    }


def _set_joint(world: RunningWorld, request: Any) -> Answer:
    instance, name = find_joint(world.models, request.joint_name)
    config = request.ode_joint_config
    damping = _first(config.damping, "damping")
    lower, upper = _first(config.loStop, "loStop"), _first(config.hiStop, "hiStop")
    speed, effort = _first(config.vel, "vel"), _first(config.fmax, "fmax")
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


def _link(world: RunningWorld, request: Any) -> Answer:
    link = find_link(world.models, request.link_name)
    model = link.instance.model
    description = model.links_by_name()[link.link]
    inertia = description.inertia
    if inertia is None:
        return {"com": pose_message(Pose())}
    return {
        "com": pose_message(Pose(inertia.centre)),
        "gravity_mode": description.gravity and not model.static,
        "mass": inertia.mass,
        **inertia.elements(),
    }


def _set_link(world: RunningWorld, request: Any) -> None:
    link = find_link(world.models, request.link_name)
    elements: Dict[str, float] = {key: getattr(request, key) for key in INERTIA_KEYS}
    if not all(map(math.isfinite, (request.mass, *elements.values()))):
        raise InputError("mass or inertia is not finite")
    centre = vector_of(request.com.position, "the centre of mass")
    inertia = Inertia(request.mass, centre, matrix_from_elements(**elements))
    change_link(link, inertia, request.gravity_mode)


def _light(world: RunningWorld, request: Any) -> Answer:
    light = world.simulation.light(request.light_name)
    fade = light.attenuation
    return {
        "diffuse": ColorRGBA(*light.diffuse),
        "attenuation_constant": fade.constant,
        "attenuation_linear": fade.linear,
        "attenuation_quadratic": fade.quadratic,
    }


def _set_light(world: RunningWorld, request: Any) -> None:
    simulation = world.simulation
    simulation.set_light(_changed(simulation.light(request.light_name), request))


def _delete_light(world: RunningWorld, request: Any) -> Answer:
    world.simulation.remove_light(request.light_name)
    return {"status_message": f"DeleteLight: {request.light_name} successfully deleted"}


def _first(values: Sequence[float], name: str) -> Optional[float]:
    """Return the value for a joint's first axis, None if there is none; raises InputError."""
    if not values:
        return None
    if math.isnan(values[0]):
        raise InputError(f"{name} is not a number")
    return values[0]


def _changed(light: Light, request: Any) -> Light:
    """Return a light with the requested properties; raises InputError."""
    keys = ("constant", "linear", "quadratic")
    fading = {key: getattr(request, f"attenuation_{key}") for key in keys}
    colour = tuple(getattr(request.diffuse, part) for part in "rgba")
    if not all(0.0 <= value < math.inf for value in (*fading.values(), *colour)):
        raise InputError("a colour or an attenuation is negative or not finite")
    direction = vector_of(request.direction, "the direction")
    return replace(
        light,
        pose=normalised_pose(request.pose),
        diffuse=colour,
        # (0, 0, 0) keeps the direction.
        direction=direction if any(direction) else light.direction,
        casts_shadows=request.cast_shadows,
        attenuation=replace(light.attenuation, **fading),
    )


# Name, type, function and status message of the services that are answered between two steps.
SERVICES = (
    ("get_joint_properties", srv.GetJointProperties, _joint, GOT),
    ("set_joint_properties", srv.SetJointProperties, _set_joint, SET),
    ("get_link_properties", srv.GetLinkProperties, _link, GOT),
    ("set_link_properties", srv.SetLinkProperties, _set_link, SET),
    # As in Gazebo, these two have no status message after a success.
    ("get_light_properties", srv.GetLightProperties, _light, ""),
    ("set_light_properties", srv.SetLightProperties, _set_light, ""),
    ("delete_light", srv.DeleteLight, _delete_light, ""),
)


def offer_services(world: RunningWorld) -> List[rospy.Service]:
    """Offer the services on the properties of joints, links and lights."""
    return [offer_between_steps(world, *row) for row in SERVICES]


# Node name under which dynamic_reconfigure finds the engine's settings.
SPACE = "/gazebo"
LIMITS = {
    "time_step": (0.0, 10.0),
    "max_update_rate": (0.0, 1e6),
    **{f"gravity_{axis}": (-100.0, 100.0) for axis in "xyz"},
}
ODE_LIMITS = {
    "auto_disable_bodies": (),
    "sor_pgs_precon_iters": (0, 10000),
    "sor_pgs_iters": (0, 10000),
    "sor_pgs_w": (0.0, 5.0),
    "sor_pgs_rms_error_tol": (-1.0, 10000.0),
    "cfm": (0.0, 10.0),
    "erp": (0.0, 10.0),
    "contact_surface_layer": (0.0, 10.0),
    "contact_max_correcting_vel": (0.0, 1e7),
    "max_contacts": (0, 10000000),
}
# Gazebo's defaults; clients send back the values that they have read.
ODE_DEFAULTS = {
    "sor_pgs_iters": 50,
    "sor_pgs_w": 1.3,
    "contact_surface_layer": 0.001,
    "contact_max_correcting_vel": 100.0,
    "erp": 0.2,
    "max_contacts": 20,
}


class GazeboPhysics:
    """Offers the services on the engine and the real-time factor, and dynamic_reconfigure.

    /bullet_lab/set_rtf changes the real-time factor only.
    """

    def __init__(self, world: RunningWorld):
        self._world = world
        self._ode = msg.ODEPhysics(**ODE_DEFAULTS)
        # The values that clients of dynamic_reconfigure have seen last.
        self._reported = self._current()
        self._services = [
            offer(
                "/gazebo/get_physics_properties",
                srv.GetPhysicsProperties,
                self._get,
                f"GetPhysicsProperties: {GOT}",
            ),
            offer(
                "/gazebo/set_physics_properties",
                srv.SetPhysicsProperties,
                self._set,
                failed="SetPhysicsProperties: ",
            ),
            offer("/bullet_lab/set_rtf", SetRtf, self._set_rtf),
            Reconfigurable(SPACE, self._settings(), self._reconfigure),
        ]

    def _current(self) -> Values:
        """Return the present values of all settings of dynamic_reconfigure."""
        now = self._get(None)
        return {
            "time_step": now["time_step"],
            "max_update_rate": now["max_update_rate"],
            **{f"gravity_{axis}": getattr(now["gravity"], axis) for axis in "xyz"},
            **{key: getattr(self._ode, key) for key in ODE_LIMITS},
        }

    def _get(self, _request: Any) -> Dict[str, Any]:
        stepper = self._world.stepper
        return {
            "time_step": STEP_SECONDS,
            "pause": stepper.paused,
            "max_update_rate": STEPS_PER_SECOND * stepper.pace.real_time_factor,
            "gravity": Vector3(*self._world.simulation.world.gravity),
            "ode_config": self._ode,
        }

    def _set(self, request: Any) -> Answer:
        if not math.isclose(request.time_step, STEP_SECONDS, rel_tol=1e-9):
            allowed = f"only {STEP_SECONDS:g} s is allowed"
            raise InputError(f"time_step is {request.time_step:g} s; {allowed}")
        gravity = vector_of(request.gravity, "gravity")
        factor = _factor(request.max_update_rate / STEPS_PER_SECOND, "max_update_rate")
        self._world.do(lambda: self._world.simulation.set_gravity(gravity))
        self._world.stepper.set_real_time_factor(factor)
        done = "physics engine updated"
        if request.ode_config != self._ode:
            self._ode = request.ode_config
            done += "; ode_config is kept and does nothing"
        return {"status_message": done}

    def _settings(self) -> List[Setting]:
        limits = {**LIMITS, **ODE_LIMITS}
        return [
            Setting(key, value, f"as in set_physics_properties: {key}", *limits[key])
            for key, value in self._reported.items()
        ]

    def _reconfigure(self, values: Values) -> Values:
        """Do as set_physics_properties with the changed values; return the resulting ones."""
        changed = {k: value for k, value in values.items() if value != self._reported.get(k)}
        wanted = {**self._current(), **changed}
        request = srv.SetPhysicsPropertiesRequest(
            time_step=wanted["time_step"],
            max_update_rate=wanted["max_update_rate"],
            gravity=Vector3(*(wanted[f"gravity_{axis}"] for axis in "xyz")),
            ode_config=msg.ODEPhysics(**{key: wanted[key] for key in ODE_LIMITS}),
        )
        try:
            self._set(request)
        except LabError as error:
            rospy.logwarn("%s: %s", SPACE, error)
        self._reported = self._current()
        return self._reported

    def _set_rtf(self, request: Any) -> None:
        self._world.stepper.set_real_time_factor(_factor(request.rtf, "rtf"))


def _factor(factor: float, name: str) -> float:
    if not 0.0 <= factor < math.inf:
        raise InputError(f"{name} is {factor}; it must be a number >= 0, 0 for full speed")
    return factor
