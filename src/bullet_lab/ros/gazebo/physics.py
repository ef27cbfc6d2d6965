"""Services on how the world is stepped: /gazebo/get_physics_properties and set_physics_properties.

Beside them /bullet_lab/set_rtf, which changes the speed and nothing else.
"""

from __future__ import annotations

import math
from typing import Any

import rospy
from geometry_msgs.msg import Vector3

from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.gazebo.services import Answer, offer
from bullet_lab.ros.messages.gazebo import MessageError, vector_of
from bullet_lab.ros.messages.gazebo_types import msg, srv
from bullet_lab.simulation.physics.physics import STEP_SECONDS
from bullet_lab.srv import SetRtf, SetRtfResponse

# What Gazebo starts with; clients send back what they were told.
ODE_DEFAULTS = {
    "sor_pgs_iters": 50,
    "sor_pgs_w": 1.3,
    "contact_surface_layer": 0.001,
    "contact_max_correcting_vel": 100.0,
    "erp": 0.2,
    "max_contacts": 20,
}


class GazeboPhysics:
    """Offers the services."""

    def __init__(self, world: RunningWorld):
        self._world = world
        self._ode = msg.ODEPhysics(**{**_zeros(), **ODE_DEFAULTS})
        self.services = [
            offer(
                "get_physics_properties",
                srv.GetPhysicsProperties,
                self._get,
                "GetPhysicsProperties: got properties",
            ),
            offer(
                "set_physics_properties",
                srv.SetPhysicsProperties,
                self._set,
                "physics engine updated",
            ),
            rospy.Service("/bullet_lab/set_rtf", SetRtf, self._set_rtf),
        ]

    def _get(self, _request: Any) -> Answer:
        stepper = self._world.stepper
        return {
            "time_step": STEP_SECONDS,
            "pause": stepper.paused,
            "max_update_rate": STEPS_PER_SECOND * stepper.pace.real_time_factor,
            "gravity": Vector3(*self._world.do(lambda: self._world.simulation.world.gravity)),
            "ode_config": self._ode,
        }

    def _set(self, request: Any) -> Answer:
        if not math.isclose(request.time_step, STEP_SECONDS, rel_tol=1e-9):
            raise MessageError(
                f"time_step is {request.time_step:g} s: it is {STEP_SECONDS:g} s here, always"
            )
        gravity = vector_of(request.gravity, "gravity")
        factor = _factor(request.max_update_rate / STEPS_PER_SECOND, "max_update_rate")
        self._world.do(lambda: self._world.simulation.set_gravity(gravity))
        self._world.stepper.set_real_time_factor(factor)
        if request.ode_config == self._ode:
            return {}
        self._ode = request.ode_config
        return {"status_message": "physics engine updated; ode_config is kept and does nothing"}

    def _set_rtf(self, request: Any) -> SetRtfResponse:
        try:
            self._world.stepper.set_real_time_factor(_factor(request.rtf, "rtf"))
        except LabError as error:
            return SetRtfResponse(success=False, status_message=str(error))
        return SetRtfResponse(success=True, status_message="")


def _factor(factor: float, name: str) -> float:
    if not 0.0 <= factor < math.inf:
        raise MessageError(f"{name} must be a number >= 0, 0 for as fast as it goes")
    return factor


def _zeros() -> Answer:
    empty = msg.ODEPhysics()
    return {name: getattr(empty, name) for name in empty.__slots__}
