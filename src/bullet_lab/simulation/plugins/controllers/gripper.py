"""Controllers of grippers with one joint, as in ros_controllers' gripper_action_controller."""

from __future__ import annotations

from typing import Optional

from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters
from bullet_lab.simulation.plugins.controllers.actions import ABORTED, SUCCEEDED, ActionController
from bullet_lab.simulation.plugins.controllers.joints import EFFORT, POSITION, STRONGEST, Pid
from bullet_lab.simulation.plugins.samples import GripperGoal, GripperSample, is_sound

# Steps over which a velocity is measured: the engine's is wrong for a joint that is pressed against
# something, and its position trembles by 0.01 mm.
AVERAGING = 50


class Gripper(ActionController):
    """Moves the joint of a gripper to a position until it is there or stalls.

    Parameters: joint, goal_tolerance (rad or m), max_effort (N m or N), stall_velocity_threshold
    (per s), stall_timeout in s, and for efforts gains/<joint>.
    """

    kinds = {
        "position_controllers/GripperActionController": POSITION,
        "effort_controllers/GripperActionController": EFFORT,
    }
    action = "gripper_cmd"
    goal_kind = GripperGoal

    def configure(self, given: ControlParameters) -> None:
        super().configure(given)
        self.joints = self.find_joints([given.get("joint", "")])
        (self._joint,) = self.joints
        self._tolerance = abs(given.get("goal_tolerance", 0.01))
        self._default_effort = abs(given.get("max_effort", 0.0))
        self._slowest = given.get("stall_velocity_threshold", 0.001)
        self._patience = given.get("stall_timeout", 1.0)
        self._pid: Optional[Pid] = None
        if self.interface == EFFORT:
            self._pid = Pid(given.below(f"gains/{self._joint.name}"))

    def starting(self, step: int) -> None:
        if self._pid is not None:
            self._pid.reset()
        super().starting(step)

    def begin(self, content: GripperGoal, step: int) -> None:
        if not is_sound(content.position, content.effort):
            raise ControlError("position or max_effort is not finite, or too large")
        self._target, self._effort, self._moved = content.position, abs(content.effort), step

    def hold(self, step: int) -> None:
        self._target, self._effort = self._joint.position, self._default_effort
        self._moved = self._measured = step
        self._place = self._joint.position

    def control(self, step: int, seconds: float) -> None:
        joint = self._joint
        error = self._target - joint.position
        if step - self._measured >= AVERAGING:
            way = abs(joint.position - self._place)
            if way * STEPS_PER_SECOND > self._slowest * (step - self._measured):
                self._moved = step
            self._place, self._measured = joint.position, step
        if self.goal is not None and abs(error) < self._tolerance:
            self.end(SUCCEEDED, self._sample(reached=True))
        elif self.goal is not None and step - self._moved > self._patience * STEPS_PER_SECOND:
            self.end(ABORTED, self._sample(stalled=True), f"'{joint.name}' has stalled")
        if self._pid is not None:
            command = self._pid.command(error, seconds, -joint.velocity)
            joint.command = min(max(command, -self._effort), self._effort)
        else:
            joint.command = self._target
            # Gazebo places the joint; the motor here would crush what the gripper holds.
            joint.strength = min(self._effort or STRONGEST, joint.limits.effort, STRONGEST)

    def stopping(self) -> None:
        super().stopping()
        self._joint.strength = STRONGEST

    def feedback(self, step: int) -> GripperSample:
        return self._sample()

    def _sample(self, stalled: bool = False, reached: bool = False) -> GripperSample:
        return GripperSample(self._joint.position, self._joint.effort, stalled, reached)
