"""The node that shows the world in a browser, and publishes the user's commands and goals.

It serves the page on this machine only, at the URL that it prints; from another machine, forward
the port (`ssh -L 8080:127.0.0.1:8080`). While no page is open, it subscribes to nothing.

:ROS Parameters: see `ViewParameters`.
:ROS Subscribers, while a page is open: /tf, /tf_static, /clock, and every topic of a type with a
    display (see `KINDS`)
:ROS Publishers, from the first command or goal on:
    - the topic of geometry_msgs/Twist that is chosen on the page; zero when the user lets go
    - move_base_simple/goal (geometry_msgs/PoseStamped) in its namespace, or move_base/goal
      (move_base_msgs/MoveBaseActionGoal) if only that has a subscriber
"""

from __future__ import annotations

import logging
import math
import threading
import time
from dataclasses import dataclass
from typing import Any, Callable, Collection

import rosgraph
import rospy
from rosgraph_msgs.msg import Clock as ClockMessage

from bullet_lab.core import parameters
from bullet_lab.core.pose import Pose
from bullet_lab.ros.gazebo.client import WORLD
from bullet_lab.ros.node.node import MASTER_ERRORS, SIGNAL_CHECK_SECONDS, ignore_clock, node
from bullet_lab.ros.view.context import DisplayContext, Subscription, reader_of
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
from bullet_lab.ros.view.markers import (
    ContactsDisplay,
    MarkerDisplay,
    MarkersDisplay,
    WorldDisplay,
)
from bullet_lab.ros.view.page import Page
from bullet_lab.ros.view.panel import Driver, Panel, TabControls
from bullet_lab.ros.view.robots import FramesDisplay, Robots
from bullet_lab.ros.view.scene import floor_point

# Wall seconds in which a page may be reloaded before the node unsubscribes.
LINGER_SECONDS = 2.0
# Wall seconds between the first page and the start of simulated time: the page loads the world.
LOADING_SECONDS = 1.5
# Wall seconds after the first page in which the cameras turn to the robot once it appears.
SEARCH_SECONDS = 15.0
# m from the point that the camera looks at.
CAMERA_OFFSET = (-2.5, -2.5, 2.5)
# m.
GRID_SIZE = 40.0
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
class ViewParameters:
    """Private parameters of view."""

    port: int = parameters.integer(
        8080, "port of the page on this machine; the next free one, if it is taken", 1024, 65535
    )
    frame: str = parameters.text("", "frame that all is seen in; if empty, world or the robots'")
    rate: float = parameters.number(30.0, "pictures per second", minimum=1.0, maximum=60.0)
    image_rate: float = parameters.number(10.0, "camera images per second", 0.5, maximum=30.0)
    speed: float = parameters.number(0.4, "m/s at first that the pad drives at", 0.05, maximum=2.0)
    turn_rate: float = parameters.number(
        1.0, "rad/s at first that the pad turns at", 0.1, maximum=3.0
    )
    unpause: bool = parameters.boolean(
        False, "let a simulation that starts paused go on as somebody looks"
    )


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
    """Simulated time and real-time factor, from /clock."""

    def __init__(self) -> None:
        self._subscription = Subscription("/clock", reader_of(ClockMessage))
        # Wall time and simulated time.
        self._last: tuple[float, float] | None = None

    def read(self) -> tuple[float | None, float]:
        """Return simulated seconds, and the real-time factor since the last call.

        Without a message so far, they are None and NaN; at first, the factor is NaN.
        """
        message, now, before = self._subscription.newest(), time.monotonic(), self._last
        if message is not None:
            self._last = (now, message.clock.to_sec())
        elif before is not None:
            self._last = (now, before[1])
        if self._last is None:
            return None, math.nan
        seconds = self._last[1]
        if before is None:
            return seconds, math.nan
        return seconds, max(0.0, (seconds - before[1]) / (now - before[0]))

    def close(self) -> None:
        """Unsubscribe."""
        self._subscription.close()


class Show:
    """All that is shown, from the first page that opens to the last one that closes.

    `panel` has the controls of all tabs, and `tabs` returns those of each open one.
    """

    def __init__(
        self,
        scene: Any,
        panel: Panel,
        tabs: Callable[[], Collection[TabControls]],
        given: ViewParameters,
    ):
        self._panel, self._tabs, self._given = panel, tabs, given
        self.context = DisplayContext(scene, fixed=given.frame or "world")
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
        self._panel.show_time(*self._clock.read(), self._notes())

    def _follow_tabs(self) -> None:
        """Offer each tab the topics, and give it a camera."""
        images = sorted(t for t, kind in self.graph.published.items() if kind == IMAGE)
        driven = sorted(t for t, kind in self.graph.heard.items() if kind == TWIST)
        tabs = self._tabs()
        for tab in tabs:
            robot, image = closest(driven, ("/cmd_vel",)), closest(images, BEST_IMAGES)
            tab.offer(driven, robot, images, image)
            if tab not in self._cameras:
                self._cameras[tab] = CameraDisplay(tab.show_image, self._given.image_rate)
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
        if not self._given.frame and self.context.fixed not in (*frames, *roots):
            self.context.fixed = next(iter([*sorted(frames), *roots]), self.context.fixed)


class ViewNode:
    """The page, and all that is shown while it is open."""

    def __init__(self, given: ViewParameters):
        self._given = given
        # By the id of viser's client, in the order in which they were opened.
        self._tabs: dict[int, TabControls] = {}
        self._driver = Driver(self._controls)
        self._page = Page(given.port, self._driver)
        server = self._page.server
        self._panel = Panel(server.gui, SWITCHES, OFF_AT_FIRST)
        self._show: Show | None = None
        self._opened = threading.Event()
        self._is_paused = given.unpause
        rospy.on_shutdown(self._driver.stop)
        rospy.on_shutdown(self._opened.set)
        server.initial_camera.position = CAMERA_OFFSET
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.world_axes.visible = False
        server.scene.add_grid("/grid", GRID_SIZE, GRID_SIZE, cell_size=1.0, section_size=5.0)
        server.scene.on_click()(self._send_goal)
        self._page.on_connect(self._open)
        server.on_client_disconnect(self._close)
        # All who have the URL can drive, so it is not logged to rosout, which all can read.
        print(f"the view is at {self._page.url}", flush=True)
        if self._is_paused:
            rospy.loginfo("simulated time begins when it is opened")

    def run(self) -> None:
        """Serve until ROS shuts down."""
        while not rospy.is_shutdown():
            if self._opened.wait(SIGNAL_CHECK_SECONDS) and not rospy.is_shutdown():
                self._opened.clear()
                self._show_until_closed()
        self._page.close()

    def _open(self, tab: str, client: Any) -> None:
        given = self._given
        controls = TabControls(client.gui, tab, given.speed, given.turn_rate)
        self._tabs[client.client_id] = controls
        self._opened.set()

    def _close(self, client: Any) -> None:
        self._tabs.pop(client.client_id, None)

    def _controls(self, tab: str) -> TabControls | None:
        """Return the controls of a tab; the last ones if it was reloaded."""
        return next((one for one in reversed(self._open_tabs()) if one.tab == tab), None)

    def _open_tabs(self) -> list[TabControls]:
        return list(self._tabs.values())

    def _show_until_closed(self) -> None:
        server = self._page.server
        self._show = Show(server.scene, self._panel, self._open_tabs, self._given)
        due = time.monotonic()
        end = due
        start = due + LOADING_SECONDS
        search_end = due + SEARCH_SECONDS
        while not rospy.is_shutdown():
            if server.get_clients():
                end = time.monotonic() + LINGER_SECONDS
            elif time.monotonic() > end:
                break
            with server.atomic():
                self._show.tick()
            if search_end > time.monotonic() and self._turn_to_robot():
                search_end = 0.0
            if self._is_paused and time.monotonic() > start:
                start = time.monotonic() + LOADING_SECONDS
                self._is_paused = not self._panel.go_on()
            due = max(due + 1.0 / self._given.rate, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
        self._show.close()
        self._show = None

    def _turn_to_robot(self) -> bool:
        """Turn the cameras of all pages to the robot; return whether there is one."""
        places = (self._show.place(tab.drive_topic) for tab in self._open_tabs())
        place = next((place for place in places if place is not None), None)
        if place is None:
            return False
        x, y, _ = place.position
        seen_from = (x + CAMERA_OFFSET[0], y + CAMERA_OFFSET[1], CAMERA_OFFSET[2])
        server = self._page.server
        cameras = [client.camera for client in server.get_clients().values()]
        for camera in (server.initial_camera, *cameras):
            camera.position = seen_from
            camera.look_at = (x, y, 0.0)
        return True

    def _send_goal(self, event: Any) -> None:
        show, point = self._show, floor_point(event.ray_origin, event.ray_direction)
        if show is None or point is None:
            return
        controls = self._tabs.get(event.client_id)
        if controls is None:
            return
        if not self._driver.claim(controls.tab):
            controls.status.show("another page drives: click on the pad to take over")
            return
        topic = controls.drive_topic
        pose = Pose.from_rpy((*point, 0.0), (0.0, 0.0, show.heading_to(topic, point)))
        frame = show.context.fixed
        controls.status.show(self._driver.send_goal(topic, show.graph.heard, frame, pose))


@node
def view(parameters: ViewParameters) -> None:
    """Run until ROS shuts down."""
    ignore_clock()
    # The simulator has already reported what is wrong with the world.
    logging.getLogger("bullet_lab.simulation").setLevel(logging.ERROR)
    ViewNode(parameters).run()


@node
def gazebo_gui(parameters: ViewParameters) -> None:
    """Run in place of gzclient, Gazebo's window."""
    view.__wrapped__(parameters)
