"""A stage in this process: the simulation itself, without ROS."""

from __future__ import annotations

from typing import Tuple

from beside_scenarios import Push, Stage

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.forces import Effort, Period, Wrench
from bullet_lab.simulation.models import find_joint, find_link
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import FrameState
from bullet_lab.simulation.world.sdf import read_spawned

FLOOR = "package://bullet_lab/worlds/empty.world"


class DirectStage(Stage):
    """The simulation in this process; a new one after `clear`."""

    def __init__(self):
        self.simulation = Simulation.of(FLOOR)
        self._spawned = 0

    def spawn(self, text: str, pose: Pose) -> str:
        model = read_spawned(text, "a model")
        self._spawned += 1
        name = f"{model.name}_{self._spawned}"
        self.simulation.add(model, name, pose * model.pose)
        return name

    def clear(self) -> None:
        self.simulation.close()
        self.simulation = Simulation.of(FLOOR)

    def state(self, name: str) -> FrameState:
        instance = self.simulation.models[name]
        return FrameState(instance.pose(), *instance.frame().velocity())

    def put(self, name: str, state: FrameState) -> None:
        self.simulation.models[name].move(state.pose, state.linear, state.angular)

    def command(self, name: str, vx: float, vy: float, wz: float) -> None:
        self.simulation.models[name].command("cmd_vel", PlanarCommand(vx, vy, wz))

    def push(self, body: str, push: Push) -> None:
        if push.frame:
            raise NotImplementedError("frames belong to the service; play it through ROS")
        link = find_link(self.simulation.models, body)
        given_in = FrameState(Pose(link.frame.pose().position))
        period = Period.after(self.simulation.step, 0.0, push.seconds)
        wrench = Wrench.at_point(given_in, link, push.force, push.torque, push.point, period)
        self.simulation.forces.add(wrench)

    def exert(self, name: str, joint: str, effort: float, seconds: float) -> None:
        found = find_joint(self.simulation.models, f"{name}::{joint}")
        period = Period.after(self.simulation.step, 0.0, seconds)
        self.simulation.forces.add(Effort(*found, effort, period))

    def joint(self, name: str, joint: str) -> Tuple[float, float]:
        state = self.simulation.models[name].body_of_joint(joint).joint_state(joint)
        return state.position, state.velocity

    def turn_joint(self, name: str, joint: str, position: float) -> None:
        self.simulation.models[name].configure({joint: position})

    def run(self, seconds: float) -> None:
        self.simulation.run_for(seconds)
