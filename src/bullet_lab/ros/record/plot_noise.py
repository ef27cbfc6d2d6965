"""Records and plots the perfect and the noisy odometry.

:ROS Parameters: see `PlotNoiseParameters`.
:ROS Subscribers: odom, noisy_odom (nav_msgs/Odometry)
:ROS Publishers: odom_path, noisy_odom_path (nav_msgs/Path), latched

Leaves odom.tum, noisy_odom.tum and paths.csv, written row by row, and paths.png and
summary.json, which are renewed while it runs.
"""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any, Dict, List, Mapping, Optional, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path

from bullet_lab.core.ellipse import ellipse_points
from bullet_lab.core.figures import save
from bullet_lab.core.files import write_json
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.reports.squares import noise_figure, squares_summary
from bullet_lab.ros.node import parameters
from bullet_lab.ros.node.node import Refusals, private_parameters, run_node
from bullet_lab.ros.node.publishers import Publisher
from bullet_lab.ros.nodes.drive_squares import DriveSquaresParameters
from bullet_lab.ros.nodes.noisy_odom import NoisyOdomParameters
from bullet_lab.ros.record.odometry_recorder import NOISY, PERFECT, OdometryRecorder
from bullet_lab.ros.record.recorder import EndOfRecording, Stopwatch, record

PATHS_PERIOD_SECONDS = 0.5
# How many ellipses are drawn along the noisy path.
ELLIPSES = 12


@dataclass(frozen=True)
class PlotNoiseParameters:
    """Private parameters of plot_noise."""

    out: str = parameters.text("results/squares", "folder for the files")
    until: str = parameters.text("", "topic (std_msgs/Time) that ends it; empty: Ctrl-C does")
    about: Mapping[str, Any] = parameters.mapping(
        "what else summary.json shall say", NoisyOdomParameters, DriveSquaresParameters
    )
    show: bool = parameters.boolean(False, "open a window at the end, where there is a screen")
    plot_period: float = parameters.number(
        10.0, "wall seconds between two versions of paths.png", above=0.0
    )
    lock_step: bool = parameters.boolean(False, "tell the bridge when ready")


class PlotNoise:
    """Pairs the two odometries by stamp and leaves their paths as files."""

    def __init__(self, wanted: PlotNoiseParameters):
        self._wanted = wanted
        self._lock = threading.Lock()
        self._folder = FilePath(wanted.out)
        self._stopwatch = Stopwatch()
        self._refusals = Refusals()
        self._recorder = OdometryRecorder(self._folder, self._refusals, self._forget)
        self._finished = False
        self._covariances: Dict[int, Tuple[Tuple[float, float], Tuple[float, float]]] = {}
        self.end = EndOfRecording(wanted.until)
        self._paths = {PERFECT: _PathTopic("odom_path"), NOISY: _PathTopic("noisy_odom_path")}
        self.sub_noisy = rospy.Subscriber("noisy_odom", Odometry, self.odom_callback_noisy)
        self.sub_perfect = rospy.Subscriber("odom", Odometry, self.odom_callback_perfect)

    def odom_callback_noisy(self, msg: Odometry) -> None:
        """Take a message of the noisy odometry."""
        self.extract_data(msg, None)

    def odom_callback_perfect(self, msg: Odometry) -> None:
        """Take a message of the perfect odometry."""
        self.extract_data(None, msg)

    def extract_data(self, msg: Optional[Odometry], msg2: Optional[Odometry]) -> None:
        """Record a noisy message, a perfect one, or both."""
        with self._lock:
            if self._finished:
                return
            if msg2 is not None:
                self._record(PERFECT, msg2)
            if msg is not None and self._record(NOISY, msg):
                entries = msg.pose.covariance
                covariance = ((entries[0], entries[1]), (entries[6], entries[7]))
                self._covariances[msg.header.stamp.to_nsec()] = covariance

    def is_complete(self) -> bool:
        """Return whether both odometries have come to the announced end.

        Raises:
            FileError: what came could not be written.
        """
        with self._lock:
            last = self._recorder.last()
        return self.end.reached(last)

    def is_connected(self) -> bool:
        """Return whether both odometries have a publisher."""
        subscribers = (self.sub_noisy, self.sub_perfect)
        return all(subscriber.get_num_connections() > 0 for subscriber in subscribers)

    def plot_now(self) -> None:
        """Renew paths.png and summary.json with what there is."""
        with self._lock:
            perfect, pairs = self._recorder.paths.perfect(), self._recorder.paths.pairs()
        self.plot_noise(pairs, perfect)
        self._write_summary(perfect, pairs, finished=False)

    def plot_noise(
        self,
        noisy_data: Optional[Tuple[Trajectory, Trajectory]],
        perfect_data: Optional[Trajectory],
    ) -> None:
        """Draw both paths, and ellipses along the noisy one, into paths.png."""
        ellipses = [] if noisy_data is None else self._ellipses(noisy_data[1])
        figure = noise_figure(perfect_data, noisy_data, self._title(), ellipses)
        save(figure, self._folder / "paths.png")

    def _ellipses(self, noisy: Trajectory) -> List[np.ndarray]:
        """Return the 95 % ellipses of the noisy odometry, evenly spaced along its path."""
        travelled = noisy.travelled()
        wanted = np.linspace(0.0, travelled[-1], ELLIPSES + 1)[1:]
        chosen = np.unique(np.searchsorted(travelled, wanted).clip(max=len(noisy) - 1))
        with self._lock:
            covariances = [self._covariances.get(round(noisy.stamps[i] * 1e9)) for i in chosen]
        return [
            noisy.poses[i, :2] + ellipse_points(covariance)
            for i, covariance in zip(chosen, covariances)
            if covariance is not None
        ]

    def finish(self, complete: bool) -> None:
        """Write everything for the last time."""
        self.sub_noisy.unregister()
        self.sub_perfect.unregister()
        with self._lock:
            # A message may be on its way in still.
            self._finished = True
            self._recorder.paths.finish(self.end.until if complete else None)
            perfect, pairs = self._recorder.paths.perfect(), self._recorder.paths.pairs()
        self._write_summary(perfect, pairs, finished=complete)
        self.plot_noise(pairs, perfect)
        rospy.loginfo("%s", describe(squares_summary(perfect, pairs)))

    def show(self) -> None:
        """Show paths.png in a window and wait until it is closed."""
        if not os.environ.get("DISPLAY"):
            rospy.logwarn("~show: there is no screen (DISPLAY is not set); see paths.png")
            return
        try:
            from matplotlib import pyplot

            picture = pyplot.imread(str(self._folder / "paths.png"))
            pyplot.figure("bullet_lab", figsize=(11.0, 6.6))
            pyplot.axes([0.0, 0.0, 1.0, 1.0]).imshow(picture)
            pyplot.axis("off")
            pyplot.show()
        except ImportError as error:
            rospy.logwarn("~show: matplotlib has no window toolkit here: %s", error)

    def _record(self, topic: str, msg: Odometry) -> bool:
        recorded = self._recorder.record(topic, msg)
        if recorded:
            self._stopwatch.note()
            self._paths[topic].append(msg)
        return recorded

    def _forget(self) -> None:
        """Begin a new run; what was before is in a folder of its own."""
        self._stopwatch = Stopwatch()
        self._covariances.clear()
        for path in self._paths.values():
            path.clear()

    def _write_summary(
        self,
        perfect: Optional[Trajectory],
        pairs: Optional[Tuple[Trajectory, Trajectory]],
        finished: bool,
    ) -> None:
        seconds = 0.0 if perfect is None else float(perfect.stamps[-1] - perfect.stamps[0])
        values = {
            **self._wanted.about,
            "finished": finished,
            **squares_summary(perfect, pairs),
            **self._stopwatch.figures(seconds),
            "refused_messages": self._refusals.total,
        }
        write_json(self._folder / "summary.json", values)

    def _title(self) -> str:
        said = self._wanted.about
        parts = [f"{key} = {said[key]}" for key in ("std", "model", "mode", "seed") if key in said]
        if said.get("as_published"):
            parts.append("as published")
        return "Noise generated by /noisy_odom" + (f"\n{', '.join(parts)}" if parts else "")


def describe(summary: Mapping[str, Any]) -> str:
    """Return the main figures of a squares summary as one line for people."""
    sides = " ".join(f"{side:.3f}" for side in summary["side_lengths_m"])
    turns = " ".join(f"{turn:.2f}" for turn in summary["turns_deg"])
    parts = [f"sides {sides} m"] if sides else ["no sides"]
    if turns:
        parts.append(f"turns {turns} deg")
    if summary["final_error_m"] is not None:
        parts.append(
            f"noisy path ends {summary['final_error_m']:.3f} m and "
            f"{summary['final_heading_error_deg']:.1f} deg off"
        )
        parts.append(f"APE {summary['ape_rmse_m']:.3f} m rms, {summary['ape_max_m']:.3f} m at most")
    return "; ".join(parts)


class _PathTopic:
    """A latched path for RViz, published twice a second at most and only if somebody looks."""

    def __init__(self, topic: str):
        self._path = Path()
        self._publisher = Publisher(topic, Path, queue_size=1, latch=True)
        self._timer = threading.Thread(target=self._publish, daemon=True)
        self._timer.start()

    def append(self, msg: Odometry) -> None:
        """Add where a message says that the robot is."""
        self._path.header = msg.header
        self._path.poses.append(PoseStamped(msg.header, msg.pose.pose))

    def clear(self) -> None:
        """Start a new path."""
        self._path.poses = []

    def _publish(self) -> None:
        published = 0
        while not rospy.is_shutdown():
            rospy.rostime.wallsleep(PATHS_PERIOD_SECONDS)
            poses = list(self._path.poses)
            if len(poses) != published and self._publisher.get_num_connections() > 0:
                published = len(poses)
                self._publisher.publish(Path(self._path.header, poses))


def main() -> None:
    """Run the node."""

    def body() -> None:
        wanted = private_parameters(PlotNoiseParameters)
        plotter = PlotNoise(wanted)
        record(plotter, wanted.plot_period, wanted.lock_step, "odom and noisy_odom")
        if wanted.show:
            plotter.show()

    run_node("plot_noise", body)
