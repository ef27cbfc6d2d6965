"""Gazebo's services on lights."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

from std_msgs.msg import ColorRGBA

from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.gazebo.offers import Answer, offer_between_steps
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.messages.poses import InputError, normalised_pose, vector_of
from bullet_lab.simulation.world.description import Light


class GazeboLights:
    """Offers the services; lights come by spawn_sdf_model."""

    def __init__(self, world: RunningWorld):
        self._world = world
        offered = partial(offer_between_steps, world)
        self._services = [
            # As in Gazebo, without a word where all is well.
            offered("get_light_properties", srv.GetLightProperties, self._get, ""),
            offered("set_light_properties", srv.SetLightProperties, self._set, ""),
            offered("delete_light", srv.DeleteLight, self._delete),
        ]

    def _get(self, request: Any) -> Answer:
        light = self._world.simulation.light(request.light_name)
        fade = light.attenuation
        return {
            "diffuse": ColorRGBA(*light.diffuse),
            "attenuation_constant": fade.constant,
            "attenuation_linear": fade.linear,
            "attenuation_quadratic": fade.quadratic,
        }

    def _set(self, request: Any) -> Answer:
        simulation = self._world.simulation
        simulation.set_light(_changed(simulation.light(request.light_name), request))
        return {}

    def _delete(self, request: Any) -> Answer:
        self._world.simulation.remove_light(request.light_name)
        return {"status_message": f"DeleteLight: {request.light_name} successfully deleted"}


def _changed(light: Light, request: Any) -> Light:
    """Return a light as a request has it; raises InputError."""
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
        # None at all is no direction.
        direction=direction if any(direction) else light.direction,
        casts_shadows=request.cast_shadows,
        attenuation=replace(light.attenuation, **fading),
    )
