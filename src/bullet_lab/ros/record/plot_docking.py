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

import contextlib
import time
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any, Dict, List, Mapping, Optional, Tuple

import cv2
import rospy
from actionlib import GoalStatus, SimpleActionClient
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from sensor_msgs.msg import Image
from std_msgs.msg import Time

from bullet_lab.core.figures import save
from bullet_lab.core.files import make_folder, write_json
from bullet_lab.docking.types import DockingError, DockingState
from bullet_lab.msg import DockAction, DockActionFeedback, DockGoal, TouchedModels
from bullet_lab.reports.dock import Keepsakes, docking_errors, docking_figure, strip_figure
from bullet_lab.ros.messages.images import ImageError, pixels_of
from bullet_lab.ros.node import parameters
from bullet_lab.ros.node.node import NodeError, private_parameters, run_node
from bullet_lab.ros.node.publishers import Publisher
from bullet_lab.ros.node.tf_prefix import own_frame
from bullet_lab.ros.nodes.noisy_odom import NoisyOdomParameters
from bullet_lab.ros.record.errand_recorder import ErrandRecorder
from bullet_lab.simulation.floor_plan import footprints
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.sdf import read_world_file

# Simulated seconds that are recorded after the end: a robot that should stand, stands.
REST = rospy.Duration(0, 500_000_000)
ROBOT_HEIGHT = 0.55
PATH_PERIOD_SECONDS = 0.5
PICTURE_WIDTH = 320


@dataclass(frozen=True)
class PlotDockingParameters:
    """Private parameters of plot_docking."""

    out: str = parameters.text("results/dock", "folder for the files")
    about: Mapping[str, Any] = parameters.mapping(
        "what else summary.json shall say", NoisyOdomParameters
    )
    dock_id: str = parameters.text("dock", "name of the dock in the database of dock.py")
    search: bool = parameters.boolean(True, "look for the marker where it is not seen at once")
    max_retries: int = parameters.integer(-1, "-1: as dock.py is configured", minimum=-1)
    world: str = parameters.text(
        "package://bullet_lab/worlds/docking.world", "world for the plan: a path or package://"
    )
    true_dock: Tuple[float, ...] = parameters.number_list(
        (4.0, 0.0, 0.0), "true pose of the floor below the marker: x y in m, yaw in rad"
    )
    camera_ahead: float = parameters.number(0.16, "m, of the camera from the robot's middle")
    docked_distance: float = parameters.number(
        0.4, "m from the camera to the marker in a docked robot", above=0.0
    )
    pictures: int = parameters.integer(8, "of the camera along the way", minimum=2, maximum=40)
    lock_step: bool = parameters.boolean(False, "hold simulated time back until the goal is sent")


class PlotDocking(ErrandRecorder):
    """Client and recorder of one docking."""

    def __init__(self, wanted: PlotDockingParameters):
        self._wanted = wanted
        self._folder = make_folder(FilePath(wanted.out))
        self._plan_of_world = _plan(wanted.world)
        super().__init__(self._folder, wanted.lock_step, "dock")
        self._frames = Keepsakes(wanted.pictures)
        self._images = 0
        self._states: List[Tuple[float, str]] = []
        self._plan: Tuple[Tuple[float, float], ...] = ()
        self._touched: Optional[TouchedModels] = None
        self._finished: Optional[rospy.Time] = None
        self._client = SimpleActionClient("dock", DockAction)
        self._path = Publisher("~path", Path, queue_size=1, latch=True)
        self._shown = time.monotonic()
        self._missed = ""
        # What an earlier docking has left is not of this one.
        for name in ("path.png", "camera.png", "summary.json"):
            with contextlib.suppress(FileNotFoundError):
                (self._folder / name).unlink()
        self._subscribers = [
            self._listen_to_odometry(),
            rospy.Subscriber("bullet_lab/touched", TouchedModels, self._receive_touched),
            rospy.Subscriber("aruco/image_annotated", Image, self._receive_image),
            rospy.Subscriber("dock/feedback", DockActionFeedback, self._receive_feedback),
            rospy.Subscriber("dock/plan", Path, self._receive_plan),
            rospy.Subscriber("dock/finished", Time, self._receive_finished),
        ]

    def _send(self) -> None:
        wanted = self._wanted
        goal = DockGoal(wanted.dock_id, PoseStamped(), wanted.search, wanted.max_retries)
        self._client.send_goal(goal)

    def _is_connected(self) -> bool:
        client = self._client.action_client
        return (
            client.pub_goal.get_num_connections() > 0
            and client.result_sub.get_num_connections() > 0
            and client.status_sub.get_num_connections() > 0
            and super()._is_connected()
        )

    def _is_taken(self) -> bool:
        return self._client.get_state() != GoalStatus.PENDING

    def _meanwhile(self) -> None:
        now = time.monotonic()
        if now - self._shown > PATH_PERIOD_SECONDS:
            self._shown = now
            self._publish_path()

    def _is_complete(self) -> bool:
        until = self._until()
        with self._lock:
            if until is None or self._touched is None or self._truth.last is None:
                return False
            touched = self._touched.header.stamp.to_nsec()
            return min(self._truth.last, touched) >= until and self._result() is not None

    def _until(self) -> Optional[int]:
        return None if self._finished is None else (self._finished + REST).to_nsec()

    def _result(self) -> Any:
        return self._client.get_result() if self._client.gh is not None else None

    # What comes in

    def _receive_touched(self, message: TouchedModels) -> None:
        with self._lock:
            until = self._until()
            # What is touched after the end is no part of the docking.
            if until is None or self._touched is None or _stamp(self._touched) < until:
                self._touched = message

    def _receive_image(self, message: Image) -> None:
        if self._client.gh is None or self._finished is not None:
            return
        try:
            picture = cv2.cvtColor(pixels_of(message, "bgr8"), cv2.COLOR_BGR2RGB)
        except ImageError as error:
            self._refusals.refuse("aruco/image_annotated", str(error))
            return
        height = round(PICTURE_WIDTH * picture.shape[0] / picture.shape[1])
        small = cv2.resize(picture, (PICTURE_WIDTH, height), interpolation=cv2.INTER_AREA)
        with self._lock:
            self._images += 1
            self._frames.add((message.header.stamp.to_sec(), small))

    def _receive_feedback(self, message: DockActionFeedback) -> None:
        name = DockingState(message.feedback.state).label
        with self._lock:
            if not self._states or self._states[-1][1] != name:
                self._states.append((message.header.stamp.to_sec(), name))

    def _receive_plan(self, message: Path) -> None:
        if message.poses:
            places = (stamped.pose.position for stamped in message.poses)
            self._plan = tuple((place.x, place.y) for place in places)

    def _receive_finished(self, message: Time) -> None:
        self._finished = message.data

    # What is left behind

    def _publish_path(self) -> None:
        if self._path.get_num_connections() == 0:
            return
        with self._lock:
            path = self._truth.until(None)
        if path is not None:
            message = Path()
            message.header.frame_id = own_frame("odom")
            for x, y, _ in path.poses:
                stamped = PoseStamped()
                stamped.pose.position.x, stamped.pose.position.y = x, y
                stamped.pose.orientation.w = 1.0
                message.poses.append(stamped)
            self._path.publish(message)

    def _write(self) -> None:
        for subscriber in self._subscribers:
            subscriber.unregister()
        with self._lock:
            until = self._until()
            self._truth.finish(until)
            truth = self._truth.until(until)
            frames = [(at, self._state_at(at), picture) for at, picture in self._frames.chosen()]
        summary = self._summary(truth)
        title = _title(summary)
        figure = docking_figure(
            truth,
            self._states,
            self._plan,
            self._plan_of_world,
            self._wanted.true_dock,
            title,
        )
        save(figure, self._folder / "path.png")
        if frames:
            save(strip_figure(frames), self._folder / "camera.png")
        write_json(self._folder / "summary.json", summary)
        if summary["docked"] or not summary["finished"]:
            rospy.loginfo("%s", title)
        else:
            self._missed = title

    def _judge(self) -> None:
        if self._missed:
            raise NodeError(self._missed)

    def _state_at(self, seconds: float) -> str:
        before = [name for at, name in self._states if at <= seconds]
        return before[-1] if before else "at rest"

    def _summary(self, truth: Any) -> Dict[str, Any]:
        result = self._result()
        errors: Dict[str, Any] = dict.fromkeys(
            ("distance_error_m", "lateral_error_m", "yaw_error_deg")
        )
        seconds = 0.0
        if truth is not None:
            wanted = self._wanted
            errors = docking_errors(
                truth.poses[-1], wanted.true_dock, wanted.camera_ahead, wanted.docked_distance
            )
            seconds = float(truth.stamps[-1] - truth.stamps[0])
        touched = self._touched or TouchedModels()
        return {
            **self._wanted.about,
            "finished": self._finished is not None,
            "docked": bool(result and result.success),
            "error_code": result.error_code if result else int(DockingError.UNKNOWN),
            "error_name": DockingError(result.error_code).name if result else "UNKNOWN",
            "message": result.message if result else "the docking was not finished",
            **errors,
            "wall_contacts": sum(touched.touches),
            "touched": dict(zip(touched.models, touched.touches)),
            "retries": result.retries if result else None,
            "images": self._images,
            **self._stopwatch.figures(seconds),
            "refused_messages": self._refusals.total,
        }


def _stamp(message: TouchedModels) -> int:
    return message.header.stamp.to_nsec()


def _plan(world: str) -> list:
    found = read_world_file(ResourceFinder.anywhere().find(world))
    return [one.corners() for one in footprints(found, below=ROBOT_HEIGHT)]


def _title(summary: Mapping[str, Any]) -> str:
    """Return in a line how it ended."""
    if not summary["docked"]:
        return f"not docked: {summary['message']} ({summary['error_name']})"
    return (
        f"docked after {summary['sim_time_s']:.1f} s, {summary['retries']} retries, "
        f"{summary['wall_contacts']} wall contacts; off by "
        f"{1000.0 * summary['distance_error_m']:+.1f} mm along the axis, "
        f"{1000.0 * summary['lateral_error_m']:+.1f} mm across, "
        f"{summary['yaw_error_deg']:+.2f} deg"
    )


def main() -> None:
    """Run the node."""
    run_node("plot_docking", lambda: PlotDocking(private_parameters(PlotDockingParameters)).run())
