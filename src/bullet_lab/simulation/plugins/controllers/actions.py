"""Controllers that pursue the goals of an action, and those goals, without ROS.

Their base, and the controllers of grippers with one joint; `trajectories` has the others.
"""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections import deque
from typing import Any, Callable, Mapping, NamedTuple

from bullet_lab.core.schedule import STEPS_PER_SECOND, Schedule
from bullet_lab.drive import clip
from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters
from bullet_lab.simulation.plugins.controllers.controller import Controller, is_due, schedule_of
from bullet_lab.simulation.plugins.controllers.joints import EFFORT, POSITION, STRONGEST, Pid
from bullet_lab.simulation.plugins.samples import GripperSample, is_sound

LOG = logging.getLogger(__name__)

# What becomes of a goal.
ACCEPTED = "accepted"
REJECTED = "rejected"
CANCELED = "canceled"
ABORTED = "aborted"
SUCCEEDED = "succeeded"
# Steps over which a velocity is measured: the engine's is wrong for a joint that is pressed against
# something, and its position trembles by 0.01 mm.
AVERAGING = 50


class Goal(NamedTuple):
    """A goal of an action: its controller accepts or rejects it, and ends it once.

    `move(state, result, text)` is called with each new state, and `tell` with feedback.
    """

    content: Any
    move: Callable[[str, Any, str], None] = lambda *_: None
    tell: Callable[[Any], None] = lambda _: None


class ActionController(Controller):
    """Base of controllers with an action. A new goal that is accepted preempts the last one.

    Commands, goals and cancellations come from any thread; they wait for the next update.
    Subclasses define `action`, the name of the action in the controller's namespace.

    Attributes:
        queries: functions of a simulated time in s, by the names of services.
        goal: the active one.
    """

    queries: Mapping[str, Callable[[float], Any]] = {}

    def configure(self, given: ControlParameters) -> None:
        self.goal: Goal | None = None
        self._inbox: deque[tuple[Callable[[Any, int], None], Any]] = deque()
        self._schedules: list[Schedule] = []
        self._monitor = self.schedule(given, "action_monitor_rate", 20.0)

    def schedule(self, given: ControlParameters, name: str, default: float) -> Schedule | None:
        """Return the schedule for a rate; None for a rate of 0. Raises ControlError."""
        rate = given.get(name, default)
        made = schedule_of(rate, given.where, name) if rate else None
        self._schedules += [made] if made else []
        return made

    def post(self, handle: Callable[[Any, int], None], content: Any) -> None:
        """Call `handle(content, step)` at the next update; raises ControlError if not running."""
        if not self.running:
            raise ControlError(f"controller '{self.name}' is not running")
        self._inbox.append((handle, content))

    def receive(self, goal: Goal) -> None:
        """Take a new goal."""
        try:
            self.post(self._accept, goal)
        except ControlError as error:
            self._reject(goal, error)

    def take(self, content: Any) -> None:
        """Take a command as a goal of nobody; raises ControlError if not running."""
        self.post(self._accept, Goal(content))

    def cancel(self, goal: Goal) -> None:
        """Cancel a goal, if it is still active at the next update."""
        self._inbox.append((self._cancel, goal))

    def update(self, step: int, seconds: float) -> None:
        while self._inbox:
            handle, content = self._inbox.popleft()
            handle(content, step)
        self.control(step, seconds)
        if is_due(self._monitor, step) and self.goal is not None:
            self.goal.tell(self.feedback(step))

    def starting(self, step: int) -> None:
        for schedule in self._schedules:
            schedule.restart(step)
        self.hold(step)

    def stopping(self) -> None:
        self.end(CANCELED)
        while self._inbox:
            handle, content = self._inbox.popleft()
            if handle == self._accept:
                self._reject(content, ControlError(f"controller '{self.name}' was stopped"))

    def reset(self, step: int) -> None:
        self.stopping()
        self.starting(step)

    def end(self, state: str, result: Any = None, text: str = "") -> None:
        """End the active goal, if there is one."""
        goal, self.goal = self.goal, None
        if goal is not None:
            goal.move(state, result, text)

    def refusal(self, error: ControlError) -> Any:
        """Return the result of a goal that is rejected because of an error."""

    @abstractmethod
    def begin(self, content: Any, step: int) -> None:
        """Pursue the content of a new goal; raises ControlError to reject it."""

    @abstractmethod
    def hold(self, step: int) -> None:
        """Hold the joints where they are."""

    @abstractmethod
    def control(self, step: int, seconds: float) -> None:
        """Command the joints at an update, and end the goal if that is due."""

    @abstractmethod
    def feedback(self, step: int) -> Any:
        """Return how the active goal stands."""

    def _accept(self, goal: Goal, step: int) -> None:
        try:
            self.begin(goal.content, step)
        except ControlError as error:
            self._reject(goal, error)
            return
        self.end(CANCELED)
        self.goal = goal
        goal.move(ACCEPTED, None, "")

    def _reject(self, goal: Goal, error: ControlError) -> None:
        LOG.error("controller '%s': goal rejected: %s", self.name, error)
        goal.move(REJECTED, self.refusal(error), str(error))

    def _cancel(self, goal: Goal, step: int) -> None:
        if goal is self.goal:
            self.hold(step)
            self.end(CANCELED)


class Gripper(ActionController):
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
        gains = given.below(f"gains/{self.joints[0].name}")
        self._pid = Pid(gains) if self.interface == EFFORT else None

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
            self.end(SUCCEEDED, state._replace(reached=True))
        elif step - self._moved > self._patience:
            self.end(ABORTED, state._replace(stalled=True), f"'{joint.name}' has stalled")
        if self._pid is not None:
            command = self._pid.command(error, seconds, -joint.velocity)
            joint.command = clip(command, self._effort)
        else:
            joint.command = self._target
            # Gazebo places the joint; the motor here would crush what the gripper holds.
            joint.strength = min(self._effort or STRONGEST, joint.limits.effort, STRONGEST)

    def stopping(self) -> None:
        super().stopping()
        self.joints[0].strength = STRONGEST

    def feedback(self, step: int) -> GripperSample:
        return GripperSample(self.joints[0].position, self.joints[0].effort)
