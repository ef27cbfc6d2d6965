import math

import pytest
from shared import cases

from bullet_lab.core.schedule import Schedule, ScheduleError, WaitingSchedule


def steps(rate, until, start=0):
    schedule, due = Schedule(rate, start), []
    while schedule.next_step <= until:
        due.append(schedule.next_step)
        schedule.advance()
    return due


@cases("rate: [30.0, 7.0, 1000.0, 0.5]")
def test_the_mean_rate_is_exact_and_the_jitter_below_a_step(rate):
    due = steps(rate, 60_000)
    assert len(due) == math.floor(60 * rate)
    for count, step in enumerate(due, start=1):
        assert 0 <= step - count * 1000 / rate < 1 + 1e-9


def test_periods_count_from_the_start_and_after_a_restart():
    # A rate of 0 means every step.
    assert steps(0.0, 5) == [1, 2, 3, 4, 5]
    assert steps(100.0, 130, start=105) == [115, 125]
    schedule = Schedule(100.0)
    schedule.advance()
    schedule.restart(7)
    assert schedule.next_step == 17


@cases("rate: [-1.0, 1000.5, .nan, .inf, 1.0e-320]")
def test_other_rates_are_refused(rate):
    with pytest.raises(ScheduleError, match="Hz is not within 1e-09 … 1000 Hz"):
        Schedule(rate)


# As the comparisons in Gazebo's sources have it, for `elapsed >= 1 / rate` and for `>`.
@cases("""
rate, beyond, gap:
  - [20.0, false, 50]
  - [30.0, false, 34]
  - [0.0, false, 1]
  - [20.0, true, 51]
  - [30.0, true, 34]
  - [1000.0, true, 2]
  - [0.0, true, 1]
""")
def test_waiting_for_a_period_since_the_last_occurrence(rate, beyond, gap):
    schedule = WaitingSchedule(rate, 7, beyond)
    for count in range(1, 9):
        assert schedule.next_step == 7 + count * gap
        schedule.advance()
    assert schedule.period == gap / 1000
