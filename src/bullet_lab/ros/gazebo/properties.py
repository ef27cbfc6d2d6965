"""Gazebo's services on what joints and links are like."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Dict, Optional, Sequence

from bullet_lab.core.pose import Pose
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.gazebo.offers import Answer, offer_between_steps
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.messages.poses import InputError, pose_message, vector_of
from bullet_lab.simulation.models import change_joint, change_link, find_joint, find_link
from bullet_lab.simulation.world.description import Inertia
from bullet_lab.simulation.world.inertia import INERTIA_KEYS, matrix_from_elements

JOINT_TYPES = {
    "revolute": srv.GetJointPropertiesResponse.REVOLUTE,
    "continuous": srv.GetJointPropertiesResponse.CONTINUOUS,
    "prismatic": srv.GetJointPropertiesResponse.PRISMATIC,
}
# Those of ODE's own, which PyBullet has no use for.
UNUSED = ("erp", "cfm", "stop_erp", "stop_cfm", "fudge_factor")
SET = "properties set"


class GazeboProperties:
    """Offers the services."""

    def __init__(self, world: RunningWorld):
        self._world = world
        offered = partial(offer_between_steps, world)
        self._services = [
            offered("get_joint_properties", srv.GetJointProperties, self._joint),
            offered("set_joint_properties", srv.SetJointProperties, self._set_joint, SET),
            offered("get_link_properties", srv.GetLinkProperties, self._link),
            offered("set_link_properties", srv.SetLinkProperties, self._set_link, SET),
        ]

    def _joint(self, request: Any) -> Answer:
        instance, name = find_joint(self._world.models, request.joint_name)
        state = instance.body_of_joint(name).joint_state(name)
        joint = next(j for j in instance.model.joints if j.name == name)
        return {
            "type": JOINT_TYPES[joint.kind],
            "damping": [joint.damping],
            "position": [state.position],
            "rate": [state.velocity],
        }

    def _set_joint(self, request: Any) -> Answer:
        instance, name = find_joint(self._world.models, request.joint_name)
        config = request.ode_joint_config
        damping = _first(config.damping, "damping")
        lower, upper = _first(config.loStop, "loStop"), _first(config.hiStop, "hiStop")
        speed, effort = _first(config.vel, "vel"), _first(config.fmax, "fmax")
        if damping is not None and damping < 0.0:
            raise InputError(f"a damping of {damping:g} is negative")
        change_joint(instance, name, damping, lower, upper)
        if speed is not None or effort is not None:
            # ODE's motor: it tries to reach a speed, with no more than so much effort.
            instance.body_of_joint(name).drive_joint(name, speed or 0.0, abs(effort or 0.0))
        idle = [key for key in UNUSED if len(getattr(config, key))]
        said = f"SetJointProperties: {SET}"
        return {"status_message": f"{said}; {', '.join(idle)} do nothing here" if idle else said}

    def _link(self, request: Any) -> Answer:
        link = find_link(self._world.models, request.link_name)
        model = link.instance.model
        found = model.links_by_name()[link.link]
        inertia = found.inertia
        if inertia is None:
            return {"com": pose_message(Pose())}
        com, pulled = pose_message(Pose(inertia.centre)), found.gravity and not model.static
        properties = {"com": com, "gravity_mode": pulled, "mass": inertia.mass}
        return {**properties, **inertia.elements()}

    def _set_link(self, request: Any) -> Answer:
        link = find_link(self._world.models, request.link_name)
        elements: Dict[str, float] = {key: getattr(request, key) for key in INERTIA_KEYS}
        if not all(map(math.isfinite, (request.mass, *elements.values()))):
            raise InputError("mass or inertia is not finite")
        centre = vector_of(request.com.position, "the centre of mass")
        inertia = Inertia(request.mass, centre, matrix_from_elements(**elements))
        change_link(link, inertia, request.gravity_mode)
        return {}


def _first(values: Sequence[float], what: str) -> Optional[float]:
    """Return the first of the values for a joint's axes, None for none; raises InputError."""
    if not values:
        return None
    if math.isnan(values[0]):
        raise InputError(f"{what} is not a number")
    return values[0]
