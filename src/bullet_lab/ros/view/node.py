"""The node that shows the world in a browser, and takes commands and goals from there.

It listens on this machine only, to whoever has the URL that it prints; for another machine, the
port is forwarded (`ssh -L 8080:127.0.0.1:8080`). While nobody looks, it subscribes to nothing.

:ROS Parameters: see `ViewParameters`.
:ROS Subscribers, while somebody looks: /tf, /tf_static, /clock, and every topic of a type that
    there is a display for (see `show.KINDS`)
:ROS Publishers, from the first command or goal on:
    - the topic of geometry_msgs/Twist that is chosen on the page; zero once it is let go
    - move_base_simple/goal (geometry_msgs/PoseStamped) in the namespace of that, or move_base/goal
      (move_base_msgs/MoveBaseActionGoal) where that alone is listened to
"""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass
from typing import Any, Dict, List, Optional

import rospy

from bullet_lab.core import parameters
from bullet_lab.core.pose import Pose
from bullet_lab.ros.node.node import ignore_clock, private_parameters, run_node
from bullet_lab.ros.view.driver import Driver
from bullet_lab.ros.view.panel import Panel, TabControls
from bullet_lab.ros.view.show import OFF_AT_FIRST, SWITCHES, Show
from bullet_lab.view.pad import Wheel
from bullet_lab.view.page import Page
from bullet_lab.view.scene import floor_point

# Wall seconds for which a page may be reloaded before all that is shown is given up.
LINGER_SECONDS = 2.0
# And between the first page and the simulation that waits for it: a page has much to take in.
FIRST_SIGHT_SECONDS = 1.5
# For so long after the first page, it is turned to the robot as soon as that is there.
LOOK_FOR_SECONDS = 15.0
CAMERA_FROM, GRID_SIZE = (-2.5, -2.5, 2.5), 40.0


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


class View:
    """The page, and what happens while somebody looks at it."""

    def __init__(self, given: ViewParameters):
        self._given = given
        self._driver = Driver()
        # By the number of viser's client, in their order.
        self._tabs: Dict[int, TabControls] = {}
        self._wheel = Wheel(lambda tab, shares: self._driver.drive(self._controls(tab), shares))
        self._page = Page(given.port, self._wheel)
        server = self._page.server
        self._panel = Panel(server.gui, SWITCHES, OFF_AT_FIRST)
        self._show: Optional[Show] = None
        self._somebody = threading.Event()
        self._holds = given.unpause
        rospy.on_shutdown(self._driver.stop)
        rospy.on_shutdown(self._somebody.set)
        server.initial_camera.position = CAMERA_FROM
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.world_axes.visible = False
        server.scene.add_grid("/grid", GRID_SIZE, GRID_SIZE, cell_size=1.0, section_size=5.0)
        server.scene.on_click()(self._send_goal)
        self._page.on_connect(self._open)
        server.on_client_disconnect(self._close)
        # Whoever has the URL can drive: rosout and its log are for all.
        print(f"the view is at {self._page.url}", flush=True)
        if self._holds:
            rospy.loginfo("simulated time begins when it is opened")

    def run(self) -> None:
        """Serve until ROS shuts down."""
        while not rospy.is_shutdown():
            self._somebody.wait()
            self._somebody.clear()
            if not rospy.is_shutdown():
                self._show_to_somebody()
        self._page.close()

    def _open(self, tab: str, client: Any) -> None:
        given = self._given
        controls = TabControls(client.gui, tab, given.speed, given.turn_rate)
        self._tabs[client.client_id] = controls
        self._somebody.set()

    def _close(self, client: Any) -> None:
        self._tabs.pop(client.client_id, None)

    def _controls(self, tab: str) -> Optional[TabControls]:
        """Return the controls of a tab; those that it has opened last, if it has come again."""
        return next((one for one in reversed(self._open_tabs()) if one.tab == tab), None)

    def _open_tabs(self) -> List[TabControls]:
        return list(self._tabs.values())

    def _show_to_somebody(self) -> None:
        server, given = self._page.server, self._given
        self._show = Show(server.scene, self._panel, self._open_tabs, given.frame, given.image_rate)
        due = gone = time.monotonic()
        go_on, looks_for = due + FIRST_SIGHT_SECONDS, due + LOOK_FOR_SECONDS
        while not rospy.is_shutdown():
            if server.get_clients():
                gone = time.monotonic() + LINGER_SECONDS
            elif time.monotonic() > gone:
                break
            with server.atomic():
                self._show.tick()
            if looks_for > time.monotonic():
                looks_for = self._look_at_robot(looks_for)
            if self._holds and time.monotonic() > go_on:
                go_on = time.monotonic() + FIRST_SIGHT_SECONDS
                self._holds = not self._panel.go_on()
            due = max(due + 1.0 / self._given.rate, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
        self._show.close()
        self._show = None

    def _look_at_robot(self, until: float) -> float:
        """Turn all eyes to the robot; return until when it is to be looked for, wall seconds."""
        places = (self._show.place(tab.drive_topic) for tab in self._open_tabs())
        place = next((place for place in places if place is not None), None)
        if place is None:
            return until
        x, y, _ = place.position
        seen_from = (x + CAMERA_FROM[0], y + CAMERA_FROM[1], CAMERA_FROM[2])
        server = self._page.server
        for who in (server.initial_camera, *(c.camera for c in server.get_clients().values())):
            who.position, who.look_at = seen_from, (x, y, 0.0)
        return 0.0

    def _send_goal(self, event: Any) -> None:
        show, point = self._show, floor_point(event.ray_origin, event.ray_direction)
        if show is None or point is None:
            return
        controls = self._tabs.get(event.client_id)
        if controls is None:
            return
        if not self._wheel.claim(controls.tab):
            controls.say("another page drives: take over by a click on the pad first")
            return
        topic = controls.drive_topic
        pose = Pose.from_rpy((*point, 0.0), (0.0, 0.0, show.heading_to(topic, point)))
        controls.say(self._driver.send_goal(topic, show.graph.heard, show.stage.fixed, pose))


def main() -> None:
    """Run the node."""
    run_view("view")


def window() -> None:
    """Run the node in the place of gzclient, Gazebo's window."""
    run_view("gazebo_gui")


def run_view(name: str) -> None:
    """Run the node by a name."""

    def body() -> None:
        given = private_parameters(ViewParameters)
        ignore_clock()
        # The simulator has said what is wrong with the world.
        logging.getLogger("bullet_lab.simulation").setLevel(logging.ERROR)
        View(given).run()

    run_node(name, body)
