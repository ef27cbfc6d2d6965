"""Sends a robot to its dock, records how it goes, and leaves what came of it.

:ROS Parameters: see `PlotDockingParameters`.
:ROS Actions: calls dock (bullet_lab/DockAction)
:ROS Subscribers:
    - odom (nav_msgs/Odometry): the true pose, as the simulation sends it
    - bullet_lab/touched (bullet_lab/TouchedModels): what the robot has run into
    - aruco/image_annotated (sensor_msgs/Image): what the camera saw
    - dock/feedback, dock/plan, dock/finished
:ROS Publishers: ~path (nav_msgs/Path), latched: the true path

Leaves truth.tum, written row by row, path.png, camera.png and summary.json.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, List, Mapping, Optional, Tuple

from actionlib import ActionClient, ClientGoalHandle, CommState
from geometry_msgs.msg import PoseStamped

from bullet_lab.core.parameters import boolean, integer, number, number_list, text
from bullet_lab.docking.types import DockingError, DockingResult
from bullet_lab.msg import DockAction, DockGoal, DockResult
from bullet_lab.reports.dock import DockReport, Station
from bullet_lab.ros.node.node import private_parameters, run_node
from bullet_lab.ros.nodes.noisy_odom import NoisyOdomParameters
from bullet_lab.ros.record.recorder import Errand, Recorder, RecordParameters, about
from bullet_lab.ros.record.rviz import PathTopics
from bullet_lab.simulation.world.floor_plan import footprints
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.sdf import read_world_file

ROBOT_HEIGHT = 0.55


@dataclass(frozen=True)
class PlotDockingParameters(RecordParameters):
    """Private parameters of plot_docking."""

    about: Mapping[str, Any] = about(NoisyOdomParameters)
    out: str = text("results/dock", "folder for the files")
    dock_id: str = text("dock", "name of the dock in the database of dock.py")
    search: bool = boolean(True, "look for the marker where it is not seen at once")
    max_retries: int = integer(-1, "-1: as dock.py is configured", minimum=-1)
    world: str = text(
        "package://bullet_lab/worlds/docking.world", "world for the plan: a path or package://"
    )
    true_dock: Tuple[float, ...] = number_list(
        (4.0, 0.0, 0.0), "true pose of the floor below the marker: x y in m, yaw in rad"
    )
    camera_ahead: float = number(0.16, "m, of the camera from the robot's middle")
    docked_distance: float = number(
        0.4, "m from the camera to the marker in a docked robot", above=0.0
    )
    pictures: int = integer(8, "of the camera along the way", minimum=2, maximum=40)


def station_of(parameters: PlotDockingParameters) -> Station:
    """Return where the robot docks; raises LabError where there is no such world."""
    world = read_world_file(ResourceFinder.anywhere().find(parameters.world))
    outlines = [one.corners() for one in footprints(world, below=ROBOT_HEIGHT)]
    return Station(
        outlines, parameters.true_dock, parameters.camera_ahead, parameters.docked_distance
    )


def docking_errand(parameters: PlotDockingParameters, report: DockReport) -> Errand:
    """Return the call of the action, whose result goes to the report."""
    client = ActionClient("dock", DockAction)
    handles: List[ClientGoalHandle] = []

    def is_connected() -> bool:
        ends = (client.pub_goal, client.result_sub, client.status_sub)
        return all(end.get_num_connections() > 0 for end in ends)

    def note(handle: ClientGoalHandle) -> None:
        result: Optional[DockResult] = handle.get_result()
        if handle.get_comm_state() == CommState.DONE and result is not None:
            error = DockingError(result.error_code)
            report.result = DockingResult(result.success, error, result.message, result.retries)

    def send() -> None:
        goal = DockGoal(
            parameters.dock_id, PoseStamped(), parameters.search, parameters.max_retries
        )
        handles.append(client.send_goal(goal, note))
        report.sent = True

    def is_taken() -> bool:
        return handles[0].get_comm_state() != CommState.WAITING_FOR_GOAL_ACK

    return Errand("dock", is_connected, send, is_taken)


def main() -> None:
    """Run the node."""

    def body() -> None:
        parameters = private_parameters(PlotDockingParameters)
        report = DockReport(Path(parameters.out), station_of(parameters), parameters.pictures)
        view, errand = PathTopics({"odom": "~path"}), docking_errand(parameters, report)
        Recorder(report, parameters, "the bridge and dock", view, errand).run()

    run_node("plot_docking", body)
