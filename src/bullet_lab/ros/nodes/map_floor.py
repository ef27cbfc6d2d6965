"""The floor of a robot that drives on a map: map, scans, plan and costmap by move_base's names.

:ROS Subscribers:
    - map (nav_msgs/OccupancyGrid), or the topic ~map, unless that is the YAML file of a map
    - scan (sensor_msgs/LaserScan), or the topic ~scan
:ROS Publishers, latched:
    - move_base/NavfnROS/plan (nav_msgs/Path)
    - move_base/global_costmap/costmap (nav_msgs/OccupancyGrid)
:ROS Services:
    - move_base/make_plan (nav_msgs/GetPlan); its tolerance is ignored
    - move_base/clear_costmaps (std_srvs/Empty): forget what the laser has seen
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any, NamedTuple

import numpy as np
import rospy
from nav_msgs.msg import MapMetaData, OccupancyGrid, Path
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.srv import GetPlan, GetPlanRequest
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header
from std_srvs.srv import Empty

from bullet_lab.core.parameters import boolean, number, text
from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.docking.types import Odometry, OdometryBuffer
from bullet_lab.drive import Command, GoalLimits
from bullet_lab.navigation.driver import MapDriver
from bullet_lab.navigation.occupancy import OccupancyMap, RobotCostmap, read_map
from bullet_lab.navigation.paths import Point, along
from bullet_lab.ros.messages.poses import InputError, pose_message, pose_of, stamped_pose
from bullet_lab.ros.node.lock_step import Publisher
from bullet_lab.ros.node.node import Refusals
from bullet_lab.ros.node.odometry import (
    FrameError,
    FrameFinder,
    MessageQueue,
    OdometryError,
    framed,
    planar_pose,
)

# Seconds between two costmaps.
COSTMAP_PERIOD = 1.0


@dataclass(frozen=True)
class MapParameters:
    """Private parameters of a node that drives on a map."""

    radius: float = number(0.25, "m, of the circle in which the robot turns", above=0.0)
    inflation: float = number(0.55, "m from things beyond which floor costs the same", above=0.0)
    allow_unknown: bool = boolean(True, "plan over floor that the map does not know")
    wait: float = number(15.0, "s without a way after which the goal is aborted", minimum=0.0)
    map: str = text("", "topic or YAML file of the map to plan on; empty: drive straight to goals")
    map_frame: str = text("map", "frame of the map in a file")
    scan: str = text("scan", "topic of the laser for what the map does not show; empty: none")
    scan_rate: float = number(10.0, "lock step: scans per second", above=0.0, maximum=1000.0)


@dataclass(frozen=True)
class Place(Odometry):
    """Odometry, and the frame of the robot."""

    robot: str = ""


class Scan(NamedTuple):
    """The content of a scan: s, its frame, angles (rad), ranges and greatest range (m)."""

    seconds: float
    frame: str
    angles: np.ndarray
    ranges: np.ndarray
    greatest: float


def read_place(message: OdometryMessage) -> Place:
    """Return the content of odometry; raises InputError."""
    child = message.child_frame_id.lstrip("/")
    return Place(message.header.stamp.to_sec(), planar_pose(message), robot=child)


def read_scan(message: LaserScan) -> Scan:
    """Return the content of a scan; raises InputError."""
    first, step, greatest = message.angle_min, message.angle_increment, message.range_max
    if not all(map(math.isfinite, (first, step, greatest))) or greatest <= 0.0:
        raise InputError("angles or range_max that are not finite")
    angles = first + step * np.arange(len(message.ranges))
    frame, ranges = message.header.frame_id.lstrip("/"), np.array(message.ranges, dtype=float)
    ranges[ranges < message.range_min] = math.nan
    return Scan(message.header.stamp.to_sec(), frame, angles, ranges, greatest)


def read_grid(message: OccupancyGrid) -> OccupancyMap:
    """Return a map; raises InputError."""
    info, data = message.info, np.array(message.data, dtype=np.int8)
    origin = pose_of(info.origin.position, info.origin.orientation)
    is_size = math.isfinite(info.resolution) and info.resolution > 0.0
    if data.size != info.width * info.height or not data.size or not is_size:
        size = f"{info.width} x {info.height} cells of {info.resolution:g} m"
        raise InputError(f"{data.size} values for {size}")
    if abs(origin.yaw) > 1e-6:
        rospy.logwarn_once("the map's origin has a yaw, which is ignored, as by costmap_2d")
    # The file has 0.05, the message the nearest float of 32 bits.
    resolution = float(f"{info.resolution:.6g}")
    x, y, _ = origin.position
    return OccupancyMap(data.reshape(info.height, info.width), resolution, (x, y, 0.0))


def grid_message(made: OccupancyMap, header: Header) -> OccupancyGrid:
    """Return a map as a message."""
    rows, columns = made.cells.shape
    pose = pose_message(Pose.on_floor(*made.origin))
    info = MapMetaData(header.stamp, made.resolution, columns, rows, pose)
    return OccupancyGrid(header, info, made.cells.ravel().tolist())


class Floor:
    """What a robot that drives on a map knows of the floor.

    Args:
        parameters: of the node.
        frames: of TF.

    Attributes:
        scans: the queue of scans; None without a laser.
    """

    def __init__(self, parameters: MapParameters, frames: FrameFinder):
        self._parameters, self._frames = parameters, frames
        self.scans: MessageQueue | None = None
        if parameters.scan:
            self.scans = MessageQueue(parameters.scan, LaserScan, read_scan, parameters.scan_rate)
            self.scans.open()
        self._refusals = Refusals()
        self._frame = ""
        self._costmap: RobotCostmap | None = None
        # The last odometry, and the robot's pose in the map.
        self._places = OdometryBuffer()
        self._pose: PlanarPose | None = None
        self._plans = -1
        self._shown = rospy.Time(0)
        self._plan = Publisher("move_base/NavfnROS/plan", Path, queue_size=1, latch=True)
        name = "move_base/global_costmap/costmap"
        self._costs = Publisher(name, OccupancyGrid, queue_size=1, latch=True)
        if parameters.map.endswith(".yaml"):
            self._use(read_map(FilePath(parameters.map)), parameters.map_frame)
        else:
            rospy.Subscriber(parameters.map, OccupancyGrid, self._take_map, queue_size=1)
        rospy.Service("move_base/make_plan", GetPlan, self._make_plan)
        rospy.Service("move_base/clear_costmaps", Empty, self._clear_costmap)

    def frame(self) -> str:
        """Return the frame of the map; raises OdometryError if there is no map yet."""
        if not self._frame:
            raise OdometryError(f"no map on {self._parameters.map}")
        return self._frame

    def place(self, places: list[Place], odometry_frame: str, now: rospy.Time) -> PlanarPose | None:
        """Take odometry and scans; return the robot's pose in the map, None if it is not known."""
        for place in places:
            self._places.add(place)
        scans = self.scans.take(now) if self.scans else []
        if not self._frame or self._places.last is None:
            return None
        try:
            origin = self._frames.pose_in(self._frame, odometry_frame, wait=False)
        except FrameError as error:
            rospy.logwarn_throttle(5.0, str(error))
            return None
        self._pose = (origin * Pose.on_floor(*self._places.last.pose)).planar
        for scan in scans:
            self._see(scan, origin)
        return self._pose

    def _see(self, scan: Scan, origin: Pose) -> None:
        """Show the costmap a scan from where the robot was then, if that is known."""
        with self._refusals.on(self._parameters.scan):
            robot = self._places.last.robot
            mount = self._frames.bring(Pose(), scan.frame, robot, wait=False)
            then = self._places.pose_at(scan.seconds)
            if then is not None:
                sensor = origin * Pose.on_floor(*then) * mount
                self._costmap.see(sensor, scan.angles, scan.ranges, scan.greatest)

    def clear(self) -> None:
        """Forget what the laser has seen, and where the robot was."""
        self._places = OdometryBuffer()
        self._clear_costmap()

    def driver(self, goal: PlanarPose, limits: GoalLimits, moving: Command) -> MapDriver:
        """Return the driver to a goal in the map's frame."""
        self._plans = -1
        return MapDriver(goal, self._costmap, limits, self._parameters.wait, moving)

    def show(self, now: rospy.Time, driver: MapDriver | None) -> None:
        """Publish a new plan, and the costmap now and then; give the driver the newest map."""
        if driver is not None:
            driver.costmap = self._costmap
            if driver.plans != self._plans:
                self._plans = driver.plans
                self._plan.publish(self._path(now, [self._pose[:2], *driver.plan]))
            if not driver.plan and not driver.failure:
                rospy.logwarn_throttle(5.0, "no way to the goal now: waiting")
        due = not 0.0 <= (now - self._shown).to_sec() < COSTMAP_PERIOD
        if due and self._costmap is not None and self._costs.has_connections():
            self._shown = now
            header = Header(0, now, self._frame)
            self._costs.publish(grid_message(self._costmap.values(), header))

    def _path(self, now: rospy.Time, way: list[Point]) -> Path:
        """Return a way as a message, with a pose every few cm, along the way."""
        poses = []
        for first, second in zip(way, way[1:]):
            yaw = math.atan2(second[1] - first[1], second[0] - first[0])
            points = along(first, second, self._costmap.map.resolution).tolist()
            poses += [stamped_pose(now, self._frame, (x, y, yaw)) for x, y in points]
        return Path(Header(0, now, self._frame), poses)

    # In threads of rospy

    def _take_map(self, message: OccupancyGrid) -> None:
        with self._refusals.on(self._parameters.map):
            frame, known = framed(read_grid)(message)
            self._use(known, frame)

    def _use(self, known: OccupancyMap, frame: str) -> None:
        limits = self._parameters
        made = RobotCostmap(known, limits.radius, limits.inflation, limits.allow_unknown)
        self._costmap, self._frame = made, frame

    def _make_plan(self, request: GetPlanRequest) -> Path | None:
        with self._refusals.on("make_plan"):
            frame, start = self.frame(), self._pose
            if request.start.header.frame_id:
                start = self._frames.planar(request.start, frame)
            goal = self._frames.planar(request.goal, frame)
            way = None if start is None else self._costmap.plan(start, goal)
            return self._path(rospy.Time.now(), way or [])
        return None

    def _clear_costmap(self, _request: Any = None) -> list:
        if self._costmap is not None:
            self._costmap.clear()
        return []
