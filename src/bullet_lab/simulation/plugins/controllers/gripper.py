"""Controllers of grippers with one joint, as in ros_controllers' gripper_action_controller."""

from __future__ import annotations

from typing import Optional

from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters, actions
from bullet_lab.simulation.plugins.controllers.joints import EFFORT, POSITION, STRONGEST, Pid
from bullet_lab.simulation.plugins.samples import GripperSample, is_sound

# Steps over which a velocity is measured: the engine's is wrong for a joint that is pressed against
# something, and its position trembles by 0.01 mm.
AVERAGING = 50


class Gripper(actions.ActionController):
    """Moves the joint of a gripper to a position until it is there or stalls."""

    kinds = {
        "position_controllers/GripperActionController": POSITION,
        "effort_controllers/GripperActionController": EFFORT,
    }
    action = "gripper_cmd"

    def configure(self, given: ControlParameters) -> None:
        super().configure(given)
        self.joints = self.find_joints([given.get("joint", "")])
        self._tolerance = abs(given.get("goal_tolerance", 0.01))
        self._default_effort = abs(given.get("max_effort", 0.0))
        self._slowest = given.get("stall_velocity_threshold", 0.001)
        self._patience = given.get("stall_timeout", 1.0) * STEPS_PER_SECOND
        self._pid: Optional[Pid] = None
        if self.interface == EFFORT:
            self._pid = Pid(given.below(f"gains/{self.joints[0].name}"))

    def starting(self, step: int) -> None:
        if self._pid is not None:
            self._pid.reset()
        super().starting(step)

    def begin(self, content: GripperSample, step: int) -> None:
        if not is_sound(content.position, content.effort):
            raise ControlError("position or max_effort is not finite, or too large")
        self._target, self._effort, self._moved = content.position, abs(content.effort), step

    def hold(self, step: int) -> None:
        self._target = self._place = self.joints[0].position
        self._moved = self._measured = step
        self._effort = self._default_effort

    def control(self, step: int, seconds: float) -> None:
        joint = self.joints[0]
        error, span = self._target - joint.position, step - self._measured
        if span >= AVERAGING:
            if abs(joint.position - self._place) * STEPS_PER_SECOND > self._slowest * span:
                self._moved = step
            self._place, self._measured = joint.position, step
        state = self.feedback(step)
        if abs(error) < self._tolerance:
            self.end(actions.SUCCEEDED, state._replace(reached=True))
        elif step - self._moved > self._patience:
            self.end(actions.ABORTED, state._replace(stalled=True), f"'{joint.name}' has stalled")
        if self._pid is not None:
            command = self._pid.command(error, seconds, -joint.velocity)
            joint.command = min(max(command, -self._effort), self._effort)
        else:
            joint.command = self._target
            # Gazebo places the joint; the motor here would crush what the gripper holds.
            joint.strength = min(self._effort or STRONGEST, joint.limits.effort, STRONGEST)

    def stopping(self) -> None:
        super().stopping()
        self.joints[0].strength = STRONGEST

    def feedback(self, step: int) -> GripperSample:
        return GripperSample(self.joints[0].position, self.joints[0].effort)
