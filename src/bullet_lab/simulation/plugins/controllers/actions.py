"""Controllers that pursue the goals of an action, and those goals, without ROS."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections import deque
from typing import Any, Callable, ClassVar, Deque, List, Mapping, NamedTuple, Optional, Tuple

from bullet_lab.core.schedule import Schedule
from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters
from bullet_lab.simulation.plugins.controllers.controller import Controller, is_due, schedule_of

LOG = logging.getLogger(__name__)

# What becomes of a goal.
ACCEPTED = "accepted"
REJECTED = "rejected"
CANCELED = "canceled"
ABORTED = "aborted"
SUCCEEDED = "succeeded"


class Goal(NamedTuple):
    """A goal of an action: its controller accepts or rejects it, and ends it once.

    `move(state, result, text)` is called with each new state, and `tell` with feedback.
    """

    content: Any
    move: Callable[[str, Any, str], None]
    tell: Callable[[Any], None]


class ActionController(Controller):
    """Base of controllers with an action. A new goal that is accepted preempts the last one.

    Commands, goals and cancellations come from any thread; they wait for the next update.

    Attributes:
        action: name of the action in the controller's namespace.
        queries: functions of a simulated time in s, by the names of services.
        goal: the active one.
    """

    action: ClassVar[str]
    queries: Mapping[str, Callable[[float], Any]] = {}

    def configure(self, given: ControlParameters) -> None:
        self.goal: Optional[Goal] = None
        self._inbox: Deque[Tuple[Callable[[Any, int], None], Any]] = deque()
        self._schedules: List[Schedule] = []
        self._monitor = self.schedule(given, "action_monitor_rate", 20.0)

    def schedule(self, given: ControlParameters, name: str, default: float) -> Optional[Schedule]:
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
        self.post(self._accept, Goal(content, lambda *_: None, lambda _: None))

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
