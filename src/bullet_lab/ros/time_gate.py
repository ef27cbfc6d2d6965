"""How far simulated time may go while nodes keep it in step with their own work.

The scheme is the conservative one of distributed simulation (Chandy and Misra 1979; "time
advance request" in the High Level Architecture): time never passes what each member has
granted, so no member ever sees a world that ran ahead of it, whatever the speed of the machine.
"""

from __future__ import annotations

import math
import threading
from typing import Dict, Iterable, Optional, Tuple

FOR_EVER = math.inf


class TimeGate:
    """Keeps what each member has granted. All calls may come from any thread.

    Args:
        expected: names of members without whom time does not start.
    """

    def __init__(self, expected: Iterable[str] = ()):
        self._missing = set(expected)
        self._granted: Dict[str, float] = {}
        self._lock = threading.Lock()

    def grant(self, member: str, step: float) -> None:
        """Let time go on to a step, for all that this member cares; joins it if it is new."""
        with self._lock:
            self._missing.discard(member)
            self._granted[member] = step

    def leave(self, member: str) -> None:
        """Take a member out: it holds time back no longer."""
        with self._lock:
            self._missing.discard(member)
            self._granted.pop(member, None)

    def has_joined(self, member: str) -> bool:
        """Return whether a member has granted anything yet, and has not left."""
        with self._lock:
            return member in self._granted

    def limit(self) -> Optional[float]:
        """Return the step that time may go to, or None while members are missing."""
        with self._lock:
            if self._missing:
                return None
            return min(self._granted.values(), default=FOR_EVER)

    def holding(self) -> Tuple[str, ...]:
        """Return who holds time back now: the missing ones, else those with the least grant."""
        with self._lock:
            if self._missing:
                return tuple(sorted(self._missing))
            least = min(self._granted.values(), default=FOR_EVER)
            if least == FOR_EVER:
                return ()
            return tuple(sorted(m for m, step in self._granted.items() if step == least))

    def restart(self) -> None:
        """Let all members grant anew from step 0, after time was set back."""
        with self._lock:
            for member, step in self._granted.items():
                self._granted[member] = 0 if step != FOR_EVER else FOR_EVER
