"""The page's controls, and the commands and goals that they publish.

All tabs share the controls of simulated time, noise and displays; each tab has its own for driving
and for the camera. viser calls callbacks in its own threads; only the view's loop changes the
scene. A page may send values that its controls do not offer, so each value is checked when read.
"""

from __future__ import annotations

import html
import math
import threading
from typing import Any, Callable, Collection, Sequence, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped, Twist
from move_base_msgs.msg import MoveBaseActionGoal
from std_srvs.srv import Empty

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.poses import pose_message
from bullet_lab.ros.node.lock_step import COMMAND_TIMEOUT, Publisher
from bullet_lab.srv import SetNoise, SetRtf, Step

GO_ON = "/gazebo/unpause_physics"
SPEED = "/bullet_lab/set_rtf"
SET_NOISE = "set_noise"
# Services with their types and arguments, by the labels of their buttons.
BUTTONS = {
    "Pause": ("/gazebo/pause_physics", Empty),
    "Go on": (GO_ON, Empty),
    # Physics steps of 1 ms.
    "100 ms": ("/bullet_lab/step", Step, 100),
    "Reset": ("/gazebo/reset_world", Empty),
}
AS_STARTED = "as started"
SPEEDS = {"0.25 x": 0.25, "0.5 x": 0.5, "1 x": 1.0, "2 x": 2.0, "5 x": 5.0}
NOBODY = "(nobody listens)"
NOTHING = "(none)"
USUAL_NOISE = 0.1
LARGEST_NOISE = 1.0
# m/s and rad/s.
FASTEST = 2.0
FASTEST_TURN = 3.0
DARK = np.full((120, 160, 3), 40, np.uint8)
# Wall seconds for which a command is valid, from the time that it carries. The robot stops when
# the pad is silent for longer, or the round trip takes longer.
HOLD = 0.4
# The bridge stops the robot unless the next command of the view comes within this time.
COMMAND_HEADERS = {COMMAND_TIMEOUT: str(HOLD)}
SIMPLE_GOAL = "move_base_simple/goal"
ACTION_GOAL = "move_base/goal"

# Shares of the full speed, within [-1, 1]: forward, and turning left.
Shares = Tuple[float, float]
STILL: Shares = (0.0, 0.0)


class Status:
    """A line of text on the page."""

    def __init__(self, gui: Any):
        self._text = gui.add_html("")

    def show(self, text: str) -> None:
        """Show a text in place of the one before."""
        self._text.content = html.escape(text)


class TabControls:
    """Controls of one tab, for driving (m/s, rad/s at full speed) and for the camera."""

    def __init__(self, gui: Any, tab: str, speed: float, turn_rate: float):
        self.tab = tab
        with gui.add_folder("Drive"):
            gui.add_html("Drag the pad, or hold the arrow keys. Click on the floor: a goal.")
            self._robot = gui.add_dropdown("Robot", (NOBODY,))
            self._full = _slider(gui, "m/s", 0.05, FASTEST, speed)
            self._turn = _slider(gui, "rad/s", 0.1, FASTEST_TURN, turn_rate)
            self.status = Status(gui)
        with gui.add_folder("Camera"):
            self._source = gui.add_dropdown("Image", (NOTHING,))
            self._image = gui.add_image(DARK, visible=False, jpeg_quality=80)

    @property
    def drive_topic(self) -> str:
        """Topic of the commands; empty for none."""
        return _chosen(self._robot, NOBODY)

    @property
    def image_topic(self) -> str:
        """Topic of the image; empty for none."""
        return _chosen(self._source, NOTHING)

    def twist(self, shares: Shares) -> Twist:
        """Return the command of shares of the full speeds."""
        twist = Twist()
        twist.linear.x = shares[0] * _within(self._full)
        twist.angular.z = shares[1] * _within(self._turn)
        return twist

    def offer(
        self, driven: list[str], robot: str | None, images: list[str], image: str | None
    ) -> None:
        """Offer topics of commands and of images, with the ones to choose at first."""
        _offer(self._robot, driven, NOBODY, robot)
        _offer(self._source, [*images, NOTHING], NOTHING, image)
        self._image.visible = bool(self.image_topic)

    def show_image(self, pixels: np.ndarray) -> None:
        """Show an image, (h, w, 3) uint8 RGB."""
        self._image.image = pixels


class Panel:
    """The controls that all tabs share; each of `kinds` has a switch, `off` are off at first."""

    def __init__(self, gui: Any, kinds: Sequence[str], off: Sequence[str] = ()):
        self._noise_services: list[str] = []
        with gui.add_folder("Simulation"):
            self._time = gui.add_html("…")
            speed = gui.add_dropdown("Speed", (AS_STARTED, *SPEEDS))
            buttons = gui.add_button_group("Time", tuple(BUTTONS))
            self._status = Status(gui)
        self._noise_folder = gui.add_folder("Noise of the odometry")
        with self._noise_folder:
            self._noise = _slider(gui, "std", 0.0, LARGEST_NOISE, USUAL_NOISE)
        with gui.add_folder("Show", expand_by_default=False):
            self._switches = {name: gui.add_checkbox(name, name not in off) for name in kinds}
        speed.on_update(_by_user(lambda event: self._set_speed(event.target.value)))
        self._noise.on_update(_by_user(lambda event: self._set_noise(_within(event.target))))
        buttons.on_click(lambda event: self._press(event.target.value))

    def is_on(self, kind: str) -> bool:
        """Return whether a kind is to be shown."""
        return self._switches[kind].value

    def go_on(self) -> bool:
        """Unpause the simulation; return whether a simulator has answered."""
        return self._call(GO_ON, Empty)

    def show_time(self, seconds: float | None, speed: float, notes: Sequence[str]) -> None:
        """Show the simulated time, the real-time factor (NaN if unknown), and notes."""
        if seconds is None:
            text = "no simulated time"
        elif math.isnan(speed):
            text = f"{seconds:.2f} s"
        else:
            text = f"{seconds:.2f} s, " + (f"{speed:.2f} x" if speed else "stands still")
        self._time.content = "<br>".join(map(html.escape, [text, *notes]))

    def offer_noise(self, services: Collection[str]) -> None:
        """Offer to change the noise, if one of these services does."""
        found = [name for name in services if name.rpartition("/")[2] == SET_NOISE]
        if found and not self._noise_services:
            # The parameter of the node that offers the service.
            std = rospy.get_param(f"{found[0].rpartition('/')[0]}/std", USUAL_NOISE)
            self._noise.value = float(std) if isinstance(std, (int, float)) else USUAL_NOISE
        self._noise_services = found
        self._noise_folder.visible = bool(found)

    def _press(self, label: str) -> None:
        if label in BUTTONS:
            self._call(*BUTTONS[label])

    def _set_speed(self, label: str) -> None:
        if label in SPEEDS:
            self._call(SPEED, SetRtf, SPEEDS[label])

    def _set_noise(self, std: float) -> None:
        for service in self._noise_services:
            self._call(service, SetNoise, "", std, [])

    def _call(self, service: str, kind: type, *arguments: Any) -> bool:
        """Call a service; return whether it succeeds, and show on the page why it does not."""
        try:
            rospy.wait_for_service(service, 1.0)
            answer = rospy.ServiceProxy(service, kind)(*arguments)
        except rospy.ROSException as error:
            self._status.show(f"{service}: {error}")
            return False
        success = getattr(answer, "success", True)
        self._status.show("" if success else f"{service}: {answer.status_message}")
        return success


def _slider(gui: Any, label: str, least: float, most: float, value: float) -> Any:
    value = min(max(value, least), most)
    return gui.add_slider(label, min=least, max=most, step=0.05, initial_value=value)


def _within(slider: Any) -> float:
    """Return the value of a slider, clipped to its limits."""
    return min(max(slider.value, slider.min), slider.max)


def _chosen(menu: Any, empty: str) -> str:
    """Return the choice in a menu, if the menu offers it; empty if it is the entry for none."""
    return menu.value if menu.value in menu.options and menu.value != empty else ""


def _offer(menu: Any, options: list[str], empty: str, default: str | None) -> None:
    """Set the options of a menu; the choice is kept if it is still an option."""
    options = options or [empty]
    if list(menu.options) == options:
        return
    chosen = menu.value if menu.value in options and menu.value != empty else default
    menu.options = tuple(options)
    menu.value = chosen if chosen in options else options[0]


def _by_user(handle: Callable[[Any], None]) -> Callable[[Any], None]:
    """Return a handler of the events that a user causes, not this program."""

    def handle_user(event: Any) -> None:
        if event.client is not None:
            handle(event)

    return handle_user


class Driver:
    """Publishes the commands of one tab, and goals, on the topics that are chosen there.

    The first tab that asks drives, until it is closed or another one takes over.

    Args:
        controls: returns the controls of a tab; None if it is closed.

    Attributes:
        holder: the tab that drives; None while any tab may.
    """

    def __init__(self, controls: Callable[[str], TabControls | None]):
        self.holder: str | None = None
        self._controls = controls
        self._publishers: dict[tuple[str, type], Publisher] = {}
        self._driven = ""
        self._lock = threading.Lock()

    def claim(self, tab: str) -> bool:
        """Let a tab drive if no other one does; return whether it drives."""
        if self.holder is None:
            self.holder = tab
        return self.holder == tab

    def take_over(self, tab: str) -> None:
        """Let a tab drive; if another one drives, its robot is stopped."""
        if self.holder not in (None, tab):
            self.leave(self.holder)
        self.holder = tab

    def leave(self, tab: str) -> None:
        """If this tab drives, stop its robot and let any tab drive."""
        if tab == self.holder:
            self.stop()
            self.holder = None

    def steer(self, tab: str, shares: Shares) -> None:
        """Drive with shares of a tab's full speeds, if this tab drives; from any thread."""
        if tab == self.holder:
            controls = None if shares == STILL else self._controls(tab)
            if controls is None:
                self.stop()
            else:
                self._drive(controls.drive_topic, controls.twist(shares))

    def stop(self) -> None:
        """Stop the robot that is driven, if one is."""
        self._drive("", Twist())

    def _drive(self, topic: str, twist: Twist) -> None:
        with self._lock:
            if self._driven and self._driven != topic:
                self._publish(self._driven, Twist())
            self._driven = topic
            if topic:
                self._publish(topic, twist)

    def send_goal(self, drive_topic: str, heard: Collection[str], frame: str, pose: Pose) -> str:
        """Send a goal in the namespace of a command topic; return a line about it for the page.

        `heard` are the topics that have subscribers.
        """
        namespace = drive_topic.rpartition("/")[0]
        goal = PoseStamped(pose=pose_message(pose))
        goal.header.frame_id = frame
        action = MoveBaseActionGoal(header=goal.header)
        action.goal.target_pose = goal
        for name, message in ((SIMPLE_GOAL, goal), (ACTION_GOAL, action)):
            topic = f"{namespace}/{name}"
            if topic in heard:
                self._publish(topic, message)
                x, y, _ = pose.position
                return f"goal: ({x:.2f}, {y:.2f}) m"
        return f"nobody listens to {namespace}/{SIMPLE_GOAL}"

    def _publish(self, topic: str, message: Any) -> None:
        key = (topic, type(message))
        if key not in self._publishers:
            # Goals are latched, as the subscriber connects a moment later.
            is_command = isinstance(message, Twist)
            options = {"headers": COMMAND_HEADERS} if is_command else {"latch": True}
            self._publishers[key] = Publisher(topic, type(message), queue_size=10, **options)
        self._publishers[key].publish(message)
