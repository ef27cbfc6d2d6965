"""The nodes that send a robot to a goal or into its dock, and record and plot the drive.

:ROS Parameters: see the dataclass of each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Mapping

import rospy
from actionlib import ActionClient, ClientGoalHandle, CommState
from geometry_msgs.msg import PoseStamped
from visualization_msgs.msg import MarkerArray

from bullet_lab.core.parameters import boolean, integer, mapping, number, number_list, text
from bullet_lab.docking.database import Dock, drawn_error, find_dock, read_docks
from bullet_lab.msg import DockAction, DockGoal
from bullet_lab.navigation.occupancy import RobotCostmap, read_map
from bullet_lab.reports.dock import DockReport, Station
from bullet_lab.reports.goal import Beacon, GoalReport, MapDriveReport
from bullet_lab.ros.gazebo.client import WORLD, StandingModels, numbered
from bullet_lab.ros.messages.poses import stamped_pose
from bullet_lab.ros.node.lock_step import Publisher
from bullet_lab.ros.node.node import node
from bullet_lab.ros.node.odometry import own_frame
from bullet_lab.ros.nodes.dock import docking_result
from bullet_lab.ros.nodes.drive_to_goal import DriveToGoalParameters
from bullet_lab.ros.nodes.noisy_odom import NoisyOdomParameters
from bullet_lab.ros.record.plots import PathTopics
from bullet_lab.ros.record.recorder import (
    GoalRequest,
    Recorder,
    RecordParameters,
    RenewedParameters,
)
from bullet_lab.simulation.world.description import footprints
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.sdf import read_world_file

# m; the plan of the station has only objects that the robot can touch.
ROBOT_HEIGHT = 0.55


@dataclass(frozen=True)
class PlotGoalParameters(RenewedParameters):
    """Private parameters of plot_goal."""

    out: str = text("results/goal", "folder for the files")
    about: Mapping[str, Any] = mapping(
        "further entries of summary.json", NoisyOdomParameters, DriveToGoalParameters
    )
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
