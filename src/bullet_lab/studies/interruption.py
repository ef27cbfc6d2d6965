"""Ctrl-C, once: what is cleared away after it shall not be interrupted in its turn."""

from __future__ import annotations

import signal
from typing import Any


def interrupt_once() -> None:
    """Have the first SIGINT or SIGTERM raise KeyboardInterrupt, and ignore those that follow.

    Whoever stops a job may send both, one right after the other.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)


def _interrupt(_number: int, _frame: Any) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt
