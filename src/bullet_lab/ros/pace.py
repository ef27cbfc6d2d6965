"""How simulated time follows the wall clock."""

from __future__ import annotations

import math
import time
from typing import Callable

from bullet_lab.simulation.schedule import STEPS_PER_SECOND

# Simulated time this far behind is not caught up with in a rush.
FORGIVEN_SECONDS = 0.1


class Pace:
    """Says which step is due now.

    Args:
        real_time_factor: simulated seconds per wall second; 0 for as fast as it goes.
        clock: monotonic seconds.
    """

    def __init__(self, real_time_factor: float, clock: Callable[[], float] = time.monotonic):
        self.real_time_factor = real_time_factor
        self._clock = clock
        self.restart(0)

    @property
    def free(self) -> bool:
        """Whether time is not tied to the wall clock."""
        return self.real_time_factor == 0.0

    def restart(self, step: int) -> None:
        """Take the present moment for the time of a step: after a pause, a stall or a reset."""
        self._start_step = step
        self._start = self._clock()

    def due(self, step: int) -> float:
        """Return the step that is due now, given that time stands at `step`.

        A simulation that cannot keep up is not chased: it goes on from where it is.
        """
        if self.free:
            return math.inf
        due = math.floor(self._start_step + self._rate * (self._clock() - self._start))
        # A whole step late is none too late, however slowly time goes.
        if due - step > max(1.0, FORGIVEN_SECONDS * self._rate):
            self.restart(step)
            return step + 1
        return due

    def seconds_until(self, step: int) -> float:
        """Return the wall seconds until a step is due; 0 if it is overdue."""
        if self.free:
            return 0.0
        wait = (step - self._start_step) / self._rate - (self._clock() - self._start)
        return max(0.0, wait)

    @property
    def _rate(self) -> float:
        return self.real_time_factor * STEPS_PER_SECOND
