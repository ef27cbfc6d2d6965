"""Records what a robot's sensors measure, and plots it.

:ROS Parameters: see `PlotSensorsParameters`.
:ROS Subscribers:
    - odom (nav_msgs/Odometry)
    - scan (sensor_msgs/LaserScan), sonar (sensor_msgs/Range), imu (sensor_msgs/Imu)
    - bumper (gazebo_msgs/ContactsState)

Leaves odom.csv, scan.csv, range.csv, imu.csv and bumper.csv, written row by row, sensors.png and
summary.json.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, List, Mapping, Optional, Set

import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, LaserScan, Range

from bullet_lab.core.figures import save
from bullet_lab.core.files import FileError, write_json
from bullet_lab.errors import LabError
from bullet_lab.reports.sensors import Angles, SensorsRecording, sensors_figure, sensors_summary
from bullet_lab.ros.messages.gazebo_types import msg
from bullet_lab.ros.node import parameters
from bullet_lab.ros.node.node import Refusals, private_parameters, run_node
from bullet_lab.ros.node.odometry import planar_pose
from bullet_lab.ros.nodes.drive_squares import DriveSquaresParameters
from bullet_lab.ros.record.recorder import EndOfRecording, Stopwatch, record


@dataclass(frozen=True)
class PlotSensorsParameters:
    """Private parameters of plot_sensors."""

    out: str = parameters.text("results/sensors", "folder for the files")
    until: str = parameters.text("", "topic (std_msgs/Time) that ends it; empty: Ctrl-C does")
    about: Mapping[str, Any] = parameters.mapping(
        "what else summary.json shall say", DriveSquaresParameters
    )
    rays: int = parameters.integer(360, "of the laser scanner", minimum=1, maximum=100_000)
    plot_period: float = parameters.number(
        10.0, "wall seconds between two versions of sensors.png", above=0.0
    )
    lock_step: bool = parameters.boolean(False, "tell the bridge when ready")


class PlotSensors:
    """Records all sensors; see `bullet_lab.ros.record.recorder.Recorder`."""

    def __init__(self, wanted: PlotSensorsParameters):
        self._wanted = wanted
        self._folder = Path(wanted.out)
        self._lock = threading.Lock()
        self._refusals = Refusals()
        self._stopwatch = Stopwatch()
        self._recording = SensorsRecording(self._folder, wanted.rays)
        self._angles = Angles(0.0, 0.0)
        self._touched: Set[str] = set()
        self._failure: Optional[FileError] = None
        self._finished = False
        self._end = EndOfRecording(wanted.until)
        recording = self._recording
        self._subscribers: List[rospy.Subscriber] = []
        self._listen("odom", Odometry, lambda m: recording.odom.add(_stamp(m), planar_pose(m)))
        self._listen("scan", LaserScan, self._take_scan)
        self._listen("sonar", Range, lambda m: recording.range.add(_stamp(m), (m.range,)))
        self._listen("imu", Imu, lambda m: recording.imu.add(_stamp(m), _inertial(m)))
        self._listen("bumper", msg.ContactsState, self._take_contacts)

    def is_connected(self) -> bool:
        """Return whether every topic has a publisher."""
        return all(subscriber.get_num_connections() > 0 for subscriber in self._subscribers)

    def is_complete(self) -> bool:
        """Return whether the announced end has come; raises FileError if writing failed."""
        with self._lock:
            if self._failure is not None:
                raise self._failure
            newest = [series.last for series in self._recording.all().values()]
        return self._end.reached(None if None in newest else min(newest))

    def plot_now(self) -> None:
        """Renew sensors.png and summary.json with what there is."""
        self._write(finished=False)

    def finish(self, complete: bool) -> None:
        """Write everything for the last time."""
        for subscriber in self._subscribers:
            subscriber.unregister()
        with self._lock:
            # A message may be on its way in still.
            self._finished = True
            self._recording.finish(self._end.until if complete else None)
        self._write(finished=complete)
        rospy.loginfo("what the sensors measured is in %s", self._folder)

    def _listen(self, topic: str, kind: type, take: Callable[[Any], None]) -> None:
        def receive(message: Any) -> None:
            with self._lock:
                if self._finished or self._failure is not None:
                    return
                try:
                    take(message)
                except FileError as error:
                    self._failure = error
                except LabError as error:
                    self._refusals.refuse(topic, str(error))
                else:
                    self._stopwatch.note()

        self._subscribers.append(rospy.Subscriber(topic, kind, receive, tcp_nodelay=True))

    def _take_scan(self, message: LaserScan) -> None:
        self._recording.scan.add(_stamp(message), message.ranges)
        self._angles = Angles(message.angle_min, message.angle_increment)

    def _take_contacts(self, message: msg.ContactsState) -> None:
        points = sum(len(state.contact_positions) for state in message.states)
        forces = [state.total_wrench.force for state in message.states]
        sums = (sum(getattr(force, axis) for force in forces) for axis in "xyz")
        self._recording.bumper.add(_stamp(message), (points, *sums))
        self._touched.update(state.collision2_name.split("::")[0] for state in message.states)

    def _write(self, finished: bool) -> None:
        with self._lock:
            figures = sensors_summary(self._recording, self._touched)
            figure = sensors_figure(self._recording, self._angles, "What the sensors measured")
            stamps = self._recording.odom.table()[0]
        seconds = float(stamps[-1] - stamps[0]) if len(stamps) else 0.0
        values = {
            **self._wanted.about,
            "finished": finished,
            **figures,
            **self._stopwatch.figures(seconds),
            "refused_messages": self._refusals.total,
        }
        write_json(self._folder / "summary.json", values)
        save(figure, self._folder / "sensors.png")


def _stamp(message: Any) -> int:
    return message.header.stamp.to_nsec()


def _inertial(message: Imu) -> tuple:
    force, rate = message.linear_acceleration, message.angular_velocity
    return (force.x, force.y, force.z, rate.x, rate.y, rate.z)


def main() -> None:
    """Run the node."""

    def body() -> None:
        wanted = private_parameters(PlotSensorsParameters)
        record(PlotSensors(wanted), wanted.plot_period, wanted.lock_step, "the sensors")

    run_node("plot_sensors", body)
