"""Lock step, the bridge's side: how far time may go, and the commands that it waits for.

The scheme is the conservative one of distributed simulation (Chandy and Misra 1979; "time
advance request" in the High Level Architecture): time never passes what each member has
granted, so no member ever sees a world that ran ahead of it, whatever the speed of the machine.

No rospy. All calls may come from any thread.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, Iterable, List, NamedTuple, Optional, Set, Tuple

FOR_EVER = math.inf

# Wall seconds that commands which are on their way are waited for, and those that come by a
# detour on which nothing has come yet.
PATIENCE, FIRST_PATIENCE = 2.0, 0.5
# Commands that a detour which has lost one must pass on, one after the other, before it is
# waited for again; twice as many after each further loss.
STREAK = 10
# Wall seconds after which nothing is on its way any more.
SETTLE_SECONDS = 0.05


class TimeGate:
    """Keeps what each member has granted.

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

    def restart(self, step: int = 0) -> None:
        """Take all grants back to a step, but for those for ever: members grant anew."""
        with self._lock:
            for member, granted in self._granted.items():
                self._granted[member] = min(step, granted) if granted != FOR_EVER else FOR_EVER


class Sent(NamedTuple):
    """How many messages a member has sent by one connection, to the node at its other end."""

    topic: str
    receiver: str
    messages: int


class Arrival(NamedTuple):
    """Where commands arrive: a topic of the bridge, and the node that sends them there."""

    topic: str
    sender: str


class CommandCounter:
    """Counts commands where they arrive, and waits for those that are on their way.

    Commands may come by a detour, such as a relay: as many have to arrive from it as were sent
    to it. One that loses commands, as a multiplexer does that has selected somebody else, is
    waited for no longer, until it passes them on again.

    Args:
        routes: returns, for (member, topic, receiver), where arrives what the member sends to
            that node; nothing if it does not arrive at the bridge.
    """

    def __init__(self, routes: Callable[[str, str, str], Set[Arrival]]):
        self._routes = routes
        self._changed = threading.Condition()
        self._arrived: Counter = Counter()
        self._connections: Dict[Arrival, Any] = {}
        self._ways: Dict[Tuple[str, str, str], _Way] = {}

    def note(self, arrival: Arrival, connection: Any = None) -> None:
        """Note that a command has arrived.

        Args:
            arrival: where.
            connection: stands for the connection; with a new one, counts begin anew.
        """
        with self._changed:
            if self._connections.get(arrival) is not connection:
                self._connections[arrival] = connection
                self._arrived[arrival] = 0
            self._arrived[arrival] += 1
            self._changed.notify_all()

    def heard(self, member: str, sent: Iterable[Sent]) -> Set[str]:
        """Return the topics of a member that reach the bridge, and count from now on.

        Called when the member joins, before it sends what counts.
        """
        found = [one for one in sent if self._routes(member, one.topic, one.receiver)]
        for one in found:
            self._ways.pop((member, one.topic, one.receiver), None)
            self._way(member, one)
        return {one.topic for one in found}

    def wait(self, member: str, sent: Iterable[Sent]) -> List[Sent]:
        """Wait until what a member has sent has arrived; return what has not come."""
        return [one for one in sent if not self._has_come(member, one)]

    def _has_come(self, member: str, one: Sent) -> bool:
        way = self._way(member, one)
        if way is None:
            return True
        new, way.sent = one.messages - way.sent, one.messages
        if not new:
            return True
        with self._changed:
            arrived = {arrival: self._arrived[arrival] for arrival in way.due}
            if way.is_watched_only(new, arrived):
                return True
            # More than was known to be on its way: what had been given up came after all.
            due = {a: new + max(way.due[a], arrived[a] - new) for a in arrived}
            come = self._changed.wait_for(
                lambda: all(self._arrived[a] >= count for a, count in due.items()), way.patience
            )
            way.judge(come, due if come else {a: self._arrived[a] for a in due})
        return come

    def _way(self, member: str, one: Sent) -> Optional[_Way]:
        """Return how the messages of a connection arrive; None if they do not."""
        key = (member, one.topic, one.receiver)
        arrivals = self._routes(*key)
        way = self._ways.get(key)
        if way is None or set(way.due) != arrivals or one.messages < way.sent:
            way = self._ways[key] = self._new_way(member, one, arrivals)
        return way if arrivals else None

    def _new_way(self, member: str, one: Sent, arrivals: Set[Arrival]) -> _Way:
        straight = arrivals == {Arrival(one.topic, member)}
        if arrivals and not straight:
            time.sleep(SETTLE_SECONDS)
        with self._changed:
            if not straight:
                return _Way(False, {a: self._arrived[a] for a in arrivals}, one.messages)
            # What an earlier node of this name has sent counts no longer.
            (arrival,) = arrivals
            self._arrived[arrival] = min(self._arrived[arrival], one.messages)
            return _Way(True, {arrival: 0}, 0)


@dataclass
class _Way:
    """How the messages of a member's connection arrive.

    Attributes:
        straight: whether without another node in between.
        due: how many must have arrived of those that were sent.
        sent: by the member so far.
        proven: whether any have arrived.
        streak: commands that were passed on, since one was lost.
        needed: streak before it is waited for again; 0 while it is waited for.
        losses: how often it was waited for in vain.
    """

    straight: bool
    due: Dict[Arrival, int]
    sent: int
    proven: bool = False
    streak: int = 0
    needed: int = 0
    losses: int = 0
    seen: Dict[Arrival, int] = field(default_factory=dict)

    @property
    def patience(self) -> float:
        """Wall seconds to wait for what was sent."""
        return PATIENCE if self.straight or self.proven else FIRST_PATIENCE

    def is_watched_only(self, new: int, arrived: Dict[Arrival, int]) -> bool:
        """Return whether it is not to be waited for, since it has lost commands."""
        if not self.needed:
            return False
        passed = all(count - self.seen.get(a, count) >= new for a, count in arrived.items())
        self.streak = self.streak + 1 if passed else 0
        self.seen = dict(arrived)
        if self.streak >= self.needed:
            self.needed, self.due = 0, dict(arrived)
        return True

    def judge(self, come: bool, due: Dict[Arrival, int]) -> None:
        """Note whether what was sent has come, and what is due by now."""
        self.due = due
        if come:
            self.proven = True
        elif not self.straight:
            self.losses += 1
            self.streak, self.needed = 0, STREAK * 2 ** (self.losses - 1)
            self.seen = dict(due)
