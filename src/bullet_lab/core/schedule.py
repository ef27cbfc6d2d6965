"""Schedules in whole physics steps."""

from __future__ import annotations

from fractions import Fraction

from bullet_lab.errors import LabError

STEPS_PER_SECOND = 1000
# Hz; one occurrence in thirty years.
SLOWEST = 1e-9


class ScheduleError(LabError):
    """A rate is not allowed."""


class Schedule:
    """Occurrences at a rate per simulated second that is exact on average.

    The k-th occurrence falls on the first step at or after k/rate seconds, so a rate that does
    not divide 1000 Hz jitters by less than one step and never drifts.

    Args:
        rate: occurrences per second, in [1e-9, 1000]; 0 means every step, as in Gazebo.
        start: step from which the periods are counted.

    Raises:
        ScheduleError: any other rate.
    """

    def __init__(self, rate: float, start: int = 0):
        if rate != 0.0 and not SLOWEST <= rate <= STEPS_PER_SECOND:
            allowed = f"{SLOWEST:g} … {STEPS_PER_SECOND} Hz"
            raise ScheduleError(f"a rate of {rate:g} Hz is not within {allowed}")
        # A ratio of integers, as sums of rounded periods would drift.
        period = STEPS_PER_SECOND / Fraction(rate or STEPS_PER_SECOND)
        self._numerator, self._denominator = period.numerator, period.denominator
        self.restart(start)

    @property
    def period(self) -> float:
        """Mean time between two occurrences, in s."""
        return self._numerator / self._denominator / STEPS_PER_SECOND

    def restart(self, start: int) -> None:
        """Count the periods from the given step on."""
        self._start = start
        self._count = 1
        self.next_step = self._due(1)

    def advance(self) -> None:
        """Go on to the next occurrence."""
        self._count += 1
        self.next_step = self._due(self._count)

    def _due(self, count: int) -> int:
        return self._start - (-count * self._numerator // self._denominator)


class WaitingSchedule(Schedule):
    """Occurrences that each wait for a whole period since the last one, in whole steps.

    So the mean rate may be lower than the asked one. Some of Gazebo's plugins wait until a period
    has passed (30 Hz become 29.4 Hz); with `beyond`, until more than a period has (20 Hz become
    19.6 Hz).
    """

    def __init__(self, rate: float, start: int = 0, beyond: bool = False):
        self._beyond = beyond and rate != 0.0
        super().__init__(rate, start)

    @property
    def period(self) -> float:  # noqa: D102
        return (self._due(1) - self._start) / STEPS_PER_SECOND

    def advance(self) -> None:  # noqa: D102
        self.restart(self.next_step)

    def _due(self, count: int) -> int:
        return super()._due(count) + (self._beyond and self._denominator == 1)
