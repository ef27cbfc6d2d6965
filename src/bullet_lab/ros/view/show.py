"""All that is shown while a page is open: the topics that exist, and a display for each."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any, Callable, Collection

import rosgraph
import rospy
from rosgraph_msgs.msg import Clock as ClockMessage

from bullet_lab.core.pose import Pose
from bullet_lab.ros.gazebo.client import WORLD
from bullet_lab.ros.node.node import MASTER_ERRORS
from bullet_lab.ros.view.displays import (
    CameraDisplay,
    Displays,
    Kind,
    OdometryDisplay,
    PathDisplay,
    PointsDisplay,
    PoseDisplay,
    RangeDisplay,
    ScanDisplay,
    closest,
    has_no_path,
)
from bullet_lab.ros.view.frames import DisplayContext, FramesDisplay
from bullet_lab.ros.view.markers import (
    ContactsDisplay,
    MarkerDisplay,
    MarkersDisplay,
    WorldDisplay,
)
from bullet_lab.ros.view.panel import Panel, TabControls
from bullet_lab.ros.view.robots import Robots
from bullet_lab.ros.view.subscription import Subscription, reader_of

ROBOTS = "Robots"
FRAMES = "Frames"
NAMES = "Names of frames"
POINTS = "Clouds of points"
PATH = "nav_msgs/Path"
KINDS = (
    Kind(
        "World",
        {"visualization_msgs/MarkerArray": WorldDisplay},
        lambda topic, topics: topic == WORLD,
        every=1,
    ),
    Kind(
        "Paths and ellipses",
        {PATH: PathDisplay, "nav_msgs/Odometry": OdometryDisplay},
        lambda topic, topics: topics[topic] == PATH or has_no_path(topic, topics),
        every=6,
    ),
    Kind("Laser", {"sensor_msgs/LaserScan": ScanDisplay}),
    Kind("Range", {"sensor_msgs/Range": RangeDisplay}),
    Kind(POINTS, {"sensor_msgs/PointCloud2": PointsDisplay}, every=6),
    Kind(
        "Contacts",
        {
            "gazebo_msgs/ContactsState": ContactsDisplay,
            "bullet_lab/ContactsState": ContactsDisplay,
        },
    ),
    Kind("Goals and docks", {"geometry_msgs/PoseStamped": PoseDisplay}),
    Kind(
        "Markers",
        {
            "visualization_msgs/MarkerArray": MarkersDisplay,
            "visualization_msgs/Marker": MarkerDisplay,
        },
        lambda topic, topics: topic != WORLD,
    ),
)
SWITCHES = (ROBOTS, *(kind.name for kind in KINDS), FRAMES, NAMES)
# Clouds are the largest messages to the page, and a depth camera renders for each subscriber.
OFF_AT_FIRST = (NAMES, POINTS)
IMAGE = "sensor_msgs/Image"
TWIST = "geometry_msgs/Twist"
# The image that is shown at first: annotated ones come before others.
BEST_IMAGES = ("aruco/image_annotated", "/image_annotated", "rgb/image_raw", "/image_raw")
# Wall seconds between two updates of the list of topics.
UPDATE_SECONDS = 1.0
# One in so many ticks updates the frames.
SLOW = 3


@dataclass(frozen=True)
class Graph:
    """The ROS graph without the view: message types by published and subscribed topics."""

    published: dict[str, str]
    heard: dict[str, str]
    services: list[str]


NO_GRAPH = Graph({}, {}, [])


def read_graph() -> Graph:
    """Return the present graph; an empty one if the master does not answer."""
    own = rospy.get_name()
    master = rosgraph.Master(own)
    try:
        publishers, subscribers, services = master.getSystemState()
        types = dict(master.getTopicTypes())
    except MASTER_ERRORS:
        return NO_GRAPH

    def of_others(listed: list[Any]) -> dict[str, str]:
        return {t: types[t] for t, nodes in listed if t in types and set(nodes) - {own}}

    return Graph(of_others(publishers), of_others(subscribers), [name for name, _ in services])


class Clock:
    """Simulated time and real-time factor, from /clock.

    Attributes:
        seconds: the time; None before the first message.
        speed: the real-time factor between the last two calls of `measure`; NaN before them.
    """

    def __init__(self) -> None:
        self._subscription = Subscription("/clock", reader_of(ClockMessage))
        self._last: tuple[float, float] | None = None
        self.seconds: float | None = None
        self.speed = math.nan

    def tick(self) -> None:
        """Read the time."""
        message = self._subscription.newest()
        if message is not None:
            self.seconds = message.clock.to_sec()

    def measure(self) -> None:
        """Measure the real-time factor since the last call."""
        if self.seconds is None:
            return
        now = time.monotonic()
        if self._last is not None:
            wall, seconds = self._last
            self.speed = max(0.0, (self.seconds - seconds) / (now - wall))
        self._last = (now, self.seconds)

    def close(self) -> None:
        """Unsubscribe."""
        self._subscription.close()


class Show:
    """All that is shown, from the first page that opens to the last one that closes.

    Args:
        scene: viser's.
        panel: controls of all tabs.
        tabs: returns the controls of each open tab.
        frame: that the scene is in; chosen from TF if empty.
        image_rate: camera images per second.

    Attributes:
        context: what displays share.
        graph: the ROS graph.
    """

    def __init__(
        self,
        scene: Any,
        panel: Panel,
        tabs: Callable[[], Collection[TabControls]],
        frame: str,
        image_rate: float,
    ):
        self._panel = panel
        self._tabs = tabs
        self._frame = frame
        self._image_rate = image_rate
        self.context = DisplayContext(scene, fixed=frame or "world")
        self.graph = NO_GRAPH
        self._clock = Clock()
        self._frames = FramesDisplay(self.context)
        self._robots = Robots(self.context)
        self._displays = [Displays(kind, self.context) for kind in KINDS]
        self._cameras: dict[TabControls, CameraDisplay] = {}
        self._ticks = 0
        self._next_update = -math.inf

    def tick(self) -> None:
        """Show new messages."""
        self._frames.read()
        self._clock.tick()
        if time.monotonic() >= self._next_update:
            self._update()
            self._next_update = time.monotonic() + UPDATE_SECONDS
        self._robots.tick()
        self._ticks += 1
        for displays in self._displays:
            if self._ticks % displays.kind.every == 0:
                displays.tick()
        if self._ticks % SLOW == 0:
            self._frames.show(self._panel.is_on(FRAMES), self._panel.is_on(NAMES))
        for tab, camera in list(self._cameras.items()):
            camera.follow(tab.image_topic)
            camera.tick()

    def close(self) -> None:
        """Unsubscribe from all topics, and show nothing."""
        for displays in self._displays:
            displays.follow({})
        self._robots.clear()
        for part in (self._frames, self._clock, *self._cameras.values()):
            part.close()

    def heading_to(self, drive_topic: str, point: tuple[float, float]) -> float:
        """Return the direction, rad, from a robot to a point of the floor."""
        x, y, _ = (self.place(drive_topic) or Pose()).position
        return math.atan2(point[1] - y, point[0] - x)

    def place(self, drive_topic: str) -> Pose | None:
        """Return the pose of the robot with a command topic; None if it is not shown."""
        namespace = drive_topic.rpartition("/")[0].strip("/")
        return self._robots.place_of(namespace)

    def _update(self) -> None:
        """Read the graph, and follow its changes."""
        self.graph = read_graph()
        self._clock.measure()
        self._choose_frame()
        if self._panel.is_on(ROBOTS):
            self._robots.follow()
        else:
            self._robots.clear()
        for displays in self._displays:
            on = self._panel.is_on(displays.kind.name)
            displays.follow(self.graph.published if on else {})
        for world in self._worlds():
            world.leave_out(self._robots.models(world.models()))
        self._follow_tabs()
        self._panel.offer_noise(self.graph.services)
        self._panel.show_time(self._clock.seconds, self._clock.speed, self._notes())

    def _follow_tabs(self) -> None:
        """Offer each tab the topics, and give it a camera."""
        images = sorted(t for t, kind in self.graph.published.items() if kind == IMAGE)
        driven = sorted(t for t, kind in self.graph.heard.items() if kind == TWIST)
        tabs = self._tabs()
        for tab in tabs:
            robot, image = closest(driven, ("/cmd_vel",)), closest(images, BEST_IMAGES)
            tab.offer(driven, robot, images, image)
            if tab not in self._cameras:
                self._cameras[tab] = CameraDisplay(tab.show_image, self._image_rate)
        for closed in set(self._cameras) - set(tabs):
            self._cameras.pop(closed).close()

    def _notes(self) -> list[str]:
        assumed = sorted(self.context.assumed)
        self.context.assumed.clear()
        fixed = self.context.fixed
        return [f"{name} is taken for {fixed}: TF does not connect them" for name in assumed]

    def _worlds(self) -> list[WorldDisplay]:
        """Return the display of the world, if it is shown."""
        return list(self._displays[0].shown.values())

    def _choose_frame(self) -> None:
        """Choose the frame of the scene: the parameter, else the world's, else the largest tree's.

        The frame is kept while it exists.
        """
        frames = set().union(*(world.frames() for world in self._worlds()))
        roots = self.context.frames.roots()
        if not self._frame and self.context.fixed not in (*frames, *roots):
            self.context.fixed = next(iter([*sorted(frames), *roots]), self.context.fixed)
