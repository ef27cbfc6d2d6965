"""The nodes that record and plot a job; each runs one report.

Some also publish the recorded paths for RViz.

:ROS Parameters: see the dataclass of each.

Files of rows are written row by row. Figures and summary.json are written at the end, and by most
nodes also every ~plot_period.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping

import rospy
from nav_msgs.msg import Path as PathMessage
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.core.parameters import integer, text
from bullet_lab.noise.odometry_noise import derived_seed
from bullet_lab.reports import Report, save_all
from bullet_lab.reports.sensors import BeaconsReport, SensorsReport
from bullet_lab.reports.squares import FleetReport, SquaresReport
from bullet_lab.ros.gazebo.client import WORLD
from bullet_lab.ros.messages.poses import marker, stamped_pose
from bullet_lab.ros.node.lock_step import Publisher, join_when
from bullet_lab.ros.node.node import NodeError, check_running, holds_within, node
from bullet_lab.ros.nodes.drive_squares import MOST_ROBOTS, robot_names
from bullet_lab.ros.record.recorder import Recorder, RecordParameters, TimedParameters, reader_of

# Simulated seconds before the image of the detectors, and wall seconds to wait for their results.
SETTLE = 1.0
TIMEOUT = 90.0
# Number of images that the fastest detector may be ahead of the slowest.
MOST_AHEAD = 100
# Wall seconds for the markers of the world.
WORLD_TIMEOUT_SECONDS = 60.0
# The beacons of the report.
BEACONS = ("beacon_0", "beacon_1", "beacon_2")
# As in all figures: the perfect path is orange, the noisy one blue.
COLOURS = {"odom": ColorRGBA(0.90, 0.62, 0.0, 1.0), "noisy_odom": ColorRGBA(0.0, 0.45, 0.70, 1.0)}
# m above the floor.
HEIGHTS = {"odom": 0.01, "noisy_odom": 0.015}
# Sizes in m.
LINE_WIDTH = 0.02
LABEL_HEIGHT = 0.4
LABEL_SIZE = 0.25
WHITE = ColorRGBA(1.0, 1.0, 1.0, 1.0)


class PathTopics:
    """A latched nav_msgs/Path for each topic of odometry; `topics` has the names of both."""

    def __init__(self, topics: Mapping[str, str]):
        self._publishers = {
            topic: Publisher(path, PathMessage, queue_size=1, latch=True)
            for topic, path in topics.items()
        }

    def show(self, report: Report, frames: Mapping[str, str]) -> None:
        """Publish the recorded paths for subscribers; `frames` are those of the topics."""
        for topic, publisher in self._publishers.items():
            if topic in frames and publisher.has_connections():
                stamps, poses = report.series[topic].table()
                path = [
                    stamped_pose(rospy.Time.from_sec(stamp), frames[topic], pose)
                    for stamp, pose in zip(stamps.tolist(), poses.tolist())
                ]
                if path:
                    publisher.publish(PathMessage(path[-1].header, path))


class FleetMarkers:
    """The paths of any number of robots on one topic, fleet_paths."""

    def __init__(self):
        self._publisher = Publisher("fleet_paths", MarkerArray, queue_size=1, latch=True)

    def show(self, report: FleetReport, frames: Mapping[str, str]) -> None:
        """Publish the recorded paths for subscribers; `frames` are those of the topics."""
        if not self._publisher.has_connections():
            return
        markers = []
        for topic, frame in frames.items():
            robot, _, which = topic.rpartition("/")
            _, poses = report.robots[robot].series[which].table()
            points = [(x, y, 0.0) for x, y, _ in poses.tolist()]
            if not points:
                continue
            # Without a stamp, RViz uses the newest transform.
            header, colour = Header(frame_id=frame), COLOURS[which]
            size, place = (LINE_WIDTH, 0.0, 0.0), (0.0, 0.0, HEIGHTS[which])
            markers.append(marker(header, topic, Marker.LINE_STRIP, colour, size, place, points))
            if which == "odom":
                # The name of the robot is at the end of its perfect path.
                size, place = (0.0, 0.0, LABEL_SIZE), (*points[-1][:2], LABEL_HEIGHT)
                kind, name = Marker.TEXT_VIEW_FACING, f"{topic}/label"
                markers.append(marker(header, name, kind, WHITE, size, place))
                markers[-1].text = robot
        self._publisher.publish(MarkerArray(markers))


@dataclass(frozen=True)
class PlotNoiseParameters(TimedParameters):
    """Private parameters of plot_noise."""

    out: str = text("results/squares", "folder for the files")


@node
def plot_noise(parameters: PlotNoiseParameters) -> None:
    """Record and plot the perfect and the noisy odometry.

    :ROS Subscribers: odom, noisy_odom (nav_msgs/Odometry)
    :ROS Publishers: odom_path, noisy_odom_path (nav_msgs/Path), latched

    Writes odom.tum, noisy_odom.tum, paths.csv, paths.png and summary.json.
    """
    view = PathTopics({"odom": "odom_path", "noisy_odom": "noisy_odom_path"})
    report = SquaresReport(Path(parameters.out))
    Recorder(report, parameters, view).run()


@dataclass(frozen=True)
class PlotParameters(TimedParameters):
    """Private parameters of plot."""

    report: str = text("", "class of the report, such as bullet_lab.reports.shake:ShakeReport")


@node
def plot(parameters: PlotParameters) -> None:
    """Record and plot by any report that needs no parameters.

    :ROS Subscribers: the topics of the report

    Writes the files of the report and summary.json. Raises NodeError if there is no such report.
    """
    module, _, name = parameters.report.partition(":")
    try:
        report = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise NodeError(f"~report is '{parameters.report}': {error}") from error
    Recorder(report(Path(parameters.out)), parameters).run()


@dataclass(frozen=True)
class PlotFleetParameters(TimedParameters):
    """Private parameters of plot_fleet."""

    out: str = text("results/fleet", "folder for the files")
    robots: int = integer(8, "how many there are: robot1 and so on", 1, MOST_ROBOTS)
    seed: int = integer(0, "of noisy_odom, which derives one for each robot", minimum=0)


@node
def plot_fleet(parameters: PlotFleetParameters) -> None:
    """Record and plot the perfect and the noisy odometry of several robots.

    :ROS Subscribers, for each robot: <robot>/odom, <robot>/noisy_odom (nav_msgs/Odometry)
    :ROS Publishers: fleet_paths (visualization_msgs/MarkerArray), latched

    Writes the files of plot_noise in a folder for each robot, fleet.png and summary.json.
    """
    names = robot_names(parameters.robots)
    seeds = {name: derived_seed(parameters.seed, index) for index, name in enumerate(names)}
    report = FleetReport(Path(parameters.out), seeds)
    Recorder(report, parameters, FleetMarkers()).run()


@dataclass(frozen=True)
class PlotSensorsParameters(TimedParameters):
    """Private parameters of plot_sensors."""

    out: str = text("results/sensors", "folder for the files")
    rays: int = integer(360, "of the laser scanner", minimum=1, maximum=100_000)


@node
def plot_sensors(parameters: PlotSensorsParameters) -> None:
    """Record and plot the measurements of a robot's sensors.

    :ROS Subscribers:
        - odom (nav_msgs/Odometry)
        - scan (sensor_msgs/LaserScan), sonar (sensor_msgs/Range), imu (sensor_msgs/Imu)
        - bumper (gazebo_msgs/ContactsState)

    Writes odom.csv, scan.csv, range.csv, imu.csv, bumper.csv, sensors.png and summary.json.
    """
    report = SensorsReport(Path(parameters.out), parameters.rays)
    Recorder(report, parameters).run()


@dataclass(frozen=True)
class PlotBeaconsParameters(TimedParameters):
    """Private parameters of plot_beacons."""

    out: str = text("results/beacons", "folder for the files")


@node
def plot_beacons(parameters: PlotBeaconsParameters) -> None:
    """Record and plot the distances that track_robot measures, and the true ones.

    :ROS Subscribers:
        - odom (nav_msgs/Odometry)
        - beacon_0/range … (sensor_msgs/Range)
        - /bullet_lab/world (visualization_msgs/MarkerArray): the true places of the beacons

    Writes distances.csv, distances.png and summary.json.
    """
    report = BeaconsReport(Path(parameters.out), true_beacons(BEACONS))
    Recorder(report, parameters).run()


def true_beacons(names: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """Return the places (m, m) of models of the world, from the bridge's markers.

    Raises NodeError if no markers come, or the world has no model of a name.
    """
    try:
        world = rospy.wait_for_message(WORLD, MarkerArray, WORLD_TIMEOUT_SECONDS)
    except rospy.ROSException as error:
        raise NodeError(f"no message on {WORLD}; is the bridge running?") from error
    places = {m.ns: (m.pose.position.x, m.pose.position.y) for m in reversed(world.markers)}
    missing = [name for name in names if name not in places]
    if missing:
        raise NodeError(f"the world has no model '{missing[0]}', only {', '.join(sorted(places))}")
    return {name: places[name] for name in names}


@dataclass(frozen=True)
class PlotVisionParameters(RecordParameters):
    """Private parameters of plot_vision."""

    out: str = text("results/vision", "folder for the files")


@node
def plot_vision(parameters: PlotVisionParameters) -> None:
    """Save the results of the five detectors for one image, side by side as in figure 7.

    :ROS Subscribers:
        - view_camera/image_annotated, canny_edges/edges, good_features/image_annotated,
          harris_corners/image_annotated, aruco/image_annotated (sensor_msgs/Image)
        - good_features/points, harris_corners/points (bullet_lab/ImagePoints)
        - aruco/detections (bullet_lab/MarkerDetectionArray)

    Writes a picture of each detector, marker.png if one is found, side_by_side.png, summary.json.
    """
    # Imported late: other nodes here do not need OpenCV.
    from bullet_lab.reports.vision import VisionReport

    report = VisionReport(Path(parameters.out))
    report.about = parameters.about
    messages = first_image(report.topics, SETTLE, TIMEOUT)
    for topic, message in messages.items():
        _, read = reader_of(report.topics[topic])
        report.take(topic, read(message))
    summary = save_all(report, True)
    for name, line in report.found.items():
        rospy.loginfo("%s: %s", name, line)
    rospy.loginfo("%s", report.line(summary))


def first_image(topics: Mapping[str, str], settle: float, timeout: float) -> dict[str, Any]:
    """Return a message of each topic, all with the stamp of the first image that all answered.

    Images before `settle` simulated seconds are ignored. Raises NodeError after `timeout` wall
    seconds.
    """
    # Imported late: the first job, squares, runs before it is installed.
    import message_filters

    silent, found = set(topics), []

    def take(*messages: Any) -> None:
        if messages[0].header.stamp.to_sec() >= settle:
            found.append(dict(zip(topics, messages)))

    filters = [
        message_filters.Subscriber(topic, reader_of(kind)[0], tcp_nodelay=True)
        for topic, kind in topics.items()
    ]
    for topic, one in zip(topics, filters):
        one.registerCallback(lambda _, topic=topic: silent.discard(topic))
    message_filters.TimeSynchronizer(filters, MOST_AHEAD).registerCallback(take)
    subscribers = [one.sub for one in filters]
    join_when(lambda: all(one.get_num_connections() for one in subscribers), "the detectors")
    if not holds_within(lambda: found, timeout):
        check_running()
        what = ", ".join(topic for topic in topics if topic in silent) or "results of one image"
        raise NodeError(f"nothing on {what} within {timeout:g} s")
    for one in subscribers:
        one.unregister()
    return found[0]
