"""Displays: each shows the messages of one topic in the scene, with a class for each message type.

A display subscribes when it is made, and until it is closed. `tick` reads and shows new messages.
"""

from __future__ import annotations

import math
import struct
import time
from dataclasses import dataclass
from typing import Any, Callable, Iterable

import cv2
import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from numpy import ndarray
from sensor_msgs.msg import Image, LaserScan, PointCloud2, PointField, Range

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.core.se2 import ellipse_points
from bullet_lab.ros.messages.images import pixels_of
from bullet_lab.ros.messages.poses import normalised_pose
from bullet_lab.ros.node.node import Refusals
from bullet_lab.ros.view.context import DisplayContext, MessageError, Subscription, reader_of
from bullet_lab.ros.view.scene import RGB, Nodes, rgb, segments, wxyz

# The colours of all figures: perfect paths are orange, noisy ones blue, and plans green.
PERFECT = rgb((0.90, 0.62, 0.0))
NOISY = rgb((0.0, 0.45, 0.70))
PLAN = rgb((0.0, 0.62, 0.45))
LASER = rgb((0.84, 0.37, 0.0))
SONAR = rgb((0.8, 0.47, 0.65))
# m above the floor, so that lines on top of each other are all visible.
PERFECT_HEIGHT = 0.02
NOISY_HEIGHT = 0.025
PLAN_HEIGHT = 0.03
# m between two points of a trail, and how many points are kept.
TRAIL_STEP = 0.02
MAX_TRAIL = 20000
# Sizes in m.
POINT_SIZE = 0.03
DISC = {"point_shape": "circle", "point_shading": "flat"}
AXES = {"axes_length": 0.25, "axes_radius": 0.008}
MAX_RAYS = 1440
# Markers with the paths of all robots.
FLEET_PATHS = "/fleet_paths"
ARC_POINTS = 12
ELLIPSE_POINTS = 37
# Encodings of depth images, with m per unit; far points are drawn darker.
DEPTHS = {"32FC1": (np.float32, 1.0), "16UC1": (np.uint16, 0.001)}
MAX_DEPTH = 10.0
MAX_WIDTH = 640
# NumPy's letters for the types of a PointField, from INT8 to FLOAT64.
FIELD_TYPES = dict(enumerate("bBhHiIfd", PointField.INT8))
# Larger clouds are thinned out, for the network and for the browser.
MAX_POINTS = 8000
CLOUD_POINT_SIZE = 0.015
GREY = 128
NO_POINTS = np.zeros((0, 3))


class Display:
    """Shows one topic; `read`, `every` and `large` are as in `Subscription`.

    Attributes:
        name: of its nodes in the scene, or of the node above them.
        nodes: that it shows.
    """

    # Whether it stays on the page after the publisher has exited.
    stays = False
    every = large = False
    read: Callable[[bytes], Any]

    def __init__(self, context: DisplayContext, topic: str):
        self.context, self.name = context, f"/topics{topic}"
        self.nodes = Nodes(context.scene)
        self._subscription = Subscription(topic, self.read, self.every, self.large)

    def tick(self) -> None:
        """Show the newest message; raises LabError if it cannot be shown."""
        message = self._subscription.newest()
        if message is not None:
            self.show(message)

    def show(self, message: Any) -> None:
        """Show a message as `read` returns it."""

    def show_discs(self, points: ndarray, colour: RGB, size: float, part: str = "") -> None:
        """Show points (n, 3) as discs of a size in m."""
        look = {"colors": colour, "point_size": size, **DISC}
        self.nodes.put_points(self.name + part, look, points=points)

    def close(self) -> None:
        """Unsubscribe, and show nothing."""
        self._subscription.close()
        self.nodes.clear()


def read_path(data: bytes) -> tuple[str, ndarray]:
    """Return frame and positions (n, 3), m, of a serialised nav_msgs/Path; raises MessageError.

    The positions are read from the bytes, as a path may have thousands of poses, and genpy makes
    four objects for each. This needs poses of one size: the names of their frames are equally long.
    """
    try:
        (length,) = struct.unpack_from("<I", data, 12)
        (count,) = struct.unpack_from("<I", data, 16 + length)
        rows = np.frombuffer(data, np.uint8, offset=20 + length).reshape(count, -1)
        # A pose has 12 bytes of sequence number and stamp, a name after its length, and 7 numbers.
        name_length = rows.shape[1] - 72
        lengths = rows[:, 12:16].copy().view("<u4")
        is_regular = name_length >= 0 and bool((lengths == name_length).all())
    except (struct.error, ValueError):
        is_regular = False
    if is_regular:
        frame = data[16 : 16 + length].decode("utf-8", "replace")
        positions = rows[:, -56:-32].copy().view("<f8")
    else:
        message = reader_of(Path)(data)
        frame = message.header.frame_id
        places = [one.pose.position for one in message.poses]
        positions = np.array([(p.x, p.y, p.z) for p in places]).reshape(-1, 3)
    return frame, finite(positions, "the path")


def finite(values: ndarray, name: str) -> ndarray:
    """Return an array; raises MessageError if a number is not finite."""
    if not np.isfinite(values).all():
        raise MessageError(f"{name} has numbers that are not finite")
    return values


class PathDisplay(Display):
    """A path, or a plan and its waypoints, of which there may be only one."""

    stays = True
    read = staticmethod(read_path)

    def __init__(self, context: DisplayContext, topic: str):
        super().__init__(context, topic)
        self._is_plan = "plan" in topic
        self._colour, self._height = (PLAN, PLAN_HEIGHT) if self._is_plan else look_of(topic)

    def show(self, message: tuple[str, ndarray]) -> None:  # noqa: D102 - inherited
        frame, positions = message
        points = placed(self.context.pose_of(frame), positions) + (0.0, 0.0, self._height)
        self.nodes.put_line(self.name, points, self._colour)
        if self._is_plan:
            self.show_discs(points, self._colour, 2.0 * POINT_SIZE, "/points")


class OdometryDisplay(Display):
    """The trail of a robot's odometry, and the ellipse of its position at 95 % probability."""

    read = staticmethod(reader_of(Odometry))

    def __init__(self, context: DisplayContext, topic: str):
        super().__init__(context, topic)
        self._colour, self._height = look_of(topic)
        self._trail = NO_POINTS.astype(np.float32)

    def show(self, message: Odometry) -> None:  # noqa: D102 - inherited
        frame, covariance = message.header.frame_id, message.pose.covariance
        frame_pose = self.context.pose_of(frame)
        x, y, _ = (frame_pose * normalised_pose(message.pose.pose)).position
        position = (x, y, self._height)
        self._extend_trail(position)
        ellipse = _ellipse(covariance[0], covariance[1], covariance[7])
        ends = segments(placed(Pose(position, frame_pose.quaternion), ellipse))
        self.nodes.put_segments(f"{self.name}/ellipse", ends, self._colour)

    def _extend_trail(self, point: Vector) -> None:
        if len(self._trail) and math.dist(self._trail[-1].tolist(), point) < TRAIL_STEP:
            return
        if len(self._trail) == MAX_TRAIL:
            self._trail = self._trail[MAX_TRAIL // 2 :]
        self._trail = np.concatenate((self._trail, np.float32([point])))
        self.nodes.put_line(f"{self.name}/trail", self._trail, self._colour)


def _ellipse(xx: float, xy: float, yy: float) -> ndarray:
    """Return points (n, 3) of the ellipse of a covariance (m²); none if it is not definite."""
    if not math.isfinite(xx + xy + yy) or xx <= 0.0 or xx * yy <= xy * xy:
        return NO_POINTS
    points = ellipse_points(np.array(((xx, xy), (xy, yy))), ELLIPSE_POINTS)
    return np.column_stack((points, np.zeros(len(points))))


class ScanDisplay(Display):
    """The points that a laser hits."""

    read = staticmethod(reader_of(LaserScan))

    def show(self, message: LaserScan) -> None:  # noqa: D102 - inherited
        start, step = message.angle_min, message.angle_increment
        finite(np.array((start, step, message.range_min)), "the scan")
        every = max(1, math.ceil(len(message.ranges) / MAX_RAYS))
        ranges = np.array(message.ranges[::every])
        hits = (ranges >= message.range_min) & (ranges < message.range_max)
        rays = _directions(start + every * step * np.arange(len(ranges)))
        points = rays[hits] * ranges[hits, None]
        points = placed(self.context.pose_of(message.header.frame_id), points)
        self.show_discs(points, LASER, POINT_SIZE)


def _directions(angles: ndarray) -> ndarray:
    """Return horizontal unit vectors (n, 3)."""
    return np.column_stack((np.cos(angles), np.sin(angles), np.zeros(len(angles))))


class RangeDisplay(Display):
    """The outline of the cone of a sonar or an infrared sensor, up to the measured range."""

    read = staticmethod(reader_of(Range))

    def show(self, message: Range) -> None:  # noqa: D102 - inherited
        reach = min(message.range, message.max_range)
        # A sensor that measures in all directions has no cone.
        if not (math.isfinite(reach) and reach > 0.0 and message.field_of_view > 0.0):
            self.nodes.clear()
            return
        half = 0.5 * min(message.field_of_view, math.pi)
        level = _directions(np.linspace(-half, half, ARC_POINTS))
        tip, upright = np.zeros((1, 3)), level[:, (0, 2, 1)]
        outline = reach * np.concatenate((tip, level, tip, upright, tip))
        pose = self.context.pose_of(message.header.frame_id)
        self.nodes.put_segments(self.name, segments(placed(pose, outline)), SONAR)


class PoseDisplay(Display):
    """A pose, as the axes of its frame."""

    read = staticmethod(reader_of(PoseStamped))

    def show(self, message: PoseStamped) -> None:  # noqa: D102 - inherited
        turn = message.pose.orientation
        if not any((turn.x, turn.y, turn.z, turn.w)):
            return
        pose = self.context.pose_of(message.header.frame_id) * normalised_pose(message.pose)
        place = {"position": pose.position, "wxyz": wxyz(pose)}
        self.nodes.put(self.name, self.context.scene.add_frame, AXES, **place)


def look_of(topic: str) -> tuple[RGB, float]:
    """Return the colour of a path or an odometry, and how high above the floor (m) it is drawn."""
    return (NOISY, NOISY_HEIGHT) if "noisy" in topic else (PERFECT, PERFECT_HEIGHT)


def placed(pose: Pose, points: ndarray) -> ndarray:
    """Transform points (n, 3) from a frame, given by its pose, to the frame that the pose is in."""
    return points @ pose.rotation_matrix().T + pose.position


class CameraDisplay:
    """Shows the images of one topic at a limited rate.

    Args:
        show: takes an image (h, w, 3) uint8 RGB.
        rate: images per second at most.
    """

    def __init__(self, show: Callable[[ndarray], None], rate: float):
        self._show = show
        self._period = 1.0 / rate
        self._topic = ""
        self._subscription: Subscription | None = None
        self._last = -math.inf

    def follow(self, topic: str) -> None:
        """Show the images of a topic; none if it is empty."""
        if topic == self._topic:
            return
        self.close()
        self._topic = topic
        if topic:
            self._subscription = Subscription(topic, reader_of(Image, visible), large=True)

    def tick(self) -> None:
        """Show the newest image."""
        if self._subscription is None or time.monotonic() - self._last < self._period:
            return
        pixels = self._subscription.newest()
        if pixels is not None:
            self._last = time.monotonic()
            self._show(pixels)

    def close(self) -> None:
        """Unsubscribe."""
        if self._subscription is not None:
            self._subscription.close()
        self._subscription = None
        self._topic = ""


def visible(message: Image) -> ndarray:
    """Return an image as (h, w, 3) uint8 RGB, scaled down if wide; raises ImageError."""
    if message.encoding in DEPTHS:
        pixels = cv2.cvtColor(_grey_of_depths(message), cv2.COLOR_GRAY2RGB)
    else:
        pixels = cv2.cvtColor(pixels_of(message, "bgr8"), cv2.COLOR_BGR2RGB)
    height, width = pixels.shape[:2]
    if width > MAX_WIDTH:
        size = (MAX_WIDTH, max(1, height * MAX_WIDTH // width))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    return pixels


def _grey_of_depths(message: Image) -> ndarray:
    kind, metres = DEPTHS[message.encoding]
    rows = pixels_of(message, message.encoding).astype(kind) * metres
    rows = np.nan_to_num(rows, nan=MAX_DEPTH, posinf=MAX_DEPTH)
    return (255.0 * (1.0 - np.clip(rows / MAX_DEPTH, 0.0, 1.0))).astype(np.uint8)


class PointsDisplay(Display):
    """The points of a cloud, in their colours if it has any."""

    large = True
    read = staticmethod(reader_of(PointCloud2))

    def show(self, message: PointCloud2) -> None:  # noqa: D102 - inherited
        points, colours = points_of(message)
        points = placed(self.context.pose_of(message.header.frame_id), points)
        look = {"point_size": CLOUD_POINT_SIZE}
        self.nodes.put_points(self.name, look, points=points, colors=colours)


def points_of(message: PointCloud2, most: int = MAX_POINTS) -> tuple[ndarray, ndarray]:
    """Return positions (n, 3) in m and colours (n, 3) uint8 of at most so many points of a cloud.

    Points that are not finite are left out. Raises MessageError if the cloud is invalid.
    """
    fields = {field.name: field for field in message.fields}
    if not fields.keys() >= set("xyz"):
        raise MessageError("the cloud has no x, y and z; these fields are needed")
    order = ">" if message.is_bigendian else "<"
    try:
        layout = {
            "names": list(fields),
            "formats": [order + FIELD_TYPES[field.datatype] for field in fields.values()],
            "offsets": [field.offset for field in fields.values()],
            "itemsize": message.point_step,
        }
        shape, strides = (message.height, message.width), (message.row_step, message.point_step)
        rows = ndarray(shape, layout, message.data, strides=strides).reshape(-1)
    except (KeyError, TypeError, ValueError) as error:
        raise MessageError(f"the cloud does not match its declared layout: {error}") from error
    positions = np.column_stack([rows[name] for name in "xyz"]).astype(np.float64)
    chosen = np.flatnonzero(np.isfinite(positions).all(axis=1))
    chosen = chosen[:: max(1, -(-len(chosen) // most))]
    colours = np.full((len(chosen), 3), GREY, np.uint8)
    packed = next((rows[name] for name in ("rgb", "rgba") if name in fields), None)
    if packed is not None and packed.dtype.itemsize == 4:
        # Four bytes from blue upwards, whether the field is declared as a float or an integer.
        words = np.ascontiguousarray(packed[chosen]).view(np.uint32)
        colours = np.stack([words >> shift & 255 for shift in (16, 8, 0)], axis=1).astype(np.uint8)
    return positions[chosen], colours


@dataclass(frozen=True)
class Kind:
    """Displays that are switched on and off together.

    Attributes:
        name: of the switch.
        displays: by message type.
        wanted: whether a topic is shown, from its name and all published topics with their types.
        every: one in so many ticks of the view updates these displays.
    """

    name: str
    displays: dict[str, Callable[[DisplayContext, str], Any]]
    wanted: Callable[[str, dict[str, str]], bool] = lambda topic, others: True
    every: int = 3


class Displays:
    """The displays of a kind, one for each topic: `shown`."""

    def __init__(self, kind: Kind, context: DisplayContext):
        self.kind = kind
        self._context = context
        self.shown: dict[str, Any] = {}
        self._refusals = Refusals()

    def follow(self, topics: dict[str, str]) -> None:
        """Show those of these topics, with their types, that are of the kind; none if empty."""
        found = {
            topic: self.kind.displays[type_name]
            for topic, type_name in topics.items()
            if type_name in self.kind.displays and self.kind.wanted(topic, topics)
        }
        for topic in set(self.shown) - set(found):
            if not (topics and topic not in topics and self.shown[topic].stays):
                self.shown.pop(topic).close()
        for topic in sorted(set(found) - set(self.shown)):
            self.shown[topic] = found[topic](self._context, topic)

    def tick(self) -> None:
        """Show new messages."""
        for topic, display in self.shown.items():
            with self._refusals.on(topic):
                display.tick()


def has_no_path(topic: str, others: Iterable[str]) -> bool:
    """Return whether no topic has the path of an odometry, which begins with the same name."""
    known = (f"{topic}_path", FLEET_PATHS)
    return not any(other.endswith(known) for other in others)


def closest(options: list[str], endings: Iterable[str]) -> str | None:
    """Return the first option with the first ending that any option has, else the first option."""
    found = (option for ending in endings for option in options if option.endswith(ending))
    return next(found, next(iter(options), None))
