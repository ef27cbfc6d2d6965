"""How far simulated time may advance: by the wall clock, and by the lock step.

The lock step is the conservative scheme of distributed simulation (Chandy and Misra 1979; "time
advance request" in the High Level Architecture): time never exceeds what each member has
granted, so no member ever sees a world that ran ahead of it, whatever the speed of the machine.

No rospy. `Pace` and `SpeedWatch` are for the thread of the stepper's loop; `TimeGate` is
thread-safe.
"""

from __future__ import annotations

import math
import threading
import time
from typing import Callable, Iterable

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


class SpeedWatch:
    """Measures the speed of simulated time over `WINDOW`, and reports one that is too slow."""

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._silence, self._reported = WINDOW, -math.inf
        self.restart(0)

    def restart(self, step: int) -> None:
        """Start a new measurement, with simulated time at a step: after a pause or a reset."""
        self._step, self._start = step, self._clock()

    def lag(self, step: int, wanted: float) -> str:
        """Return a line if simulated time, now at a step, is too slow.

        Empty if it is not, if that was reported a short while ago, or before the measurement ends.
        `wanted` is the real-time factor; 0 for full speed.
        """
        now = self._clock()
        seconds = now - self._start
        if seconds < WINDOW:
            return ""
        reached = (step - self._step) / STEPS_PER_SECOND / seconds
        self.restart(step)
        if reached >= TOLERATED * wanted:
            self._silence, self._reported = WINDOW, -math.inf
            return ""
        if now - self._reported < self._silence:
            return ""
        if self._reported > -math.inf:
            self._silence = min(2.0 * self._silence, LONGEST_SILENCE)
        self._reported = now
        return (
            f"simulated time falls behind: real-time factor {reached:.2f} instead of {wanted:g} "
            f"in the last {seconds:.0f} s"
        )


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
