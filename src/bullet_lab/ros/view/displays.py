"""What of a topic is seen in the scene: a class for each type of message.

A display listens from when it is made until it is closed. `tick` reads what has come and shows it.
"""

from __future__ import annotations

import functools
import logging
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, Iterable, List, Optional, Set, Tuple

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import Range

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.core.se2 import ellipse_points
from bullet_lab.errors import LabError
from bullet_lab.ros.view import raw
from bullet_lab.ros.view.feeds import Feed, reader_of
from bullet_lab.view.frames import FrameTree
from bullet_lab.view.scene import Polyline, Shown, rgb, segments_node, wxyz

LOG = logging.getLogger(__name__)
# As in all figures: perfect paths are orange, noisy ones blue, and plans green.
PERFECT, NOISY, PLAN = (0.90, 0.62, 0.0), (0.0, 0.45, 0.70), (0.0, 0.62, 0.45)
LASER, SONAR = (0.84, 0.37, 0.0), (0.8, 0.47, 0.65)
# m above the floor.
PERFECT_HEIGHT, NOISY_HEIGHT, PLAN_HEIGHT = 0.02, 0.025, 0.03
# m between two points of a trail, and how many are kept.
TRAIL_STEP, LONGEST_TRAIL = 0.02, 20000
POINT_SIZE, AXES_LENGTH, AXES_RADIUS = 0.03, 0.25, 0.008
MOST_RAYS = 1440
# Markers that have the paths of all robots.
FLEET_PATHS = "/fleet_paths"
ARC_POINTS, ELLIPSE_POINTS = 12, 37


@dataclass
class Stage:
    """Where displays put what they show.

    Attributes:
        scene: viser's.
        frames: where they are, by TF.
        fixed: frame that the scene is in.
        guessed: roots of TF that nothing connects with it, and that are taken for it.
    """

    scene: Any
    frames: FrameTree = field(default_factory=FrameTree)
    fixed: str = "world"
    guessed: Set[str] = field(default_factory=set)

    def where(self, frame: str) -> Pose:
        """Return where a frame is in the scene."""
        frame = frame.lstrip("/")
        pose = self.frames.pose(frame, self.fixed)
        if pose is None:
            root = self.frames.root(frame)
            self.guessed.add(root)
            pose = self.frames.pose(frame, root) or Pose()
        return pose


class Display(ABC):
    """What is seen of one topic; `read` and `large` as of `Feed`."""

    # Whether it is still of use when nobody publishes the topic any more.
    stays = False

    def __init__(self, stage: Stage, topic: str, read: Callable[[bytes], Any], large: bool = False):
        self.stage = stage
        self.node = f"/topics{topic}"
        self._feed = Feed(topic, read, large=large)

    def tick(self) -> None:
        """Show what has come."""
        message = self._feed.newest()
        if message is not None:
            self.show(message)

    @abstractmethod
    def show(self, message: Any) -> None:
        """Show what `read` has made of a message."""

    @abstractmethod
    def hide(self) -> None:
        """Show nothing any more."""

    def close(self) -> None:
        """Listen no longer, and show nothing."""
        self._feed.close()
        self.hide()


def is_noisy(topic: str) -> bool:
    """Return whether a topic, by its name, is about noisy odometry."""
    return "noisy" in topic


class PathDisplay(Display):
    """A path, or a plan with the points that it leads to: there may be a single one left."""

    stays = True

    def __init__(self, stage: Stage, topic: str):
        super().__init__(stage, topic, raw.read_path)
        is_plan = "plan" in topic
        colour = PLAN if is_plan else NOISY if is_noisy(topic) else PERFECT
        self._line = Polyline(stage.scene, self.node, colour)
        self._height = PLAN_HEIGHT if is_plan else height_of(topic)
        self._points = _cloud(stage, f"{self.node}/points", colour, 2.0 * POINT_SIZE)
        self._is_plan = is_plan

    def show(self, message: Tuple[str, np.ndarray]) -> None:  # noqa: D102 - as `Display` has it
        frame, places = message
        points = placed(self.stage.where(frame), places) + (0.0, 0.0, self._height)
        self._line.set(points)
        self._points.set(points if self._is_plan else points[:0])

    def hide(self) -> None:  # noqa: D102
        self._line.set(np.zeros((0, 3)))
        self._points.set(np.zeros((0, 3)))


class OdometryDisplay(Display):
    """Where a robot has said that it is, and the ellipse that it is in with 95 % probability."""

    def __init__(self, stage: Stage, topic: str):
        super().__init__(stage, topic, raw.read_odometry)
        colour, self._height = (NOISY if is_noisy(topic) else PERFECT), height_of(topic)
        self._line = Polyline(stage.scene, f"{self.node}/trail", colour)
        ellipse = f"{self.node}/ellipse"
        self._ellipse = Shown(lambda s: segments_node(stage.scene, ellipse, s, rgb(colour)))
        self._trail = np.zeros((256, 3), np.float32)
        self._count = 0
        self._last: Optional[raw.Odometry] = None

    def show(self, message: raw.Odometry) -> None:  # noqa: D102
        if message == self._last:
            return
        self._last = message
        place = self.stage.where(message.frame)
        x, y, _ = (place * message.pose).position
        self._note((x, y, self._height))
        around = placed(Pose((x, y, self._height), place.quaternion), _around(*message.covariance))
        self._ellipse.set(np.stack((around[:-1], around[1:]), axis=1))

    def hide(self) -> None:  # noqa: D102
        self._count = 0
        self._line.set(self._trail[:0])
        self._ellipse.set(self._trail[:0])

    def _note(self, point: Vector) -> None:
        if self._count and math.dist(self._trail[self._count - 1].tolist(), point) < TRAIL_STEP:
            return
        if self._count == LONGEST_TRAIL:
            self._trail[: LONGEST_TRAIL // 2] = self._trail[LONGEST_TRAIL // 2 : self._count]
            self._count = LONGEST_TRAIL // 2
        elif self._count == len(self._trail):
            longer = min(2 * self._count, LONGEST_TRAIL)
            self._trail = np.resize(self._trail, (longer, 3))
        self._trail[self._count] = point
        self._count += 1
        self._line.set(self._trail[: self._count])


@functools.lru_cache(maxsize=256)
def _around(xx: float, xy: float, yy: float) -> np.ndarray:
    """Return the points (n, 3) of the ellipse of a covariance (m²); none, if it is none."""
    if not math.isfinite(xx + xy + yy) or xx <= 0.0 or xx * yy <= xy * xy:
        return np.zeros((0, 3))
    points = ellipse_points(np.array(((xx, xy), (xy, yy))), ELLIPSE_POINTS)
    return np.column_stack((points, np.zeros(len(points))))


class ScanDisplay(Display):
    """The points that a laser hits."""

    def __init__(self, stage: Stage, topic: str):
        super().__init__(stage, topic, raw.read_scan)
        self._points = _cloud(stage, self.node, LASER, POINT_SIZE)

    def show(self, message: raw.Scan) -> None:  # noqa: D102
        count = len(message.ranges)
        every = max(1, math.ceil(count / MOST_RAYS))
        rays = _rays(message.start, message.step, count, every)
        ranges = message.ranges[::every]
        seen = (ranges >= message.least) & (ranges < message.greatest)
        points = rays[seen] * ranges[seen, None]
        self._points.set(placed(self.stage.where(message.frame), points))

    def hide(self) -> None:  # noqa: D102
        self._points.set(np.zeros((0, 3)))


@functools.lru_cache(maxsize=64)
def _rays(start: float, step: float, count: int, every: int) -> np.ndarray:
    """Return unit vectors (n, 3) along every so-manieth ray of a laser."""
    angles = start + step * np.arange(0, count, every)
    return np.column_stack((np.cos(angles), np.sin(angles), np.zeros(len(angles))))


class RangeDisplay(Display):
    """The outline of the cone that a sonar or an infrared sensor looks into, up to what it sees."""

    def __init__(self, stage: Stage, topic: str):
        super().__init__(stage, topic, reader_of(Range))
        self._lines = Shown(lambda s: segments_node(stage.scene, self.node, s, rgb(SONAR)))

    def show(self, message: Any) -> None:  # noqa: D102
        reach = min(message.range, message.max_range)
        # What tells a distance and no direction has no cone.
        if not (math.isfinite(reach) and reach > 0.0 and message.field_of_view > 0.0):
            self.hide()
            return
        half = 0.5 * min(message.field_of_view, math.pi)
        angles = np.linspace(-half, half, ARC_POINTS)
        level = np.column_stack((np.cos(angles), np.sin(angles), np.zeros(ARC_POINTS)))
        upright = level[:, (0, 2, 1)]
        tip = np.zeros((1, 3))
        outlines = [np.concatenate((tip, arc * reach, tip)) for arc in (level, upright)]
        place = self.stage.where(message.header.frame_id)
        points = [placed(place, outline) for outline in outlines]
        self._lines.set(np.concatenate([np.stack((p[:-1], p[1:]), axis=1) for p in points]))

    def hide(self) -> None:  # noqa: D102
        self._lines.set(np.zeros((0, 2, 3)))


class PoseDisplay(Display):
    """A pose, as the axes of its frame."""

    def __init__(self, stage: Stage, topic: str):
        super().__init__(stage, topic, reader_of(PoseStamped))
        self._axes: Any = None

    def show(self, message: Any) -> None:  # noqa: D102
        place, turn = message.pose.position, message.pose.orientation
        values = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
        if not all(map(math.isfinite, values)) or not any(values[3:]):
            return
        pose = self.stage.where(message.header.frame_id) * Pose(values[:3], values[3:])
        if self._axes is None:
            self._axes = self.stage.scene.add_frame(
                self.node, axes_length=AXES_LENGTH, axes_radius=AXES_RADIUS
            )
        self._axes.position, self._axes.wxyz = pose.position, wxyz(pose)

    def hide(self) -> None:  # noqa: D102
        if self._axes is not None:
            self._axes.remove()
            self._axes = None


def _cloud(stage: Stage, name: str, colour: Vector, size: float) -> Shown:
    """Return points of a size in m, in a node of a name."""
    return Shown(
        lambda points: stage.scene.add_point_cloud(
            name,
            points,
            rgb(colour),
            point_size=size,
            point_shape="circle",
            point_shading="flat",
            precision="float32",
        )
    )


def height_of(topic: str) -> float:
    """Return how high above the floor (m) a path is drawn, so that both are seen."""
    return NOISY_HEIGHT if is_noisy(topic) else PERFECT_HEIGHT


def placed(pose: Pose, points: np.ndarray) -> np.ndarray:
    """Return points (n, 3) of a frame as seen from the one that the pose is given in."""
    return points @ pose.rotation_matrix().T + pose.position


@dataclass(frozen=True)
class Kind:
    """Displays that are switched on and off together, by the types of messages that they show."""

    name: str
    displays: Dict[str, Callable[[Stage, str], Any]]
    # Which of the topics of those types, with all that are published by their types.
    wanted: Callable[[str, Dict[str, str]], bool] = lambda topic, others: True
    # Of so many ticks of displays, one is for these.
    every: int = 1


class Displays:
    """The displays of a kind, one for each topic that there is."""

    def __init__(self, kind: Kind, stage: Stage):
        self.kind, self._stage = kind, stage
        self._shown: Dict[str, Any] = {}
        self._failed: Set[str] = set()

    def follow(self, topics: Dict[str, str]) -> None:
        """Show these topics, by their types, as far as they are of the kind; none, if empty."""
        found = {
            topic: self.kind.displays[type_name]
            for topic, type_name in topics.items()
            if type_name in self.kind.displays and self.kind.wanted(topic, topics)
        }
        for topic in set(self._shown) - set(found):
            if not (topics and topic not in topics and self._shown[topic].stays):
                self._shown.pop(topic).close()
        for topic in sorted(set(found) - set(self._shown)):
            self._shown[topic] = found[topic](self._stage, topic)

    def tick(self) -> None:
        """Show what has come."""
        for topic, display in self._shown.items():
            try:
                display.tick()
            except LabError as error:
                # Once each: what cannot be shown comes again and again.
                if topic not in self._failed:
                    self._failed.add(topic)
                    LOG.warning("%s: %s", topic, error)

    def close(self) -> None:
        """Show nothing of the kind."""
        self.follow({})

    @property
    def topics(self) -> List[str]:
        """Those that are shown."""
        return sorted(self._shown)


def has_no_path(topic: str, others: Iterable[str]) -> bool:
    """Return whether nobody publishes the path of an odometry's topic, which has its beginning."""
    known = (f"{topic}_path", FLEET_PATHS)
    return not any(other.endswith(known) for other in others)


def closest(options: List[str], endings: Iterable[str]) -> Optional[str]:
    """Return the first option with the first of these endings that there is, else the first."""
    found = (option for ending in endings for option in options if option.endswith(ending))
    return next(found, next(iter(options), None))
