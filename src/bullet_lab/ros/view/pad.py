"""Driving by hand: the pad's commands, how long they are valid, and which tab drives.

The server sends each pad its time, ten times a second. A command carries the newest time that its
pad has received. So the age of a command is known without comparing clocks: it is at least the
round-trip time of the link. Times are the server's, in s of its monotonic clock.
"""

from __future__ import annotations

import math
from typing import Any, Callable, Tuple

# Wall seconds between two times that the server sends.
PERIOD = 0.1
# Wall seconds for which a command is valid, from the time that it carries. The robot stops when
# the pad is silent for longer, or the round trip takes longer.
HOLD = 0.4
# Longer commands are invalid.
MAX_CHARACTERS = 100

# Shares of the full speed, within [-1, 1]: forward, and turning left.
Shares = Tuple[float, float]
STILL: Shares = (0.0, 0.0)
TAKE_OVER = "take over"


def read_command(text: Any) -> tuple[float, Shares]:
    """Return the time that a command carries, and its shares; -inf and STILL if it is invalid.

    >>> read_command("12.5 0.5 -3")
    (12.5, (0.5, -1.0))
    >>> read_command("12.5 nan 0")
    (-inf, (0.0, 0.0))
    """
    invalid = (-math.inf, STILL)
    if not isinstance(text, str) or len(text) > MAX_CHARACTERS:
        return invalid
    try:
        stamp, forward, left = map(float, text.split())
    except ValueError:
        return invalid
    if not all(map(math.isfinite, (stamp, forward, left))):
        return invalid
    return stamp, (max(-1.0, min(1.0, forward)), max(-1.0, min(1.0, left)))


class DriverSeat:
    """Lets one tab drive: the first that asks, until it is closed or another one takes over.

    Args:
        drive: called with a tab's name and its shares of the full speed.

    Attributes:
        holder: the tab that drives; None while any tab may.
    """

    def __init__(self, drive: Callable[[str, Shares], None]):
        self._drive = drive
        self.holder: str | None = None
        self._is_moving = False

    def claim(self, tab: str) -> bool:
        """Let a tab drive if no other one does; return whether it drives."""
        if self.holder is None:
            self.holder = tab
        return self.holder == tab

    def take_over(self, tab: str) -> None:
        """Let a tab drive; if another one drives, its robot is stopped."""
        if self.holder not in (None, tab):
            self.leave(self.holder)
        self.holder = tab

    def leave(self, tab: str) -> None:
        """If this tab drives, stop its robot and let any tab drive."""
        if tab == self.holder:
            self.steer(tab, STILL)
            self.holder = None

    def steer(self, tab: str, shares: Shares) -> None:
        """Drive if this tab is the one that drives; a stop is passed on once."""
        if tab == self.holder and (self._is_moving or shares != STILL):
            self._is_moving = shares != STILL
            self._drive(tab, shares)


class Pad:
    """The pad of one tab, while its socket is open."""

    def __init__(self, tab: str, wheel: DriverSeat):
        self._tab = tab
        self._wheel = wheel
        self._ends: float | None = None
        self._is_late = False

    def take(self, text: Any, now: float) -> None:
        """Follow a command; stop if it is late or invalid."""
        if text == TAKE_OVER:
            self._wheel.take_over(self._tab)
            return
        stamp, shares = read_command(text)
        self._is_late = not 0.0 <= now - stamp < HOLD
        if shares == STILL or self._is_late:
            self.stop()
        elif self._wheel.claim(self._tab):
            self._ends = stamp + HOLD
            self._wheel.steer(self._tab, shares)

    def patience(self, now: float) -> float | None:
        """Return for how many seconds more the last command is valid; None at a standstill."""
        return None if self._ends is None else max(0.0, self._ends - now)

    def stop(self) -> None:
        """Stop the robot, if this tab drives it."""
        self._ends = None
        self._wheel.steer(self._tab, STILL)

    def state(self, now: float) -> dict[str, Any]:
        """Return the message to the pad: the time, whether another tab drives, or the link is slow.

        The pad sends the time back with its commands.
        """
        return {
            "time": now,
            "other": self._wheel.holder not in (None, self._tab),
            "late": self._is_late,
        }
