"""How far time may go: by the wall clock, and by the lock step, with the commands it waits for.

The lock step is the conservative scheme of distributed simulation (Chandy and Misra 1979; "time
advance request" in the High Level Architecture): time never passes what each member has
granted, so no member ever sees a world that ran ahead of it, whatever the speed of the machine.

No rospy. `Pace` and `LoopWatch` belong to the loop of the stepper, whose other threads may only
ask whether it is stuck; all else may be called from any thread.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, Iterable, Iterator, List, NamedTuple, Optional, Set, Tuple

from bullet_lab.core.schedule import STEPS_PER_SECOND

FOR_EVER = math.inf
# Simulated time this far behind is not caught up with in a rush.
FORGIVEN_SECONDS = 0.1
# Wall seconds over which the speed is looked at, and at most between two reports of a machine
# that stays too slow: each comes after twice the time of the one before.
WINDOW, LONGEST_SILENCE = 5.0, 80.0
# Less than this share of the wanted speed is too slow.
TOLERATED = 0.9
# Causes with a smaller share of the time are not told.
WORTH_TELLING = 0.1
WAITING = "waiting"
"""What the loop is doing until the next step is due; no cause of anything."""
# Wall seconds that commands which are on their way are waited for, and those that come by a
# detour on which nothing has come yet.
PATIENCE, FIRST_PATIENCE = 2.0, 0.5
# Commands that a detour which has lost one must pass on, one after the other, before it is
# waited for again; twice as many after each further loss.
STREAK = 10
# Steps per wall second beyond which a speed is the same as any other: no machine gets there.
FASTEST = 1e12
# Wall seconds after which nothing is on its way any more.
SETTLE_SECONDS = 0.05


class Pace:
    """Says which step is due now; a real-time factor of 0 is for as fast as it goes."""

    def __init__(self, real_time_factor: float, clock: Callable[[], float] = time.monotonic):
        self.real_time_factor = real_time_factor
        self._clock = clock
        self.restart(0)

    @property
    def free(self) -> bool:
        """Whether time is not tied to the wall clock."""
        return self.real_time_factor == 0.0

    def restart(self, step: int) -> None:
        """Take the present moment for the time of a step: after a pause, a stall or a reset."""
        self._start_step, self._start = step, self._clock()

    def due(self, step: int) -> float:
        """Return the step that is due now, given that time stands at `step`.

        A simulation that cannot keep up is not chased: it goes on from where it is.
        """
        if self.free:
            return math.inf
        due = math.floor(self._start_step + self._rate * (self._clock() - self._start))
        # A whole step late is none too late, however slowly time goes.
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


class Lag(NamedTuple):
    """Simulated time was too slow.

    Attributes:
        wanted: simulated seconds per wall second; `reached` is what came of it.
        seconds: wall seconds over which that was measured.
        causes: what took how large a share of them, the largest first.
        waiting: share of them that was waited for the next step.
    """

    wanted: float
    reached: float
    seconds: float
    causes: Tuple[Tuple[str, float], ...]
    waiting: float = 0.0

    def __str__(self) -> str:
        line = (
            f"simulated time falls behind: real-time factor {self.reached:.2f} instead of "
            f"{self.wanted:g} in the last {self.seconds:.0f} s"
        )
        rest = 1.0 - self.waiting - sum(share for _, share in self.causes)
        others = [("other threads and programs", rest)] if rest >= WORTH_TELLING else []
        told = sorted([*self.causes, *others], key=lambda cause: -cause[1])
        causes = ", ".join(f"{what} {100.0 * share:.0f} %" for what, share in told)
        return f"{line} (of the time: {causes})" if causes else line


class LoopWatch:
    """Watches the loop that advances simulated time; `clock` gives monotonic seconds."""

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._spent: Counter = Counter()
        self._busy: Optional[Tuple[str, float]] = None
        self._told = clock()
        self._silence, self._lag_told = WINDOW, -math.inf
        self.restart(0)

    def restart(self, step: int) -> None:
        """Measure anew from now on, when time stands at a step: after a pause or a jump."""
        self._step, self._start = step, self._clock()
        self._spent.clear()

    @contextlib.contextmanager
    def doing(self, what: str) -> Iterator[None]:
        """Note what the loop is doing; within it, something else may be done."""
        outer, start = self._busy, self._clock()
        self._busy = (what, start)
        try:
            yield
        finally:
            now = self._clock()
            self.spend(what, now - start)
            if outer is not None:
                self.spend(outer[0], start - now)
            # What has come to an end is not stuck.
            self._busy = None if outer is None else (outer[0], now)

    def spend(self, what: str, seconds: float) -> None:
        """Note that wall seconds went to something."""
        self._spent[what] += seconds

    @property
    def due(self) -> bool:
        """Whether there is enough to tell the speed from."""
        return self._clock() - self._start >= WINDOW

    def look(self, step: int, wanted: float) -> Optional[Lag]:
        """Return how far time, now at a step, has fallen behind since it was looked at.

        None if it has not, or if that was told of a short while ago. `wanted` are simulated
        seconds per wall second; 0 for as fast as it goes.
        """
        seconds = self._clock() - self._start
        reached = (step - self._step) / STEPS_PER_SECOND / seconds
        waiting = self._spent.pop(WAITING, 0.0) / seconds
        shares = ((what, spent / seconds) for what, spent in self._spent.most_common())
        causes = tuple(cause for cause in shares if cause[1] >= WORTH_TELLING)
        self.restart(step)
        if reached >= TOLERATED * wanted:
            self._silence, self._lag_told = WINDOW, -math.inf
            return None
        if self._clock() - self._lag_told < self._silence:
            return None
        if self._lag_told > -math.inf:
            self._silence = min(2.0 * self._silence, LONGEST_SILENCE)
        self._lag_told = self._clock()
        return Lag(wanted, reached, seconds, causes, waiting)

    def stuck(self) -> Optional[Tuple[str, float]]:
        """Return what the loop has been doing for too long, and for how many wall seconds.

        None if it is not stuck, or if that was told less than `WINDOW` ago.
        """
        busy, now = self._busy, self._clock()
        if busy is None or now - busy[1] < WINDOW or now - self._told < WINDOW:
            return None
        self._told = now
        return busy[0], now - busy[1]


class TimeGate:
    """Keeps what each member has granted; without those in `expected`, time does not start."""

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
        return member in self._granted

    def limit(self) -> Optional[float]:
        """Return the step that time may go to, or None while members are missing."""
        with self._lock:
            return None if self._missing else min(self._granted.values(), default=FOR_EVER)

    def holding(self) -> Tuple[str, ...]:
        """Return who holds time back now: the missing ones, else those with the least grant."""
        with self._lock:
            least = min(self._granted.values(), default=FOR_EVER)
            late = {m for m, step in self._granted.items() if step == least != FOR_EVER}
            return tuple(sorted(self._missing or late))

    def restart(self, step: int = 0) -> None:
        """Take all grants back to a step, but for those for ever: members grant anew."""
        with self._lock:
            held = {m: min(step, its) for m, its in self._granted.items() if its != FOR_EVER}
            self._granted.update(held)


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
        changed: what it waits at for arrivals.
    """

    def __init__(
        self,
        routes: Callable[[str, str, str], Set[Arrival]],
        changed: Optional[threading.Condition] = None,
    ):
        self._routes = routes
        self._changed = changed or threading.Condition()
        self._arrived: Counter = Counter()
        self._connections: Dict[Arrival, Any] = {}
        self._ways: Dict[Tuple[str, str, str], _Way] = {}

    def note(self, arrival: Arrival, connection: Any = None) -> None:
        """Note that a command has arrived; with a new connection, counts begin anew."""
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
        return [one for one in sent if not self._has_come(self._way(member, one), one)]

    def _has_come(self, way: Optional[_Way], one: Sent) -> bool:
        if way is None or way.sent == one.messages:
            return True
        new, way.sent = one.messages - way.sent, one.messages
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
        seen: how many had arrived when it was looked at last.
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
