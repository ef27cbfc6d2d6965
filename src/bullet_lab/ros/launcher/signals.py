"""Signals that ask a run to stop."""

from __future__ import annotations

import signal

_WATCHED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopSignals:
    """Remembers the first signal that asks to stop, instead of being interrupted by it.

    What was started half is stopped the more surely for it.
    """

    def __init__(self):
        self.received: int | None = None

    def __enter__(self) -> StopSignals:
        """Take the signals over for good: the process ends soon after."""
        for number in _WATCHED:
            signal.signal(number, self._remember)
        return self

    def __exit__(self, *_) -> None:
        """Keep watching: a second Ctrl-C may not interrupt the last lines."""

    def _remember(self, number: int, _frame) -> None:
        if self.received is None:
            self.received = number
