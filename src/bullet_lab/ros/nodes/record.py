"""Records all topics in a bag (rosbag) and in an MCAP file, in simulated time.

The time of a message is its stamp, or, without one, that of the last message on /clock. The time of
arrival means little where a simulated second takes 10 ms.

:ROS Parameters: see `RecordParameters`.
:ROS Subscribers: all topics, whatever their type, as soon as they have a publisher.

In lock step, simulated time waits until the node has subscribed to what there is.
"""

from __future__ import annotations

import struct
import threading
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import rosbag
import rospy
from mcap.writer import Writer
from roslib.message import get_message_class

from bullet_lab.core.files import file_errors, make_folder
from bullet_lab.core.parameters import text
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.ros.node.lock_step import Rate, publishers_know_this_node
from bullet_lab.ros.node.node import holds_within, ignore_clock, node

# Per simulated second: how often it looks for new topics.
RATE = 10.0
QUEUE = 10_000
# Wall seconds to wait for the publishers of new topics, some of which may have died.
PATIENCE = 10.0
CLOCK = "/clock"
# What rospy's logs of all nodes add; the log files have the same lines.
LEFT_OUT = ("/rosout_agg",)


@dataclass(frozen=True)
class RecordParameters:
    """Private parameters of record."""

    out: str = text("results", "folder for record.bag and record.mcap")


def stamp_of(message: rospy.AnyMsg) -> rospy.Time:
    """Return the stamp of a message; 0 if it has none."""
    kind = get_message_class(message._connection_header["type"])
    if kind is None or not kind._has_header:
        return rospy.Time(0)
    # After the number of the message, as http://wiki.ros.org/std_msgs defines a Header.
    return rospy.Time(*struct.unpack_from("<II", message._buff, 4))


class BothBags:
    """A bag and an MCAP file with the same messages; for one thread at a time.

    Raises FileError if a file cannot be written.
    """

    def __init__(self, folder: Path):
        path = str(make_folder(folder) / "record.bag")
        with file_errors(f"cannot write in {folder}"):
            self._bag = rosbag.Bag(path, "w", compression=rosbag.Compression.LZ4)
            self._file = (folder / "record.mcap").open("wb")
        self._mcap = Writer(self._file)
        self._mcap.start("ros1", "bullet_lab")
        # MCAP's numbers of the channels, by topic and type.
        self._channels: dict[tuple[str, str], int] = {}

    def write(self, topic: str, message: rospy.AnyMsg, when: rospy.Time) -> None:
        """Append a message; its connection header has type and definition."""
        header, data = message._connection_header, message._buff
        raw = (header["type"], data, header["md5sum"], None, None)
        # rosbag takes the wall time for a time of zero.
        when = when or rospy.Time(0, 1)
        self._bag.write(topic, raw, when, raw=True, connection_header={**header, "topic": topic})
        self._mcap.add_message(self._channel(topic, header), when.to_nsec(), data, when.to_nsec())

    def close(self) -> None:
        """Complete both files."""
        self._bag.close()
        self._mcap.finish()
        self._file.close()

    def _channel(self, topic: str, header: dict[str, str]) -> int:
        key = (topic, header["type"])
        if key not in self._channels:
            definition = header["message_definition"].encode()
            schema = self._mcap.register_schema(header["type"], "ros1msg", definition)
            about = {"md5sum": header["md5sum"], "latching": header.get("latching", "0")}
            self._channels[key] = self._mcap.register_channel(topic, "ros1", schema, about)
        return self._channels[key]


class Record:
    """Subscribes to every topic and records its messages."""

    def __init__(self, parameters: RecordParameters):
        # rospy subscribes to /clock with a queue of one message, which holds for all of a node.
        ignore_clock()
        self._bags = BothBags(Path(parameters.out))
        self._lock = threading.Lock()
        self._open = True
        self._subscribers: dict[str, rospy.Subscriber] = {}

    def run(self) -> None:
        """Record until ROS shuts down."""
        try:
            # One step is over when all members of the lock step have joined, after they have
            # advertised their topics.
            Rate(STEPS_PER_SECOND).sleep()
            rate = Rate(RATE)
            while True:
                if self._subscribe() and not holds_within(self._is_connected, PATIENCE):
                    rospy.logwarn("some topics have a publisher that does not connect")
                rate.sleep()
        finally:
            with self._lock:
                self._open = False
                self._bags.close()

    def _subscribe(self) -> bool:
        """Subscribe to the topics that are new; return whether there were any."""
        topics = {topic for topic, _ in rospy.get_published_topics()}
        new = topics.difference(self._subscribers, LEFT_OUT)
        for topic in sorted(new):
            self._subscribers[topic] = rospy.Subscriber(
                topic,
                rospy.AnyMsg,
                partial(self._take, topic),
                queue_size=QUEUE,
                tcp_nodelay=True,
            )
        return bool(new)

    def _is_connected(self) -> bool:
        subscribers = self._subscribers.values()
        return all(one.get_num_connections() for one in subscribers) and publishers_know_this_node()

    def _take(self, topic: str, message: rospy.AnyMsg) -> None:
        with self._lock:
            if topic == CLOCK:
                rospy.rostime._set_rostime(rospy.Time(*struct.unpack("<II", message._buff)))
            if self._open:
                self._bags.write(topic, message, stamp_of(message) or rospy.get_rostime())


@node
def record(parameters: RecordParameters) -> None:
    """Run until ROS shuts down."""
    Record(parameters).run()
