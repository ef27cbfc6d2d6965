"""Counts the commands that arrive at the bridge, and waits for those that are still under way.

Time in lock step advances when all commands that a member has sent have arrived, also those that
come through other nodes, such as relays.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from dataclasses import dataclass
from typing import Any, Callable, Dict, Iterable, List, Mapping, NamedTuple, Optional, Set, Tuple

import rosgraph
import rospy

from bullet_lab.ros.node.node import MASTER_ERRORS

# Wall seconds to wait for commands: of a direct connection or of a relay that has passed some on,
# and of a relay that has passed on none yet.
PATIENCE = 2.0
FIRST_PATIENCE = 0.5
# Commands that a relay which has lost one must pass on in a row before it is waited for again;
# twice as many after each further loss.
STREAK = 10
# Wall seconds after which a relay has passed on what was sent to it before.
SETTLE_SECONDS = 0.05
# Wall seconds between two searches for a route that did not exist.
SEARCH_SECONDS = 1.0


class Sent(NamedTuple):
    """The number of messages that a member has sent over one connection."""

    topic: str
    receiver: str
    messages: int


class Arrival(NamedTuple):
    """The connection over which commands arrive: a topic of the bridge and the sending node."""

    topic: str
    sender: str


# Returns the arrivals of what a member sends (its name, the topic, the receiving node).
FindArrivals = Callable[[str, str, str], Set[Arrival]]


@dataclass
class _Connection:
    """The state of a member's connection whose messages arrive at the bridge.

    Attributes:
        is_direct: whether no other node is in between.
        due: the number of messages that must arrive, by arrival.
        sent: messages that the member has sent so far.
        is_proven: whether messages have arrived when they were due.
        losses: how often messages did not arrive in time.
        untrusted: commands that have to be passed on in a row before it is waited for again; 0
            if it is waited for.
    """

    is_direct: bool
    due: Dict[Arrival, int]
    sent: int
    is_proven: bool = False
    losses: int = 0
    untrusted: int = 0


class CommandCounter:
    """Counts commands where they arrive, and waits for those that are under way.

    Through a relay, as many commands have to arrive from it as were sent to it. A relay that
    loses commands, such as a multiplexer that has selected another topic, is not waited for until
    it passes commands on again.

    Args:
        find_arrivals: returns where messages of a member arrive; empty if they do not.
        changed: condition that is notified of arrivals.
    """

    def __init__(self, find_arrivals: FindArrivals, changed: Optional[threading.Condition] = None):
        self._find_arrivals = find_arrivals
        self._changed = changed or threading.Condition()
        self._arrived: Counter = Counter()
        self._headers: Dict[Arrival, Any] = {}
        self._connections: Dict[Tuple[str, str, str], _Connection] = {}

    def note(self, arrival: Arrival, header: Any = None) -> None:
        """Count a command; the count restarts with the header of a new connection."""
        with self._changed:
            if self._headers.get(arrival) is not header:
                self._headers[arrival] = header
                self._arrived[arrival] = 0
            self._arrived[arrival] += 1
            self._changed.notify_all()

    def heard(self, member: str, sent: Iterable[Sent]) -> Set[str]:
        """Return the topics of a member that reach the bridge, and restart their counts.

        Called when the member joins, before it sends commands.
        """
        topics = set()
        for one in sent:
            self._connections.pop((member, one.topic, one.receiver), None)
            if self._connection(member, one) is not None:
                topics.add(one.topic)
        return topics

    def wait(self, member: str, sent: Iterable[Sent]) -> List[Sent]:
        """Wait until the messages of a member have arrived; return those that have not."""
        return [one for one in sent if not self._wait_for(member, one)]

    def _wait_for(self, member: str, one: Sent) -> bool:
        """Return whether the messages have arrived, or are not waited for."""
        connection = self._connection(member, one)
        if connection is None or connection.sent == one.messages:
            return True
        new = one.messages - connection.sent
        connection.sent = one.messages
        with self._changed:
            if connection.untrusted:
                self._observe(connection, new)
                return True
            for arrival, count in connection.due.items():
                # More have arrived than were due if some were late.
                connection.due[arrival] = max(count + new, self._arrived[arrival])
            patient = connection.is_direct or connection.is_proven
            in_time = self._changed.wait_for(
                lambda: self._has_arrived(connection.due), PATIENCE if patient else FIRST_PATIENCE
            )
            if in_time:
                connection.is_proven = True
            else:
                self._note_loss(connection)
            return in_time

    def _has_arrived(self, due: Mapping[Arrival, int]) -> bool:
        return all(self._arrived[arrival] >= count for arrival, count in due.items())

    def _note_loss(self, connection: _Connection) -> None:
        """Give up the messages that are due, and stop waiting for a relay."""
        connection.due = self._counts(connection.due)
        if not connection.is_direct:
            connection.losses += 1
            connection.untrusted = STREAK * 2 ** (connection.losses - 1)

    def _observe(self, connection: _Connection, new: int) -> None:
        """Count the commands that an untrusted relay passes on in a row."""
        due = {arrival: count + new for arrival, count in connection.due.items()}
        if self._has_arrived(due):
            connection.untrusted -= 1
        else:
            connection.untrusted = STREAK * 2 ** (connection.losses - 1)
        connection.due = self._counts(due)

    def _counts(self, arrivals: Iterable[Arrival]) -> Dict[Arrival, int]:
        return {arrival: self._arrived[arrival] for arrival in arrivals}

    def _connection(self, member: str, one: Sent) -> Optional[_Connection]:
        """Return the state of a connection; None if its messages do not reach the bridge."""
        key = (member, one.topic, one.receiver)
        arrivals = self._find_arrivals(*key)
        if not arrivals:
            self._connections.pop(key, None)
            return None
        known = self._connections.get(key)
        if known is None or set(known.due) != arrivals or one.messages < known.sent:
            known = self._connections[key] = self._new_connection(member, one, arrivals)
        return known

    def _new_connection(self, member: str, one: Sent, arrivals: Set[Arrival]) -> _Connection:
        direct = Arrival(one.topic, member)
        if arrivals == {direct}:
            with self._changed:
                # Messages of an earlier node of the same name do not count.
                self._arrived[direct] = min(self._arrived[direct], one.messages)
            return _Connection(True, {direct: 0}, 0)
        time.sleep(SETTLE_SECONDS)
        with self._changed:
            return _Connection(False, self._counts(arrivals), one.messages)


class RouteFinder:
    """Finds where messages arrive at the bridge that a node sends to another one.

    Besides direct connections, these are routes through nodes that publish the type of message
    that they receive: relays, multiplexers, limiters.

    Args:
        subscribers: of commands, by topic.
    """

    def __init__(self, subscribers: Mapping[str, rospy.Subscriber]):
        self._subscribers = subscribers
        self._lock = threading.Lock()
        # Arrivals and the time of the search, by member, topic and receiver.
        self._found: Dict[Tuple[str, str, str], Tuple[Set[Arrival], float]] = {}
        self._inbound: Set[Arrival] = set()

    def find(self, member: str, topic: str, receiver: str) -> Set[Arrival]:
        """Return where messages arrive that a member sends to another node on a topic."""
        if receiver == rospy.get_name():
            return {Arrival(topic, member)} if topic in self._subscribers else set()
        inbound = self._connected()
        key = (member, topic, receiver)
        with self._lock:
            if inbound != self._inbound:
                self._found.clear()
                self._inbound = inbound
            found, searched = self._found.get(key, (None, 0.0))
            if found is None or (not found and time.monotonic() - searched > SEARCH_SECONDS):
                found = self._search(*key) & inbound
                self._found[key] = (found, time.monotonic())
            return found

    def _connected(self) -> Set[Arrival]:
        """Return the topics of commands with the nodes that are connected to them."""
        return {
            Arrival(topic, connection.callerid_pub)
            for topic, subscriber in list(self._subscribers.items())
            if subscriber.impl is not None
            for connection in subscriber.impl.connections
        }

    def _search(self, member: str, topic: str, receiver: str) -> Set[Arrival]:
        """Return the topics that the receiver, and nodes behind it, publish with that type."""
        master = rosgraph.Master(rospy.get_name())
        try:
            published, subscribed, _ = master.getSystemState()
            types = dict(master.getTopicTypes())
        except MASTER_ERRORS:
            return set()
        listeners = dict(subscribed)
        found: Set[Arrival] = set()
        visited = {member, rospy.get_name()}
        nodes = [receiver]
        while nodes:
            node = nodes.pop()
            if node in visited:
                continue
            visited.add(node)
            for onward, senders in published:
                if node in senders and onward != topic and types.get(onward) == types.get(topic):
                    found.add(Arrival(onward, node))
                    nodes.extend(listeners.get(onward, ()))
        return found
