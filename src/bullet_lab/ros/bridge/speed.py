"""The speed of simulated time: how it follows the wall clock, and why it does not when it lags.

No rospy. The loop of the stepper says what it is doing; another thread may ask whether it is
stuck.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections import Counter
from dataclasses import dataclass
from typing import Callable, Iterator, Optional, Tuple

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


# Wall seconds over which the speed is looked at, and at most between two reports of a machine
# that stays too slow: each comes after twice the time of the one before.
WINDOW, LONGEST_SILENCE = 5.0, 80.0
# Less than this share of the wanted speed is too slow.
TOLERATED = 0.9
# Causes with a smaller share of the time are not told.
WORTH_TELLING = 0.1
WAITING = "waiting"
"""What the loop is doing until the next step is due; no cause of anything."""


@dataclass(frozen=True)
class Lag:
    """Simulated time was too slow.

    Attributes:
        wanted: simulated seconds per wall second.
        reached: what came of it.
        seconds: wall seconds over which that was measured.
        causes: what took how large a share of them, the largest first.
        waiting: share of them that was waited for the next step.
    """

    wanted: float
    reached: float
    seconds: float
    causes: Tuple[Tuple[str, float], ...]
    waiting: float = 0.0

    def __str__(self) -> str:
        line = (
            f"simulated time falls behind: real-time factor {self.reached:.2f} instead of "
            f"{self.wanted:g} in the last {self.seconds:.0f} s"
        )
        rest = 1.0 - self.waiting - sum(share for _, share in self.causes)
        others = [("other threads and programs", rest)] if rest >= WORTH_TELLING else []
        told = sorted([*self.causes, *others], key=lambda cause: -cause[1])
        causes = ", ".join(f"{what} {100.0 * share:.0f} %" for what, share in told)
        return f"{line} (of the time: {causes})" if causes else line


class LoopWatch:
    """Watches the loop that advances simulated time.

    Args:
        clock: monotonic seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._spent: Counter = Counter()
        self._busy: Optional[Tuple[str, float]] = None
        self._told = clock()
        self._silence, self._lag_told = WINDOW, -math.inf
        self.restart(0)

    def restart(self, step: int) -> None:
        """Measure anew from now on, when time stands at a step: after a pause or a jump."""
        self._step = step
        self._start = self._clock()
        self._spent.clear()

    @contextlib.contextmanager
    def doing(self, what: str) -> Iterator[None]:
        """Note what the loop is doing; within it, something else may be done."""
        outer, start = self._busy, self._clock()
        self._busy = (what, start)
        try:
            yield
        finally:
            now = self._clock()
            self.spend(what, now - start)
            if outer is not None:
                self.spend(outer[0], start - now)
            # What has come to an end is not stuck.
            self._busy = None if outer is None else (outer[0], now)

    def spend(self, what: str, seconds: float) -> None:
        """Note that wall seconds went to something."""
        self._spent[what] += seconds

    @property
    def due(self) -> bool:
        """Whether there is enough to tell the speed from."""
        return self._clock() - self._start >= WINDOW

    def look(self, step: int, wanted: float) -> Optional[Lag]:
        """Return how far time has fallen behind since it was looked at.

        None if it has not, or if that was told of a short while ago.

        Args:
            step: that time has reached.
            wanted: simulated seconds per wall second; 0 for as fast as it goes.
        """
        seconds = self._clock() - self._start
        reached = (step - self._step) / STEPS_PER_SECOND / seconds
        waiting = self._spent.pop(WAITING, 0.0) / seconds
        shares = ((what, spent / seconds) for what, spent in self._spent.most_common())
        causes = tuple(cause for cause in shares if cause[1] >= WORTH_TELLING)
        self.restart(step)
        if reached >= TOLERATED * wanted:
            self._silence, self._lag_told = WINDOW, -math.inf
            return None
        if self._clock() - self._lag_told < self._silence:
            return None
        if self._lag_told > -math.inf:
            self._silence = min(2.0 * self._silence, LONGEST_SILENCE)
        self._lag_told = self._clock()
        return Lag(wanted, reached, seconds, causes, waiting)

    def stuck(self) -> Optional[Tuple[str, float]]:
        """Return what the loop has been doing for too long, and for how many wall seconds.

        Returns:
            None if it is not stuck, or if that was told less than `WINDOW` ago.
        """
        busy, now = self._busy, self._clock()
        if busy is None or now - busy[1] < WINDOW or now - self._told < WINDOW:
            return None
        self._told = now
        return busy[0], now - busy[1]
