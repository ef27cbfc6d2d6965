"""Driving by hand: what a pad's words say, how long they count, and which tab drives.

The server tells each pad the time, ten times a second; a word bears the newest time that its pad
has heard. So the age of a word is known without comparing clocks: it is at least the time that the
link takes both ways. Times are the server's, in s of its monotonic clock.
"""

from __future__ import annotations

import math
from typing import Any, Callable, Dict, Optional, Tuple

# Wall seconds between two times that are told.
PERIOD = 0.1
# Wall seconds that a word counts, from the time that it bears: a robot whose driver is silent, or
# on a link that takes longer, stands.
HOLD = 0.4
# Characters of a word; a longer one is no word.
LONGEST = 100

# Shares of the full speed, within [-1, 1]: forward, and turning left.
Shares = Tuple[float, float]
STILL: Shares = (0.0, 0.0)
TAKE_OVER = "take over"


def read_word(word: Any) -> Tuple[float, Shares]:
    """Return the time that a word bears, and its shares; -inf and none if it makes no sense.

    >>> read_word("12.5 0.5 -3")
    (12.5, (0.5, -1.0))
    >>> read_word("12.5 nan 0")
    (-inf, (0.0, 0.0))
    """
    if not isinstance(word, str) or len(word) > LONGEST:
        return -math.inf, STILL
    try:
        stamp, forward, left = map(float, word.split())
    except ValueError:
        return -math.inf, STILL
    if not all(map(math.isfinite, (stamp, forward, left))):
        return -math.inf, STILL
    return stamp, (max(-1.0, min(1.0, forward)), max(-1.0, min(1.0, left)))


class Wheel:
    """One tab drives: the first that wants to, until it is closed or another one takes over.

    Args:
        drive: called with a tab's name and its shares of the full speed.
    """

    def __init__(self, drive: Callable[[str, Shares], None]):
        self._drive = drive
        self._holder: Optional[str] = None
        self._is_moving = False

    def claim(self, tab: str) -> bool:
        """Let a tab drive if no other one does; return whether it does."""
        if self._holder is None:
            self._holder = tab
        return self._holder == tab

    def take_over(self, tab: str) -> None:
        """Let a tab drive; what another one drives is stopped."""
        if self._holder not in (None, tab):
            self.leave(self._holder)
        self._holder = tab

    def leave(self, tab: str) -> None:
        """Stop what a tab drives, and let anybody drive, if this is the tab that does."""
        if tab == self._holder:
            self.steer(tab, STILL)
            self._holder = None

    def steer(self, tab: str, shares: Shares) -> None:
        """Drive, if this tab is the one that does; who stands still is told so once."""
        if tab == self._holder and (self._is_moving or shares != STILL):
            self._is_moving = shares != STILL
            self._drive(tab, shares)

    def holder(self) -> Optional[str]:
        """Return the tab that drives; None while any may."""
        return self._holder


class Pad:
    """The pad of one tab, for as long as its socket is open."""

    def __init__(self, tab: str, wheel: Wheel):
        self._tab, self._wheel = tab, wheel
        self._ends: Optional[float] = None
        self._is_late = False

    def take(self, word: Any, now: float) -> None:
        """Do what a word asks for, or stop where it is late or makes no sense."""
        if word == TAKE_OVER:
            self._wheel.take_over(self._tab)
            return
        stamp, shares = read_word(word)
        self._is_late = not 0.0 <= now - stamp < HOLD
        if shares == STILL or self._is_late:
            self.stop()
        elif self._wheel.claim(self._tab):
            self._ends = stamp + HOLD
            self._wheel.steer(self._tab, shares)

    def patience(self, now: float) -> Optional[float]:
        """Return for how many seconds more the last word counts; None while it stands still."""
        return None if self._ends is None else max(0.0, self._ends - now)

    def stop(self) -> None:
        """Stop what this tab drives."""
        self._ends = None
        self._wheel.steer(self._tab, STILL)

    def state(self, now: float) -> Dict[str, Any]:
        """Return what the pad is told: the time, and whether another drives or the link is slow."""
        holder = self._wheel.holder()
        return {
            "time": now,
            "other": holder is not None and holder != self._tab,
            "late": self._is_late,
        }
