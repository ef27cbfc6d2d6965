"""Records and plots the distances that track_robot measures, over the true ones.

:ROS Parameters: see `PlotBeaconsParameters`.
:ROS Subscribers:
    - odom (nav_msgs/Odometry)
    - beacon_0/range … (sensor_msgs/Range)
    - /bullet_lab/world (visualization_msgs/MarkerArray): where the beacons really stand

Leaves distances.csv, written row by row, distances.png and summary.json.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, Mapping, Optional, Tuple

import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Range
from visualization_msgs.msg import MarkerArray

from bullet_lab.core.figures import save
from bullet_lab.core.files import FileError, write_json
from bullet_lab.reports.beacons import DistancesRecording, beacons_figure, distances_summary
from bullet_lab.ros.node import parameters
from bullet_lab.ros.node.node import NodeError, Refusals, private_parameters, run_node
from bullet_lab.ros.node.odometry import OdometryError, planar_pose
from bullet_lab.ros.record.recorder import EndOfRecording, Stopwatch, record

WORLD_TIMEOUT_SECONDS = 60.0


@dataclass(frozen=True)
class PlotBeaconsParameters:
    """Private parameters of plot_beacons."""

    out: str = parameters.text("results/beacons", "folder for the files")
    until: str = parameters.text("", "topic (std_msgs/Time) that ends it; empty: Ctrl-C does")
    about: Mapping[str, Any] = parameters.mapping("what else summary.json shall say")
    beacons: Tuple[str, ...] = parameters.name_list("models of the world that are beacons")
    plot_period: float = parameters.number(
        10.0, "wall seconds between two versions of distances.png", above=0.0
    )
    lock_step: bool = parameters.boolean(False, "tell the bridge when ready")


class PlotBeacons:
    """Brings together what was measured and what is true."""

    def __init__(self, wanted: PlotBeaconsParameters):
        self._wanted = wanted
        self._lock = threading.Lock()
        self._refusals = Refusals()
        self._stopwatch = Stopwatch()
        self._folder = Path(wanted.out)
        self._beacons = true_beacons(wanted.beacons or ("beacon_0", "beacon_1", "beacon_2"))
        self._recording = DistancesRecording(self._folder, self._beacons)
        self._failure: Optional[FileError] = None
        self._finished = False
        self.end = EndOfRecording(wanted.until)
        self._subscribers = [rospy.Subscriber("odom", Odometry, self._receive_odometry)]
        for name in self._beacons:
            self._subscribers.append(
                rospy.Subscriber(f"{name}/range", Range, self._receive_range, name)
            )

    def is_connected(self) -> bool:
        """Return whether every topic has a publisher."""
        return all(subscriber.get_num_connections() > 0 for subscriber in self._subscribers)

    def is_complete(self) -> bool:
        """Return whether the announced end has come.

        Raises:
            FileError: what came could not be written.
        """
        with self._lock:
            if self._failure is not None:
                raise self._failure
            newest = self._recording.newest
        return self.end.reached(newest)

    def plot_now(self) -> None:
        """Renew distances.png and summary.json with what there is."""
        self._write(finished=False)

    def finish(self, complete: bool) -> None:
        """Write everything for the last time."""
        for subscriber in self._subscribers:
            subscriber.unregister()
        with self._lock:
            # A message may be on its way in still.
            self._finished = True
            self._recording.finish(self.end.until if complete else None)
        self._write(finished=complete)
        rospy.loginfo("distances to %d beacons in %s", len(self._beacons), self._folder)

    def _receive_odometry(self, message: Odometry) -> None:
        try:
            pose = planar_pose(message)
        except OdometryError as error:
            self._refusals.refuse("odom", str(error))
            return
        self._stopwatch.note()
        stamp = message.header.stamp.to_nsec()
        self._record(lambda: self._recording.add_pose(stamp, pose))

    def _receive_range(self, message: Range, name: str) -> None:
        if not math.isfinite(message.range):
            self._refusals.refuse(f"{name}/range", f"a distance of {message.range}")
            return
        stamp = message.header.stamp.to_nsec()
        self._record(lambda: self._recording.add_distance(stamp, name, message.range))

    def _record(self, add: Callable[[], None]) -> None:
        with self._lock:
            if self._finished or self._failure is not None:
                return
            try:
                add()
            except FileError as error:
                self._failure = error

    def _write(self, finished: bool) -> None:
        with self._lock:
            table = self._recording.table()
            figures = distances_summary(self._recording)
        seconds = 0.0 if table is None else float(table[0].stamps[-1] - table[0].stamps[0])
        values = {
            **self._wanted.about,
            "finished": finished,
            **figures,
            **self._stopwatch.figures(seconds),
            "refused_messages": self._refusals.total,
        }
        write_json(self._folder / "summary.json", values)
        save(beacons_figure(self._beacons, table), self._folder / "distances.png")


def true_beacons(names: Tuple[str, ...]) -> Dict[str, Tuple[float, float]]:
    """Return where models of the world stand (m, m), from the bridge's markers.

    Raises:
        NodeError: no markers come, or a name is not among them.
    """
    try:
        world = rospy.wait_for_message("/bullet_lab/world", MarkerArray, WORLD_TIMEOUT_SECONDS)
    except rospy.ROSException as error:
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException("shutdown") from error
        raise NodeError("nobody publishes /bullet_lab/world: is the bridge running?") from error
    places = {m.ns: (m.pose.position.x, m.pose.position.y) for m in reversed(world.markers)}
    missing = [name for name in names if name not in places]
    if missing:
        raise NodeError(f"the world has no model '{missing[0]}', only {', '.join(sorted(places))}")
    return {name: places[name] for name in names}


def main() -> None:
    """Run the node."""

    def body() -> None:
        wanted = private_parameters(PlotBeaconsParameters)
        plotter = PlotBeacons(wanted)
        record(plotter, wanted.plot_period, wanted.lock_step, "odom and the distances")

    run_node("plot_beacons", body)
