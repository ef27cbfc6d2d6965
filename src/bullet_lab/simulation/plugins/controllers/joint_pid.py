"""Controllers that bring joints to a position or speed by a PID loop."""

from __future__ import annotations

from typing import Tuple

from bullet_lab.simulation.plugins.controllers.controller import (
    EFFORT,
    VELOCITY,
    ControllerSetup,
)
from bullet_lab.simulation.plugins.controllers.forward_command import JointTargets
from bullet_lab.simulation.plugins.controllers.hardware import JointHandle
from bullet_lab.simulation.plugins.controllers.pid import Pid, PidGains
from bullet_lab.simulation.plugins.plugin import Output
from bullet_lab.simulation.plugins.samples import LoopSample

SPEED = "effort_controllers/JointVelocityController"
# Updates from one message of the state to the next.
STATE_EVERY = 10


class JointPid(JointTargets):
    """Brings joints to a position or a speed by an effort, or to a position by a speed.

    Parameters beside those of the joints: the gains in pid, or <joint>/pid in a group. A single
    joint's state is sent at each tenth update.
    """

    kinds = {
        "effort_controllers/JointPositionController": EFFORT,
        "effort_controllers/JointGroupPositionController": EFFORT,
        "velocity_controllers/JointPositionController": VELOCITY,
        SPEED: EFFORT,
    }

    def __init__(self, setup: ControllerSetup):
        super().__init__(setup)
        below = [f"{joint.name}/pid" if self.grouped else "pid" for joint in self.joints]
        self._pids = [Pid(PidGains.of(setup.parameters.below(path))) for path in below]
        self._updates = 0
        self.states = Output(setup.topic("state"), LoopSample)
        self.outputs = () if self.grouped else (self.states,)

    def starting(self, step: int) -> None:
        turning = self.setup.kind == SPEED
        self.targets = tuple(0.0 if turning else joint.position for joint in self.joints)
        for pid in self._pids:
            pid.reset()

    def update(self, step: int, seconds: float) -> None:
        for joint, pid, target in zip(self.joints, self._pids, self.targets):
            target, error = self._error(joint, target)
            joint.command = pid.command(error, seconds)
            if self._updates % STATE_EVERY == 0 and self.outputs and self.states.wanted:
                self.states.send(self._state(step, seconds, joint, pid, (target, error)))
        self._updates += 1

    def _error(self, joint: JointHandle, target: float) -> Tuple[float, float]:
        """Return what a joint is brought to, and how far it is from there."""
        if self.setup.kind == SPEED:
            return target, target - joint.velocity
        target = joint.described.within_limits(target)
        return target, joint.described.error(joint.position, target)

    def _state(
        self,
        step: int,
        seconds: float,
        joint: JointHandle,
        pid: Pid,
        task: Tuple[float, float],
    ) -> LoopSample:
        turning = self.setup.kind == SPEED
        value, slope = (joint.velocity, 0.0) if turning else (joint.position, joint.velocity)
        gains = pid.gains
        told = (gains.p, gains.i, gains.d, gains.i_max)
        return LoopSample(
            step, task[0], value, slope, task[1], seconds, joint.command, told, gains.antiwindup
        )
