"""Gazebo's services on the physics engine, and settings that change through dynamic_reconfigure.

Without python3-dynamic-reconfigure, no settings are offered.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from types import SimpleNamespace
from typing import Any, Callable, Dict, Sequence

import rospy
from geometry_msgs.msg import Vector3

from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.gazebo.services import GOT, Answer, offer, offer_gazebo
from bullet_lab.ros.messages.gazebo_types import msg, srv
from bullet_lab.ros.messages.poses import InputError, vector_of
from bullet_lab.simulation.physics.physics import STEP_SECONDS
from bullet_lab.simulation.plugins.controllers.controller import Setting
from bullet_lab.srv import SetRtf

try:
    from dynamic_reconfigure.server import Server
except ImportError:
    Server = None

TYPES = {bool: "bool", int: "int", float: "double", str: "str"}
# Level of a server's first configuration, which no client has requested.
AT_START = -1
# Node name under which dynamic_reconfigure finds the engine's settings.
SPACE = "/gazebo"
LIMITS = {
    "time_step": (0.0, 10.0),
    "max_update_rate": (0.0, 1e6),
    **{f"gravity_{axis}": (-100.0, 100.0) for axis in "xyz"},
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

Values = Dict[str, Any]


class Reconfigurable:
    """Offers settings in a namespace; does nothing without dynamic_reconfigure.

    `change(values)` is called with all requested values, in the thread of the service, and returns
    those that it changes once more. If a number is not finite, a text is none of the choices, or
    `change` raises LabError, nothing is changed.
    """

    def __init__(
        self, namespace: str, settings: Sequence[Setting], change: Callable[[Values], Values | None]
    ):
        self._namespace, self._change = namespace, change
        self._choices = {one.name: one.choices for one in settings if one.choices}
        self._values: Values = {}
        self._server = Server and _server_class()(_type_of(settings), self._take, namespace)

    def shutdown(self) -> None:
        """Shut down the service and the topics."""
        if self._server:
            self._server.set_service.shutdown()
            self._server.descr_topic.unregister()
            self._server.update_topic.unregister()

    def _take(self, values: Values, level: int) -> Values:
        if level != AT_START:
            try:
                for name, value in values.items():
                    if isinstance(value, float) and not math.isfinite(value):
                        raise InputError(f"{name} is {value}, which is not finite")
                for name, choices in self._choices.items():
                    if values[name] not in choices:
                        raise InputError(f"{name} is '{values[name]}'; known are {choices}")
                values.update(self._change(dict(values)) or {})
            except LabError as error:
                if not rospy.is_shutdown():
                    rospy.logwarn("%s: %s; nothing is changed", self._namespace, error)
                values.update(self._values)
        self._values = dict(values)
        return values


def _server_class() -> Any:
    class OneGroup(Server):
        """Ignores the groups of a request, which make the library fail: there is one group."""

        def _set_callback(self, request: Any) -> Any:
            request.config.groups = []
            return super()._set_callback(request)

    return OneGroup


def _type_of(settings: Sequence[Setting]) -> Any:
    """Return the module that dynamic_reconfigure would generate for the settings."""
    group = {"name": "Default", "type": "", "state": True, "id": 0, "parent": 0, "groups": []}
    booleans = [setting for setting in settings if isinstance(setting.default, bool)]
    return SimpleNamespace(
        config_description={**group, "parameters": list(map(_described, settings))},
        defaults={setting.name: setting.default for setting in settings},
        min={s.name: False if s in booleans else s.min for s in settings},
        max={s.name: True if s in booleans else s.max for s in settings},
    )


def _described(setting: Setting) -> Values:
    """Return the description of a setting for dynamic_reconfigure."""
    kind = TYPES[type(setting.default)]
    entries = [
        {"name": choice, "value": choice, "type": kind, "description": choice}
        for choice in setting.choices
    ]
    method = {"enum": entries, "enum_description": setting.description}
    edit_method = str(method) if entries else ""
    return {**asdict(setting), "type": kind, "level": 1, "edit_method": edit_method}


class GazeboPhysics:
    """Offers the services on the engine and the real-time factor, and dynamic_reconfigure.

    /bullet_lab/set_rtf changes the real-time factor only.
    """

    def __init__(self, world: RunningWorld):
        self._world = world
        self._ode = msg.ODEPhysics(**ODE_DEFAULTS)
        # The values that clients of dynamic_reconfigure have seen last.
        self._reported = self._current()
        settings = [
            Setting(key, value, f"as in set_physics_properties: {key}", *LIMITS[key])
            for key, value in self._reported.items()
        ]
        offer_gazebo("get_physics_properties", srv.GetPhysicsProperties, self._get, GOT)
        offer_gazebo("set_physics_properties", srv.SetPhysicsProperties, self._set)
        offer("/bullet_lab/set_rtf", SetRtf, self._set_rtf)
        Reconfigurable(SPACE, settings, self._reconfigure)

    def _current(self) -> Values:
        """Return the present values of all settings of dynamic_reconfigure."""
        values = self._get(None)
        values.update({f"gravity_{axis}": getattr(values["gravity"], axis) for axis in "xyz"})
        return {key: values[key] for key in LIMITS}

    def _get(self, _request: Any) -> Values:
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

    def _reconfigure(self, values: Values) -> Values:
        """Do as set_physics_properties with the changed values; return the resulting ones."""
        changed = {k: value for k, value in values.items() if value != self._reported.get(k)}
        wanted = {**self._current(), **changed}
        gravity = Vector3(*(wanted[f"gravity_{axis}"] for axis in "xyz"))
        given = (wanted["time_step"], wanted["max_update_rate"], gravity, self._ode)
        self._set(srv.SetPhysicsPropertiesRequest(*given))
        self._reported = self._current()
        return self._reported

    def _set_rtf(self, request: Any) -> None:
        self._world.stepper.set_real_time_factor(_factor(request.rtf, "rtf"))


def _factor(factor: float, name: str) -> float:
    if not 0.0 <= factor < math.inf:
        raise InputError(f"{name} is {factor}; it must be a number >= 0, 0 for full speed")
    return factor
