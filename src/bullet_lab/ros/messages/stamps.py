"""Simulated time, counted in steps, as ROS time and back."""

from __future__ import annotations

import genpy

from bullet_lab.core.schedule import STEPS_PER_SECOND

NANOSECONDS_PER_STEP = 1_000_000_000 // STEPS_PER_SECOND


def set_time(stamp: genpy.Time, step: int) -> None:
    """Set a stamp to the simulated time of a step."""
    stamp.secs, rest = divmod(step, STEPS_PER_SECOND)
    stamp.nsecs = rest * NANOSECONDS_PER_STEP


def time_of(step: int) -> genpy.Time:
    """Return the simulated time of a step."""
    stamp = genpy.Time()
    set_time(stamp, step)
    return stamp


def first_step_at(stamp: genpy.Time) -> int:
    """Return the first step at or after a simulated time."""
    return stamp.secs * STEPS_PER_SECOND - (-stamp.nsecs // NANOSECONDS_PER_STEP)
