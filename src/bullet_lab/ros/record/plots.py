"""The nodes that record and plot a job; each runs one report.

Some also publish the recorded paths for RViz.

:ROS Parameters: see the dataclass of each.

Files of rows are written row by row. Figures and summary.json are written at the end, and by most
nodes also every ~plot_period.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Mapping

import rospy
from actionlib import ActionClient, ClientGoalHandle, CommState
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path as PathMessage
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.core.parameters import boolean, integer, number, number_list, text
from bullet_lab.docking.database import Dock, drawn_error, find_dock, read_docks
from bullet_lab.msg import DockAction, DockGoal
from bullet_lab.navigation.occupancy import RobotCostmap, read_map
from bullet_lab.noise.odometry_noise import derived_seed
from bullet_lab.reports import Report, save_all
from bullet_lab.reports.dock import DockReport, Station
from bullet_lab.reports.goal import Beacon, GoalReport, MapDriveReport
from bullet_lab.reports.sensors import BeaconsReport, SensorsReport
from bullet_lab.reports.squares import FleetReport, SquaresReport
from bullet_lab.reports.vision import VisionReport
from bullet_lab.ros.gazebo.client import WORLD, StandingModels, numbered
from bullet_lab.ros.messages.poses import marker, stamped_pose
from bullet_lab.ros.node.lock_step import Publisher, join_when
from bullet_lab.ros.node.node import NodeError, check_running, holds_within, node
from bullet_lab.ros.node.odometry import own_frame
from bullet_lab.ros.nodes.dock import docking_result
from bullet_lab.ros.nodes.drive_squares import MOST_ROBOTS, robot_names
from bullet_lab.ros.record.recorder import (
    GoalRequest,
    Recorder,
    RecordParameters,
    RenewedParameters,
    TimedParameters,
    reader_of,
)
from bullet_lab.simulation.world.description import footprints
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.sdf import read_world_file

# Simulated seconds before the image of the detectors, and wall seconds to wait for their results.
SETTLE = 1.0
TIMEOUT = 90.0
# Number of images that the fastest detector may be ahead of the slowest.
MOST_AHEAD = 100
# Wall seconds for the markers of the world.
WORLD_TIMEOUT_SECONDS = 60.0
# The beacons of the report.
BEACONS = ("beacon_0", "beacon_1", "beacon_2")
# m; the plan of the station has only objects that the robot can touch.
ROBOT_HEIGHT = 0.55
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
class PlotGoalParameters(RenewedParameters):
    """Private parameters of plot_goal."""

    out: str = text("results/goal", "folder for the files")
    goal: tuple[float, ...] = number_list((1.0, 1.0, 0.0), "where to: x y in m, yaw in rad")
    frame: str = text("world", "frame of the goal")
    tolerance: float = number(0.05, "m, for the picture", above=0.0)
    stay: bool = boolean(False, "wait for more goals, such as RViz's, until Ctrl-C")
    goals: int = integer(0, "of send_goals, which sends them all on a map", minimum=0)
    map: str = text("", "YAML file of the map")
    radius: float = number(0.25, "m, of the robot on the map", above=0.0)


@node
def plot_goal(parameters: PlotGoalParameters) -> None:
    """Send a robot to a goal, and record and plot its drive.

    :ROS Publishers: move_base_simple/goal (geometry_msgs/PoseStamped): the first goal
    :ROS Subscribers:
        - odom (nav_msgs/Odometry): the true pose, as the simulation sends it
        - drive_to_goal/current_goal, status, finished: the goals of all senders
        - /bullet_lab/world (visualization_msgs/MarkerArray): the beacons
        - with ~goals: send_goals/boxes, send_goals/finished, bullet_lab/touched; the first
          goal is not sent then

    Writes truth.tum, path.png and summary.json.
    """
    out, tolerance, costmap = Path(parameters.out), parameters.tolerance, None
    if parameters.map or parameters.goals:
        costmap = RobotCostmap(read_map(Path(parameters.map)), parameters.radius)
    if parameters.goals:
        report = MapDriveReport(out, tolerance, parameters.goals, costmap)
        Recorder(report, parameters).run()
        return
    standing = StandingModels()

    def beacons() -> list[Beacon]:
        names = numbered(standing.names(), "beacon")
        return [(name, *standing.origin(name)[:2]) for name in names]

    report = GoalReport(out, tolerance, parameters.stay, beacons, costmap)
    rospy.Subscriber(WORLD, MarkerArray, standing.take)
    first = Publisher("move_base_simple/goal", PoseStamped, queue_size=10)

    def send() -> None:
        first.publish(stamped_pose(rospy.Time.now(), parameters.frame, parameters.goal))

    request = GoalRequest("drive_to_goal", first.has_connections, send, report.is_answered)
    Recorder(report, parameters, request=request).run()


@dataclass(frozen=True)
class PlotDockingParameters(RecordParameters):
    """Private parameters of plot_docking."""

    out: str = text("results/dock", "folder for the files")
    docks: str = text("package://bullet_lab/config/docks.yaml", "dock database, as of dock.py")
    dock_id: str = text("dock", "name of the dock in it")
    world: str = text(
        "package://bullet_lab/worlds/docking.world", "world for the plan: a path or package://"
    )
    true_dock: tuple[float, ...] = number_list(
        (4.0, 0.0, 0.0), "true pose of the floor below the marker: x y in m, yaw in rad"
    )
    camera_ahead: float = number(0.16, "m, of the camera from the robot's middle")
    database_error: float = number(
        1.0,
        "error of the pose that the robot gets, as a share of the dock's uncertainty",
        minimum=0.0,
        maximum=1.0,
    )
    seed: int = integer(0, "of that error", minimum=0)


@node
def plot_docking(parameters: PlotDockingParameters) -> None:
    """Send a robot to its dock, and record and plot the docking.

    :ROS Actions: calls dock (bullet_lab/DockAction)
    :ROS Subscribers:
        - odom (nav_msgs/Odometry): the true pose, as the simulation sends it
        - bullet_lab/touched (bullet_lab/TouchedModels): the models that the robot has touched
        - aruco/image_annotated (sensor_msgs/Image): the camera's pictures
        - dock/feedback, dock/plan, dock/finished
    :ROS Publishers: ~path (nav_msgs/Path), latched: the true path

    Writes truth.tum, path.png, camera.png and summary.json.
    """
    world = read_world_file(ResourceFinder.anywhere().find(parameters.world))
    outlines = [one.corners() for one in footprints(world, below=ROBOT_HEIGHT)]
    docks = read_docks(ResourceFinder.anywhere().find(parameters.docks))
    dock = find_dock(docks, parameters.dock_id)
    error = drawn_error(dock.uncertainty, parameters.database_error, parameters.seed)
    dock = replace(dock, pose=tuple(map(sum, zip(dock.pose, error))))
    station = Station(outlines, parameters.true_dock, parameters.camera_ahead, dock)
    report = DockReport(Path(parameters.out), station)
    view, request = PathTopics({"odom": "~path"}), _docking_request(dock, report)
    drawn = {
        "database_error": parameters.database_error,
        "database_error_x_m": error[0],
        "database_error_y_m": error[1],
        "database_error_yaw_deg": math.degrees(error[2]),
    }
    parameters = replace(parameters, about={**parameters.about, **drawn})
    Recorder(report, parameters, view, request).run()


def _docking_request(dock: Dock, report: DockReport) -> GoalRequest:
    """Return the call of the action; the result goes to the report."""
    client = ActionClient("dock", DockAction)
    handles: list[ClientGoalHandle] = []

    def is_connected() -> bool:
        ends = (client.pub_goal, client.result_sub, client.status_sub)
        return all(end.get_num_connections() > 0 for end in ends)

    def note(handle: ClientGoalHandle) -> None:
        result = handle.get_result()
        if handle.get_comm_state() == CommState.DONE and result is not None:
            report.result = docking_result(result)

    def send() -> None:
        pose = stamped_pose(rospy.Time.now(), own_frame(dock.frame), dock.pose)
        # It may search for the marker, and retry as often as dock.py allows.
        handles.append(client.send_goal(DockGoal(dock.name, pose, True, -1), note))
        report.sent = True

    def is_taken() -> bool:
        return handles[0].get_comm_state() != CommState.WAITING_FOR_GOAL_ACK

    return GoalRequest("dock", is_connected, send, is_taken)


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
