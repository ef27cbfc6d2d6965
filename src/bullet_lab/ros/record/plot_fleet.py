"""Records and plots the perfect and the noisy odometry of several robots.

:ROS Parameters: see `PlotFleetParameters`.
:ROS Subscribers, for each robot: <robot>/odom, <robot>/noisy_odom (nav_msgs/Odometry)
:ROS Publishers: fleet_paths (visualization_msgs/MarkerArray), latched

Leaves odom.tum, noisy_odom.tum and paths.csv in a folder for each robot, written row by row,
and fleet.png and summary.json, which are renewed while it runs.
"""

from __future__ import annotations

import contextlib
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import rospy
from nav_msgs.msg import Odometry

from bullet_lab.core.figures import save
from bullet_lab.core.files import write_json
from bullet_lab.core.seeds import derived_seed
from bullet_lab.reports.fleet import RobotPaths, fleet_figure, fleet_summary
from bullet_lab.reports.squares import squares_summary
from bullet_lab.ros.node import parameters
from bullet_lab.ros.node.node import Refusals, private_parameters, run_node
from bullet_lab.ros.nodes.fleet import MOST_ROBOTS, robot_names
from bullet_lab.ros.nodes.noisy_odom import NoisyOdomParameters
from bullet_lab.ros.record.fleet_markers import FleetMarkers
from bullet_lab.ros.record.odometry_recorder import NOISY, PERFECT, OdometryRecorder
from bullet_lab.ros.record.recorder import EndOfRecording, Stopwatch, record


@dataclass(frozen=True)
class PlotFleetParameters:
    """Private parameters of plot_fleet."""

    out: str = parameters.text("results/fleet", "folder for the files")
    robots: int = parameters.integer(8, "how many there are: robot1 and so on", 1, MOST_ROBOTS)
    until: str = parameters.text("", "topic (std_msgs/Time) that ends it; empty: Ctrl-C does")
    seed: int = parameters.integer(0, "of noisy_odom, which derives one for each robot", minimum=0)
    about: Mapping[str, Any] = parameters.mapping(
        "what else summary.json shall say", NoisyOdomParameters
    )
    plot_period: float = parameters.number(
        10.0, "wall seconds between two versions of fleet.png", above=0.0
    )
    lock_step: bool = parameters.boolean(False, "tell the bridge when ready")


class _Robot:
    """Takes what one robot sends."""

    def __init__(self, name: str, seed: int, plotter: PlotFleet, folder: Path):
        self.name = name
        self.seed = seed
        self._plotter = plotter
        self.recorder = OdometryRecorder(
            folder / name, plotter.refusals, lambda: plotter.markers.forget(name)
        )
        self._subscribers = [
            rospy.Subscriber(f"{name}/{topic}", Odometry, self._receive, topic)
            for topic in (NOISY, PERFECT)
        ]

    def is_connected(self) -> bool:
        """Return whether both odometries have a publisher."""
        return all(subscriber.get_num_connections() > 0 for subscriber in self._subscribers)

    def close(self) -> None:
        """Listen no longer."""
        for subscriber in self._subscribers:
            subscriber.unregister()

    def paths(self) -> Tuple[Any, Any]:
        """Return the perfect path, and both at common stamps; None where there are none."""
        return self.recorder.paths.perfect(), self.recorder.paths.pairs()

    def _receive(self, msg: Odometry, topic: str) -> None:
        self._plotter.receive(self, topic, msg)


class PlotFleet:
    """Leaves the paths of all robots as files and one picture."""

    def __init__(self, wanted: PlotFleetParameters):
        self._wanted = wanted
        self._lock = threading.Lock()
        self._folder = Path(wanted.out)
        self._stopwatch = Stopwatch()
        self._finished = False
        self.refusals = Refusals()
        self.markers = FleetMarkers()
        self.end = EndOfRecording(wanted.until)
        clear_away(self._folder, robot_names(wanted.robots))
        self._robots = [
            _Robot(name, derived_seed(wanted.seed, index), self, self._folder)
            for index, name in enumerate(robot_names(wanted.robots))
        ]

    def receive(self, robot: _Robot, topic: str, msg: Odometry) -> None:
        """Record a message."""
        with self._lock:
            if self._finished:
                return
            if robot.recorder.record(topic, msg, f"{robot.name}/{topic}"):
                self._stopwatch.note()
                self.markers.append(robot.name, topic, msg)

    def is_complete(self) -> bool:
        """Return whether all odometries have come to the announced end.

        Raises:
            FileError: what came could not be written.
        """
        with self._lock:
            stamps = [robot.recorder.last() for robot in self._robots]
        return self.end.reached(None if None in stamps else min(stamps))

    def is_connected(self) -> bool:
        """Return whether all odometries have a publisher."""
        return all(robot.is_connected() for robot in self._robots)

    def plot_now(self) -> None:
        """Renew fleet.png and summary.json with what there is."""
        with self._lock:
            paths = {robot.name: robot.paths() for robot in self._robots}
        self._draw(paths)
        self._write_summary(paths, finished=False)

    def finish(self, complete: bool) -> None:
        """Write everything for the last time."""
        for robot in self._robots:
            robot.close()
        with self._lock:
            # A message may be on its way in still.
            self._finished = True
            for robot in self._robots:
                robot.recorder.paths.finish(self.end.until if complete else None)
            paths = {robot.name: robot.paths() for robot in self._robots}
        summary = self._write_summary(paths, finished=complete)
        self._draw(paths)
        rospy.loginfo("%s", describe(summary))

    def _draw(self, paths: Mapping[str, Tuple[Any, Any]]) -> None:
        robots = [
            RobotPaths(name, perfect, None if pairs is None else pairs[1])
            for name, (perfect, pairs) in paths.items()
        ]
        save(fleet_figure(robots, self._title()), self._folder / "fleet.png")

    def _write_summary(
        self, paths: Mapping[str, Tuple[Any, Any]], finished: bool
    ) -> Dict[str, Any]:
        robots: List[Dict[str, Any]] = [
            {"name": robot.name, "seed": robot.seed, **squares_summary(*paths[robot.name])}
            for robot in self._robots
        ]
        lengths = [
            float(perfect.stamps[-1] - perfect.stamps[0])
            for perfect, _ in paths.values()
            if perfect is not None
        ]
        values = {
            **self._wanted.about,
            "finished": finished,
            **self._stopwatch.figures(max(lengths, default=0.0)),
            "refused_messages": self.refusals.total,
            **fleet_summary(robots),
        }
        write_json(self._folder / "summary.json", values)
        return values

    def _title(self) -> str:
        said = self._wanted.about
        parts = [f"{key} = {said[key]}" for key in ("std", "model", "mode", "seed") if key in said]
        title = f"{self._wanted.robots} robots with noisy odometry"
        return title + (f"\n{', '.join(parts)}" if parts else "")


def describe(summary: Mapping[str, Any]) -> str:
    """Return the main figures of a fleet's summary as one line for people."""
    robots = summary["robots"]
    squares = sum(len(robot["side_lengths_m"]) for robot in robots)
    parts = [f"{len(robots)} robots, {squares} sides"]
    if summary["final_error_m_rms"] is not None:
        parts.append(
            f"noisy paths end {summary['final_error_m_rms']:.3f} m rms off, "
            f"{summary['final_error_m_largest']:.3f} m at most"
        )
    factor: Optional[float] = summary["real_time_factor"]
    if factor is not None:
        parts.append(f"{factor:.1f} times real time")
    return "; ".join(parts)


def clear_away(folder: Path, names: Sequence[str]) -> None:
    """Remove what an earlier, larger fleet has left in a folder, and nothing else."""
    for old in folder.glob("robot*"):
        if old.name in names or not old.name[len("robot") :].isdigit():
            continue
        for path in (f"{PERFECT}.tum", f"{NOISY}.tum", "paths.csv"):
            with contextlib.suppress(FileNotFoundError):
                (old / path).unlink()
        # Somebody may keep files of their own there.
        with contextlib.suppress(OSError):
            old.rmdir()


def main() -> None:
    """Run the node."""

    def body() -> None:
        wanted = private_parameters(PlotFleetParameters)
        record(PlotFleet(wanted), wanted.plot_period, wanted.lock_step, "the robots' odometry")

    run_node("plot_fleet", body)
