"""How far simulated time may advance: by the wall clock, and by the lock step.

The lock step is the conservative scheme of distributed simulation (Chandy and Misra 1979; "time
advance request" in the High Level Architecture): time never exceeds what each member has
granted, so no member ever sees a world that ran ahead of it, whatever the speed of the machine.

No rospy. `Pace` and `LoopWatch` are for the thread of the stepper's loop; `TimeGate` is
thread-safe.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import Counter
from typing import Callable, Iterable, Iterator, NamedTuple

from bullet_lab.core.schedule import STEPS_PER_SECOND

FOR_EVER = math.inf
# The grant of a member that has not joined yet.
NOT_YET = -math.inf
# A longer delay of simulated time, in wall seconds, is not made up for.
FORGIVEN_SECONDS = 0.1
# Wall seconds over which the speed is measured.
WINDOW = 5.0
# Longest wall time between two reports of a machine that stays too slow; the time doubles.
LONGEST_SILENCE = 80.0
# A smaller share of the wanted speed is too slow.
TOLERATED = 0.9
# Causes with a smaller share of the time are not reported.
SMALLEST_CAUSE = 0.1
WAITING = "waiting"
"""The activity of the loop until the next step is due; never reported as a cause."""
OTHERS = "other threads and programs"
# Steps per wall second; no machine is faster.
FASTEST = 1e12


class Pace:
    """Computes which step is due now; a real-time factor of 0 means full speed."""

    def __init__(self, real_time_factor: float, clock: Callable[[], float] = time.monotonic):
        self.real_time_factor = real_time_factor
        self._clock = clock
        self.restart(0)

    @property
    def free(self) -> bool:
        """Whether time is not tied to the wall clock."""
        return self.real_time_factor == 0.0

    def restart(self, step: int) -> None:
        """Let a step be due now: after a pause, a stall or a reset."""
        self._start_step, self._start = step, self._clock()

    def due(self, step: int) -> float:
        """Return the step that is due now, given that simulated time is at `step`.

        A simulation that cannot keep up continues from `step` without making up for the delay.
        """
        if self.free:
            return math.inf
        due = math.floor(self._start_step + self._rate * (self._clock() - self._start))
        # At a very slow speed, a delay of one step is longer than FORGIVEN_SECONDS.
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
        return min(self.real_time_factor * STEPS_PER_SECOND, FASTEST)


class Lag(NamedTuple):
    """A report that simulated time was too slow.

    Attributes:
        wanted: simulated seconds per wall second.
        reached: likewise, as measured.
        seconds: wall seconds of the measurement.
        causes: activities with their shares of the wall time, the largest first.
    """

    wanted: float
    reached: float
    seconds: float
    causes: tuple[tuple[str, float], ...]

    def __str__(self) -> str:
        shares = ", ".join(f"{what} {100.0 * share:.0f} %" for what, share in self.causes)
        return (
            f"simulated time falls behind: real-time factor {self.reached:.2f} instead of "
            f"{self.wanted:g} in the last {self.seconds:.0f} s"
            + (f" (of the time: {shares})" if shares else "")
        )


class LoopWatch:
    """Measures the speed of the loop that advances simulated time, and what slows it down."""

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._spent: Counter = Counter()
        # What the loop does now, and since when.
        self._busy: tuple[str, float] | None = None
        self._stuck_reported = clock()
        self._silence, self._lag_reported = WINDOW, -math.inf
        self.restart(0)

    def restart(self, step: int) -> None:
        """Start a new measurement, with simulated time at a step: after a pause or a reset."""
        self._step, self._start = step, self._clock()
        self._spent.clear()

    @contextlib.contextmanager
    def doing(self, what: str) -> Iterator[None]:
        """Measure the wall time of an activity; activities may be nested."""
        outer, start = self._busy, self._clock()
        self._busy = (what, start)
        try:
            yield
        finally:
            now = self._clock()
            self.spend(what, now - start)
            if outer is not None:
                self.spend(outer[0], start - now)
            # The outer activity goes on from now: the loop is not stuck in it.
            self._busy = outer and (outer[0], now)

    def spend(self, what: str, seconds: float) -> None:
        """Add wall seconds to an activity."""
        self._spent[what] += seconds

    @property
    def due(self) -> bool:
        """Whether the measurement is long enough."""
        return self._clock() - self._start >= WINDOW

    def measure(self, step: int, wanted: float) -> Lag | None:
        """End the measurement at a step; return a report if simulated time was too slow.

        None if it was not, or if that was reported a short while ago. `wanted` is the real-time
        factor; 0 for full speed.
        """
        now = self._clock()
        seconds = now - self._start
        lag = Lag(
            wanted, (step - self._step) / STEPS_PER_SECOND / seconds, seconds, self._causes(seconds)
        )
        self.restart(step)
        if lag.reached >= TOLERATED * wanted:
            self._silence, self._lag_reported = WINDOW, -math.inf
            return None
        if now - self._lag_reported < self._silence:
            return None
        if self._lag_reported > -math.inf:
            self._silence = min(2.0 * self._silence, LONGEST_SILENCE)
        self._lag_reported = now
        return lag

    def stuck(self) -> tuple[str, float] | None:
        """Return the activity in which the loop is stuck, and for how many wall seconds.

        None if it is not stuck, or if that was reported less than `WINDOW` ago.
        """
        busy, now = self._busy, self._clock()
        if busy is None or now - busy[1] < WINDOW or now - self._stuck_reported < WINDOW:
            return None
        self._stuck_reported = now
        return busy[0], now - busy[1]

    def _causes(self, seconds: float) -> tuple[tuple[str, float], ...]:
        """Return the activities that took a large share of the time, with their shares."""
        waiting = self._spent.pop(WAITING, 0.0) / seconds
        shares = {what: spent / seconds for what, spent in self._spent.most_common()}
        causes = Counter({what: s for what, s in shares.items() if s >= SMALLEST_CAUSE})
        # Rounded, as Python 3.12 sums floats otherwise.
        rest = round(1.0 - waiting - sum(causes.values()), 9)
        if rest >= SMALLEST_CAUSE:
            causes[OTHERS] = rest
        return tuple(causes.most_common())


class TimeGate:
    """Keeps the grants of the lock step's members; time starts when all `expected` have joined."""

    def __init__(self, expected: Iterable[str] = ()):
        self._granted: dict[str, float] = dict.fromkeys(expected, NOT_YET)
        self._lock = threading.Lock()

    def grant(self, member: str, step: float) -> None:
        """Set the step up to which a member lets time advance; a new member joins."""
        with self._lock:
            self._granted[member] = step

    def leave(self, member: str) -> None:
        """Remove a member."""
        with self._lock:
            self._granted.pop(member, None)

    def has_joined(self, member: str) -> bool:
        """Return whether a member has joined and has not left."""
        return self._granted.get(member, NOT_YET) != NOT_YET

    def limit(self) -> float:
        """Return the step up to which time may advance; NOT_YET while members are missing."""
        with self._lock:
            return min(self._granted.values(), default=FOR_EVER)

    def holding(self) -> tuple[str, ...]:
        """Return the members that hold time back: the missing ones, or those of the least grant."""
        with self._lock:
            least = min(self._granted.values(), default=FOR_EVER)
            late = (member for member, step in self._granted.items() if step == least != FOR_EVER)
            return tuple(sorted(late))

    def restart(self, step: int = 0) -> None:
        """Reduce all grants to a step, except for those without an end."""
        with self._lock:
            for member, granted in self._granted.items():
                if granted != FOR_EVER:
                    self._granted[member] = min(step, granted)
