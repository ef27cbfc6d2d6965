"""All that the bridge offers under /gazebo, with the services on the world as a whole.

The latter are /gazebo/get_physics_properties and set_physics_properties, /bullet_lab/set_rtf,
which changes the speed and nothing else, and /bullet_lab/save_world: the running world as an SDF
file.
"""

from __future__ import annotations

import math
import threading
import time
from pathlib import Path
from typing import Any

import rospy
from geometry_msgs.msg import Vector3

from bullet_lab.core.files import replace_file
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.bridge.world_topics import WorldMarkers
from bullet_lab.ros.gazebo.forces import GazeboForces
from bullet_lab.ros.gazebo.models import GazeboModels
from bullet_lab.ros.gazebo.services import Answer, offer
from bullet_lab.ros.gazebo.states import GazeboStates, GazeboTopics
from bullet_lab.ros.messages.gazebo_types import msg, srv
from bullet_lab.ros.messages.poses import InputError, time_of, vector_of
from bullet_lab.simulation.physics.physics import STEP_SECONDS
from bullet_lab.simulation.world.sdf_writer import world_text
from bullet_lab.srv import SaveWorld, SaveWorldResponse, SetRtf, SetRtfResponse

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
        self._ode = msg.ODEPhysics()
        for name, value in ODE_DEFAULTS.items():
            setattr(self._ode, name, value)
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
            raise InputError(
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
        raise InputError(f"{name} must be a number >= 0, 0 for as fast as it goes")
    return factor


class SaveError(LabError):
    """A world cannot be saved there."""


class WorldSaver:
    """Offers the service.

    Only the look at where everything is holds the simulation up; the text is made and written
    in the thread of whoever asks.
    """

    def __init__(self, world: RunningWorld):
        self._world = world
        self._lock = threading.Lock()
        self._service = rospy.Service("/bullet_lab/save_world", SaveWorld, self._save)

    def _save(self, request: Any) -> SaveWorldResponse:
        start = time.perf_counter()
        try:
            # One at a time, or the later file could be put in place before the earlier one.
            with self._lock:
                response = self._write(request.path)
        except LabError as error:
            return SaveWorldResponse(success=False, status_message=str(error))
        response.seconds = time.perf_counter() - start
        return response

    def _write(self, name: str) -> SaveWorldResponse:
        path = _target(name)
        snapshot = self._world.do(self._world.simulation.snapshot)
        text, notes = world_text(snapshot, path.parent)
        replace_file(path, lambda part: part.write_text(text, encoding="utf-8"))
        return SaveWorldResponse(
            success=True,
            status_message="; ".join(notes),
            path=str(path),
            models=len(snapshot.models),
            saved_at=time_of(snapshot.step),
        )


def _target(name: str) -> Path:
    if not name or "\0" in name:
        raise SaveError("no file is named")
    path = Path(name).expanduser().absolute()
    if path.is_dir():
        raise SaveError(f"{path} is a folder")
    if not path.parent.is_dir():
        raise SaveError(f"there is no folder {path.parent}")
    return path


class Gazebo:
    """Gazebo's services and topics on a running world.

    Args:
        world: the world.
        frame: the world's frame in RViz.
        hidden: name of the model that RViz shows as a robot.
        states_rate: messages per simulated second on /gazebo/model_states and link_states.
    """

    def __init__(self, world: RunningWorld, frame: str, hidden: str, states_rate: float):
        self._world = world
        self._markers = WorldMarkers(world, frame, hidden)
        self._topics = GazeboTopics(world, states_rate)
        self._services = [
            GazeboModels(world),
            GazeboStates(world),
            GazeboForces(world),
            GazeboPhysics(world),
            WorldSaver(world),
        ]

    def everything_moved(self) -> None:
        """Show that models were put elsewhere, by somebody else."""
        self._world.change(lambda: "")
