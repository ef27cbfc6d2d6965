"""How simulated time follows the wall clock, and how far it may go.

The scheme is the conservative one of distributed simulation (Chandy and Misra 1979; "time
advance request" in the High Level Architecture): time never passes what each member has
granted, so no member ever sees a world that ran ahead of it, whatever the speed of the machine.
"""

from __future__ import annotations

import math
import threading
import time
from typing import Callable, Dict, Iterable, Optional, Tuple

from bullet_lab.core.schedule import STEPS_PER_SECOND

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


FOR_EVER = math.inf


class TimeGate:
    """Keeps what each member has granted. All calls may come from any thread.

    Args:
        expected: names of members without whom time does not start.
    """

    def __init__(self, expected: Iterable[str] = ()):
        self._missing = set(expected)
        self._granted: Dict[str, float] = {}
        self._lock = threading.Lock()

    def grant(self, member: str, step: float) -> None:
        """Let time go on to a step, for all that this member cares; joins it if it is new."""
        with self._lock:
            self._missing.discard(member)
            self._granted[member] = step

    def leave(self, member: str) -> None:
        """Take a member out: it holds time back no longer."""
        with self._lock:
            self._missing.discard(member)
            self._granted.pop(member, None)

    def has_joined(self, member: str) -> bool:
        """Return whether a member has granted anything yet, and has not left."""
        with self._lock:
            return member in self._granted

    def limit(self) -> Optional[float]:
        """Return the step that time may go to, or None while members are missing."""
        with self._lock:
            if self._missing:
                return None
            return min(self._granted.values(), default=FOR_EVER)

    def holding(self) -> Tuple[str, ...]:
        """Return who holds time back now: the missing ones, else those with the least grant."""
        with self._lock:
            if self._missing:
                return tuple(sorted(self._missing))
            least = min(self._granted.values(), default=FOR_EVER)
            if least == FOR_EVER:
                return ()
            return tuple(sorted(m for m, step in self._granted.items() if step == least))

    def restart(self) -> None:
        """Let all members grant anew from step 0, after time was set back."""
        with self._lock:
            for member, step in self._granted.items():
                self._granted[member] = 0 if step != FOR_EVER else FOR_EVER
