"""The node that shows the world in a browser, and publishes the user's commands and goals.

It serves the page on this machine only, at the URL that it prints; from another machine, forward
the port (`ssh -L 8080:127.0.0.1:8080`). While no page is open, it subscribes to nothing.

:ROS Parameters: see `ViewParameters`.
:ROS Subscribers, while a page is open: /tf, /tf_static, /clock, and every topic of a type with a
    display (see `show.KINDS`)
:ROS Publishers, from the first command or goal on:
    - the topic of geometry_msgs/Twist that is chosen on the page; zero when the user lets go
    - move_base_simple/goal (geometry_msgs/PoseStamped) in its namespace, or move_base/goal
      (move_base_msgs/MoveBaseActionGoal) if only that has a subscriber
"""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass
from typing import Any

import rospy

from bullet_lab.core import parameters
from bullet_lab.core.pose import Pose
from bullet_lab.ros.node.node import SIGNAL_CHECK_SECONDS, ignore_clock, node
from bullet_lab.ros.view.pad import DriverSeat
from bullet_lab.ros.view.page import Page
from bullet_lab.ros.view.panel import Driver, Panel, TabControls
from bullet_lab.ros.view.scene import floor_point
from bullet_lab.ros.view.show import OFF_AT_FIRST, SWITCHES, Show

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


class ViewNode:
    """The page, and all that is shown while it is open."""

    def __init__(self, given: ViewParameters):
        self._given = given
        self._driver = Driver()
        # By the id of viser's client, in the order in which they were opened.
        self._tabs: dict[int, TabControls] = {}
        self._seat = DriverSeat(lambda tab, shares: self._driver.drive(self._controls(tab), shares))
        self._page = Page(given.port, self._seat)
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
        server, given = self._page.server, self._given
        self._show = Show(server.scene, self._panel, self._open_tabs, given.frame, given.image_rate)
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
        if not self._seat.claim(controls.tab):
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
