"""What is shown while somebody looks: which topics there are, and what is made of each."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any, Callable, Collection, Dict, FrozenSet, List, Optional, Set, Tuple

import rosgraph
import rospy

from bullet_lab.core.pose import Pose
from bullet_lab.ros.gazebo.client import WORLD
from bullet_lab.ros.node.node import MASTER_ERRORS
from bullet_lab.ros.view import raw
from bullet_lab.ros.view.camera import CameraDisplay
from bullet_lab.ros.view.displays import (
    Displays,
    Kind,
    OdometryDisplay,
    PathDisplay,
    PoseDisplay,
    RangeDisplay,
    ScanDisplay,
    Stage,
    closest,
    has_no_path,
)
from bullet_lab.ros.view.feeds import Feed
from bullet_lab.ros.view.markers import (
    MarkersDisplay,
    WorldDisplay,
    contacts_display,
    single_marker_display,
)
from bullet_lab.ros.view.panel import Panel, TabControls
from bullet_lab.ros.view.points import PointsDisplay
from bullet_lab.ros.view.robots import Robots
from bullet_lab.view.scene import Copies, Labels

WORLD_SHAPES, ROBOTS, FRAMES, NAMES = "World", "Robots", "Frames", "Names of frames"
POINTS = "Clouds of points"
KINDS = (
    Kind(
        "Paths and ellipses",
        {"nav_msgs/Path": PathDisplay, "nav_msgs/Odometry": OdometryDisplay},
        lambda topic, topics: topics[topic] == "nav_msgs/Path" or has_no_path(topic, topics),
        every=2,
    ),
    Kind("Laser", {"sensor_msgs/LaserScan": ScanDisplay}),
    Kind("Range", {"sensor_msgs/Range": RangeDisplay}),
    Kind(POINTS, {"sensor_msgs/PointCloud2": PointsDisplay}, every=2),
    Kind(
        "Contacts",
        dict.fromkeys(("gazebo_msgs/ContactsState", "bullet_lab/ContactsState"), contacts_display),
    ),
    Kind("Goals and docks", {"geometry_msgs/PoseStamped": PoseDisplay}),
    Kind(
        "Markers",
        {
            "visualization_msgs/MarkerArray": MarkersDisplay,
            "visualization_msgs/Marker": single_marker_display,
        },
        lambda topic, topics: topic != WORLD,
    ),
)
SWITCHES = (WORLD_SHAPES, ROBOTS, *(kind.name for kind in KINDS), FRAMES, NAMES)
# A cloud is sent as nothing else that large, and a depth camera draws it for whoever listens.
OFF_AT_FIRST = (NAMES, POINTS)
IMAGE, TWIST = "sensor_msgs/Image", "geometry_msgs/Twist"
# Of several images, the ones with what was found in them come first.
BEST_IMAGES = ("aruco/image_annotated", "/image_annotated", "rgb/image_raw", "/image_raw")
# Wall seconds between two looks at which topics there are.
LOOK_SECONDS = 1.0
# Of every so many ticks, one for what need not be smooth.
SLOW = 3


@dataclass(frozen=True)
class Graph:
    """Which topics there are, and services: the types of those published, and of those heard."""

    published: Dict[str, str]
    heard: Dict[str, str]
    services: List[str]


def look_at_graph() -> Graph:
    """Return what the master knows; nothing, while it does not answer."""
    master = rosgraph.Master(rospy.get_name())
    try:
        publishers, subscribers, services = master.getSystemState()
        types = dict(master.getTopicTypes())
    except MASTER_ERRORS:
        return NOTHING
    own = rospy.get_name()

    def of_others(listed: List[Any]) -> Dict[str, str]:
        return {t: types[t] for t, nodes in listed if t in types and set(nodes) - {own}}

    return Graph(of_others(publishers), of_others(subscribers), [name for name, _ in services])


NOTHING = Graph({}, {}, [])


class Clock:
    """Simulated time, and how fast it goes, as /clock says."""

    def __init__(self) -> None:
        self._feed = Feed("/clock", raw.read_clock)
        self._since: Optional[Tuple[float, float]] = None
        self.seconds: Optional[float] = None
        self.speed = math.nan

    def tick(self) -> None:
        """Look at the time."""
        seconds = self._feed.newest()
        self.seconds = self.seconds if seconds is None else seconds

    def look(self) -> None:
        """Work out the speed since the last look."""
        now = time.monotonic()
        if self.seconds is not None:
            if self._since is not None:
                wall, then = self._since
                self.speed = max(0.0, (self.seconds - then) / (now - wall))
            self._since = (now, self.seconds)

    def close(self) -> None:
        """Listen no longer."""
        self._feed.close()


class Frames:
    """TF, and the axes and names of all frames."""

    def __init__(self, stage: Stage):
        self._stage = stage
        self._feeds = [Feed(t, raw.read_transforms, every=True) for t in ("/tf_static", "/tf")]
        make = lambda arrays: stage.scene.add_batched_axes(  # noqa: E731
            "/frames/axes", axes_length=0.2, axes_radius=0.006, **arrays
        )
        self._axes = Copies(make, ("batched_positions", "batched_wxyzs"))
        self._names = Labels(stage.scene, "/frames/names")

    def read(self) -> None:
        """Take up what has come."""
        for feed in self._feeds:
            for transforms in feed.take():
                for parent, child, pose in transforms:
                    self._stage.frames.put(child, parent, pose)

    def show(self, axes: bool, names: bool) -> None:
        """Show the frames that there are, or do not."""
        frames = self._stage.frames.frames() if axes or names else []
        if not axes:
            self._axes.clear()
        self._names.keep(frames if names else [])
        for frame in frames:
            pose = self._stage.where(frame)
            if axes:
                self._axes.put(frame, pose)
            if names:
                self._names.put(frame, frame, pose.position)
        self._axes.flush()

    def close(self) -> None:
        """Listen no longer, and show nothing."""
        for feed in self._feeds:
            feed.close()
        self.show(axes=False, names=False)
        self._stage.frames.clear()


class Show:
    """What is shown while somebody looks: made when the first one comes, closed after the last.

    Args:
        scene: viser's.
        panel: to tell and to ask.
        tabs: returns the controls of each tab that is open.
        frame: that all is seen in; to be found out, if empty.
        image_rate: images of the camera per second.

    Attributes:
        stage: what the scene is made on.
        graph: the topics that there are.
    """

    def __init__(
        self,
        scene: Any,
        panel: Panel,
        tabs: Callable[[], Collection[TabControls]],
        frame: str,
        image_rate: float,
    ):
        self._panel, self._tabs, self._frame = panel, tabs, frame
        self.stage = Stage(scene, fixed=frame or "world")
        self.graph = NOTHING
        self._clock = Clock()
        self._frames = Frames(self.stage)
        self._world: Optional[WorldDisplay] = None
        self._robots: Optional[Robots] = None
        self._displays = [Displays(kind, self.stage) for kind in KINDS]
        self._image_rate = image_rate
        self._cameras: Dict[TabControls, CameraDisplay] = {}
        self._ticks = 0
        self._next_look = -math.inf

    def tick(self) -> None:
        """Show what has come."""
        self._frames.read()
        self._clock.tick()
        now = time.monotonic()
        if now >= self._next_look:
            self._look()
            self._next_look = time.monotonic() + LOOK_SECONDS
        for part in (self._robots, self._world):
            if part is not None:
                part.tick()
        self._ticks += 1
        if self._ticks % SLOW == 0:
            for displays in self._displays:
                if self._ticks // SLOW % displays.kind.every == 0:
                    displays.tick()
            self._frames.show(self._panel.is_on(FRAMES), self._panel.is_on(NAMES))
        for tab, camera in list(self._cameras.items()):
            camera.follow(tab.image_topic)
            camera.tick()

    def close(self) -> None:
        """Listen to nothing, and show nothing."""
        for displays in self._displays:
            displays.close()
        for part in (self._world, self._frames, self._clock, *self._cameras.values()):
            if part is not None:
                part.close()
        if self._robots is not None:
            self._robots.clear()

    def heading_to(self, drive_topic: str, point: Tuple[float, float]) -> float:
        """Return the direction, rad, that a point of the floor is in from a robot."""
        x, y, _ = (self.place(drive_topic) or Pose()).position
        return math.atan2(point[1] - y, point[0] - x)

    def place(self, drive_topic: str) -> Optional[Pose]:
        """Return where the robot is that is driven on a topic; None while it is not shown."""
        namespace = drive_topic.rpartition("/")[0].strip("/")
        return None if self._robots is None else self._robots.place_of(namespace)

    def _look(self) -> None:
        """Look at what there is, and take it up."""
        self.graph = look_at_graph()
        self._clock.look()
        self._choose_frame()
        self._follow_models()
        for displays in self._displays:
            on = self._panel.is_on(displays.kind.name)
            displays.follow(self.graph.published if on else {})
        self._follow_tabs()
        self._panel.offer_noise(self.graph.services)
        self._panel.tell_time(self._clock.seconds, self._clock.speed, self._notes())

    def _follow_tabs(self) -> None:
        """Offer each tab what there is, and give it a camera."""
        images = sorted(t for t, kind in self.graph.published.items() if kind == IMAGE)
        driven = sorted(t for t, kind in self.graph.heard.items() if kind == TWIST)
        tabs = self._tabs()
        for tab in tabs:
            tab.offer_images(images, closest(images, BEST_IMAGES))
            tab.offer_robots(driven, closest(driven, ("/cmd_vel",)))
            if tab not in self._cameras:
                self._cameras[tab] = CameraDisplay(tab.show_image, self._image_rate)
        for gone in [tab for tab in self._cameras if tab not in tabs]:
            self._cameras.pop(gone).close()

    def _notes(self) -> List[str]:
        guessed = sorted(self.stage.guessed)
        self.stage.guessed.clear()
        return [f"{name} is taken for {self.stage.fixed}: TF has no way" for name in guessed]

    def _follow_models(self) -> None:
        if not self._panel.is_on(ROBOTS):
            if self._robots is not None:
                self._robots.clear()
            self._robots = None
        elif self._robots is None:
            self._robots = Robots(self.stage)
        if self._robots is not None:
            self._robots.follow()
        on = self._panel.is_on(WORLD_SHAPES) and WORLD in self.graph.published
        if self._world is not None and not on:
            self._world.close()
            self._world = None
        elif self._world is None and on:
            self._world = WorldDisplay(self.stage)
        if self._world is not None:
            shown = self._robots
            models: FrozenSet[str] = frozenset()
            if shown is not None:
                models = shown.models(self._world.models())
            self._world.leave_out(models)

    def _choose_frame(self) -> None:
        """See all in the frame that is asked for, else the world's, else TF's largest tree's."""
        frames: Set[str] = set() if self._world is None else self._world.frames()
        roots = self.stage.frames.roots()
        if not self._frame and self.stage.fixed not in (*frames, *roots):
            self.stage.fixed = next(iter([*sorted(frames), *roots]), self.stage.fixed)
