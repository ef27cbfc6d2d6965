"""Gazebo's services on the engine and the speed, and the same through dynamic_reconfigure.

/bullet_lab/set_rtf changes the speed and nothing else.
"""

from __future__ import annotations

import math
from typing import Any, List

import rospy
from geometry_msgs.msg import Vector3

from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.gazebo.offers import Answer, offer
from bullet_lab.ros.gazebo.reconfigure import Reconfigurable, Setting, Values
from bullet_lab.ros.messages.gazebo_types import msg, srv
from bullet_lab.ros.messages.poses import InputError, vector_of
from bullet_lab.simulation.physics.physics import STEP_SECONDS
from bullet_lab.srv import SetRtf, SetRtfResponse

# Where dynamic_reconfigure finds it.
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
    """Offers the services on the engine and on the speed."""

    def __init__(self, world: RunningWorld):
        self._world = world
        self._ode = msg.ODEPhysics(**ODE_DEFAULTS)
        # What clients of dynamic_reconfigure were told last.
        self._told = self._known()
        read = "GetPhysicsProperties: got properties"
        written = "physics engine updated"
        self._services = [
            offer("get_physics_properties", srv.GetPhysicsProperties, self._get, read),
            offer("set_physics_properties", srv.SetPhysicsProperties, self._set, written),
            rospy.Service("/bullet_lab/set_rtf", SetRtf, self._set_rtf),
            Reconfigurable(SPACE, self._settings(), self._reconfigure),
        ]

    def _known(self) -> Values:
        """Return what can be reconfigured, as it is now."""
        known = self._get(None)
        given = {key: known[key] for key in ("time_step", "max_update_rate")}
        given.update({f"gravity_{axis}": getattr(known["gravity"], axis) for axis in "xyz"})
        return {**given, **{key: getattr(self._ode, key) for key in ODE_LIMITS}}

    def _get(self, _request: Any) -> Answer:
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
            always = f"it is {STEP_SECONDS:g} s here, always"
            raise InputError(f"time_step is {request.time_step:g} s: {always}")
        gravity = vector_of(request.gravity, "gravity")
        factor = _factor(request.max_update_rate / STEPS_PER_SECOND, "max_update_rate")
        self._world.do(lambda: self._world.simulation.set_gravity(gravity))
        self._world.stepper.set_real_time_factor(factor)
        if request.ode_config == self._ode:
            return {}
        self._ode = request.ode_config
        return {"status_message": "physics engine updated; ode_config is kept and does nothing"}

    def _settings(self) -> List[Setting]:
        limits = {**LIMITS, **ODE_LIMITS}
        return [
            Setting(key, value, f"as in set_physics_properties: {key}", *limits[key])
            for key, value in self._known().items()
        ]

    def _reconfigure(self, values: Values) -> Values:
        """Do as set_physics_properties with what was changed; return what holds afterwards."""
        told = {key: value for key, value in values.items() if value != self._told.get(key)}
        wanted = {**self._known(), **told}
        gravity = Vector3(*(wanted[f"gravity_{axis}"] for axis in "xyz"))
        ode = msg.ODEPhysics(**{key: wanted[key] for key in ODE_LIMITS})
        rest = {key: wanted[key] for key in ("time_step", "max_update_rate")}
        try:
            self._set(srv.SetPhysicsPropertiesRequest(**rest, gravity=gravity, ode_config=ode))
        except LabError as error:
            rospy.logwarn("%s: %s", SPACE, error)
        self._told = self._known()
        return self._told

    def _set_rtf(self, request: Any) -> SetRtfResponse:
        try:
            self._world.stepper.set_real_time_factor(_factor(request.rtf, "rtf"))
        except LabError as error:
            return SetRtfResponse(success=False, status_message=str(error))
        return SetRtfResponse(success=True, status_message="")


def _factor(factor: float, name: str) -> float:
    if not 0.0 <= factor < math.inf:
        raise InputError(f"{name} must be a number >= 0, 0 for as fast as it goes")
    return factor
