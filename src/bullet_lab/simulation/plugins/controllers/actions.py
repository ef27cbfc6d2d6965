"""Controllers that pursue the goals of an action, and those goals, without ROS."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections import deque
from dataclasses import dataclass
from typing import Any, Callable, ClassVar, Deque, Mapping, Optional, Tuple

from bullet_lab.core.schedule import Schedule
from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters
from bullet_lab.simulation.plugins.controllers.controller import Controller, is_due, schedule_of

LOG = logging.getLogger(__name__)

# States of a goal.
PENDING = "pending"
ACTIVE = "active"
REJECTED = "rejected"
PREEMPTED = "preempted"
ABORTED = "aborted"
SUCCEEDED = "succeeded"


@dataclass(eq=False)
class Goal:
    """A goal of an action: its controller accepts or rejects it, and ends it once.

    Attributes:
        content: what is asked for.
        moved: called with the goal after each change of its state.
        tell: called with feedback.
        state: one of the states above.
        result: after its end, or None.
        text: why it ended so, for people.
    """

    content: Any
    moved: Callable[[Goal], None] = lambda _goal: None
    tell: Callable[[Any], None] = lambda _feedback: None
    state: str = PENDING
    result: Any = None
    text: str = ""

    def move(self, state: str, result: Any = None, text: str = "") -> None:
        """Change the state."""
        self.state, self.result, self.text = state, result, text
        self.moved(self)


class ActionController(Controller):
    """Base of controllers with an action. A new goal that is accepted preempts the last one.

    Commands, goals and cancellations come from any thread; they wait for the next update.

    Parameter: action_monitor_rate, of the feedback, in Hz.

    Attributes:
        action: name of the action in the controller's namespace.
        goal_kind: the class of its goals' contents.
        queries: functions of a simulated time in s that services call between two steps, by name.
        goal: the active one.
    """

    action: ClassVar[str]
    goal_kind: ClassVar[type]
    queries: Mapping[str, Callable[[float], Any]] = {}

    def configure(self, given: ControlParameters) -> None:
        self.goal: Optional[Goal] = None
        self._inbox: Deque[Tuple[Callable[[Any, int], None], Any]] = deque()
        self._monitor = self.schedule(given, "action_monitor_rate", 20.0)

    @staticmethod
    def schedule(given: ControlParameters, name: str, default: float) -> Optional[Schedule]:
        """Return the schedule for a rate; None for a rate of 0. Raises ControlError."""
        rate = given.get(name, default)
        return schedule_of(rate, given.where, name) if rate else None

    def post(self, handle: Callable[[Any, int], None], content: Any) -> None:
        """Call `handle(content, step)` at the next update; raises ControlError if not running."""
        if not self.running:
            raise ControlError(f"controller '{self.name}' is not running")
        self._inbox.append((handle, content))

    def receive(self, goal: Goal) -> None:
        """Take a new goal; it is rejected if the controller does not run."""
        try:
            self.post(self._accept, goal)
        except ControlError as error:
            self._reject(goal, error)

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
        for schedule in filter(None, (self._monitor, *self.others())):
            schedule.restart(step)
        self.hold(step)

    def stopping(self) -> None:
        self.end(PREEMPTED)
        for goal in (content for _, content in self._inbox if isinstance(content, Goal)):
            if goal.state == PENDING:
                self._reject(goal, ControlError(f"controller '{self.name}' was stopped"))
        self._inbox.clear()

    def reset(self, step: int) -> None:
        self.stopping()
        self.starting(step)

    def end(self, state: str, result: Any = None, text: str = "") -> None:
        """End the active goal, if there is one."""
        goal, self.goal = self.goal, None
        if goal is not None:
            goal.move(state, result, text)

    def others(self) -> Tuple[Optional[Schedule], ...]:
        """Return further schedules, which begin when the controller starts."""
        return ()

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
        self.end(PREEMPTED)
        self.goal = goal
        goal.move(ACTIVE)

    def _reject(self, goal: Goal, error: ControlError) -> None:
        LOG.error("controller '%s': goal rejected: %s", self.name, error)
        goal.move(REJECTED, self.refusal(error), str(error))

    def _cancel(self, goal: Goal, step: int) -> None:
        if goal is self.goal:
            self.hold(step)
            self.end(PREEMPTED)
