"""The page's controls: simulated time, noise and what is shown for all; driving and camera for one.

Their callbacks come in threads of viser's. What changes the scene is left to the view's loop. What
a control says is checked where it is read: a page may send what its own controls do not offer.
"""

from __future__ import annotations

import html
import math
from typing import Any, Callable, Collection, List, Optional, Sequence

import numpy as np
import rospy
from std_srvs.srv import Empty

from bullet_lab.srv import SetNoise, SetRtf, Step

PAUSE, GO_ON, RESET = "/gazebo/pause_physics", "/gazebo/unpause_physics", "/gazebo/reset_world"
STEP, SPEED = "/bullet_lab/step", "/bullet_lab/set_rtf"
SET_NOISE = "set_noise"
# Steps of 1 ms of the button.
STEPS, STEP_BUTTON = 100, "100 ms"
AS_STARTED = "as started"
SPEEDS = {"0.25 x": 0.25, "0.5 x": 0.5, "1 x": 1.0, "2 x": 2.0, "5 x": 5.0}
NOBODY, NOTHING = "(nobody listens)", "(none)"
USUAL_NOISE, LARGEST_NOISE, FASTEST, FASTEST_TURN = 0.1, 1.0, 2.0, 3.0
DARK = np.full((120, 160, 3), 40, np.uint8)


class TabControls:
    """Driving and the camera's image, which each tab has for itself.

    Args:
        gui: of viser's client.
        tab: its name.
        speed: full speed forward, m/s.
        turn_rate: full speed of turning, rad/s.
    """

    def __init__(self, gui: Any, tab: str, speed: float, turn_rate: float):
        self.tab = tab
        with gui.add_folder("Drive"):
            gui.add_html("Drag the pad, or hold the arrow keys. Click on the floor: a goal.")
            self._robot = gui.add_dropdown("Robot", (NOBODY,))
            self._full = _slider(gui, "m/s", 0.05, FASTEST, speed)
            self._turn = _slider(gui, "rad/s", 0.1, FASTEST_TURN, turn_rate)
            self._said = gui.add_html("")
        with gui.add_folder("Camera"):
            self._source = gui.add_dropdown("Image", (NOTHING,))
            self._image = gui.add_image(DARK, visible=False, jpeg_quality=80)

    @property
    def drive_topic(self) -> str:
        """Topic of commands that is driven on; empty for none."""
        return _chosen(self._robot, NOBODY)

    @property
    def image_topic(self) -> str:
        """Topic of the image that is shown; empty for none."""
        return _chosen(self._source, NOTHING)

    @property
    def full_speed(self) -> float:
        """Full speed forward, m/s."""
        return _within(self._full)

    @property
    def full_turn_rate(self) -> float:
        """Full speed of turning, rad/s."""
        return _within(self._turn)

    def offer_robots(self, topics: List[str], default: Optional[str]) -> None:
        """Offer topics to drive on."""
        _offer(self._robot, topics, NOBODY, default)

    def offer_images(self, topics: List[str], default: Optional[str]) -> None:
        """Offer images to look at."""
        _offer(self._source, [*topics, NOTHING], NOTHING, default)
        if self._image.visible != bool(self.image_topic):
            self._image.visible = bool(self.image_topic)

    def show_image(self, pixels: np.ndarray) -> None:
        """Show an image, (h, w, 3) uint8 RGB."""
        self._image.image = pixels

    def say(self, text: str) -> None:
        """Tell something, until something else is told."""
        self._said.content = html.escape(text)


class Panel:
    """The controls that all tabs share.

    Args:
        gui: viser's.
        kinds: what can be shown, each switched on or off by its name.
        off: kinds that are not shown at first.
    """

    def __init__(self, gui: Any, kinds: Sequence[str], off: Sequence[str] = ()):
        self._noise_services: List[str] = []
        with gui.add_folder("Simulation"):
            self._time = gui.add_html("…")
            self._speed = gui.add_dropdown("Speed", (AS_STARTED, *SPEEDS))
            self._buttons = gui.add_button_group("Time", ("Pause", "Go on", STEP_BUTTON, "Reset"))
            self._said = gui.add_html("")
        self._noise_folder = gui.add_folder("Noise of the odometry")
        with self._noise_folder:
            self._noise = _slider(gui, "std", 0.0, LARGEST_NOISE, USUAL_NOISE)
        with gui.add_folder("Show", expand_by_default=False):
            self._switches = {name: gui.add_checkbox(name, name not in off) for name in kinds}
        self._listen()

    # What is asked for

    def is_on(self, kind: str) -> bool:
        """Return whether something is to be shown."""
        return self._switches[kind].value

    def go_on(self) -> bool:
        """Let simulated time go on; return whether there was somebody to do so."""
        return self._call(GO_ON, Empty)

    def _listen(self) -> None:
        self._speed.on_update(_of_people(lambda e: self._set_speed(e.target.value)))
        self._noise.on_update(_of_people(lambda e: self._set_noise(_within(e.target))))
        self._buttons.on_click(lambda e: self._press(e.target.value))

    def _press(self, label: str) -> None:
        services = {"Pause": PAUSE, "Go on": GO_ON, "Reset": RESET}
        if label == STEP_BUTTON:
            self._call(STEP, Step, STEPS)
        elif label in services:
            self._call(services[label], Empty)

    def _set_speed(self, label: str) -> None:
        if label in SPEEDS:
            self._call(SPEED, SetRtf, SPEEDS[label])

    def _set_noise(self, std: float) -> None:
        for service in self._noise_services:
            self._call(service, SetNoise, "", std, [])

    def _call(self, service: str, kind: type, *arguments: Any) -> bool:
        """Call a service; say so on the page, and return False, if it answers otherwise."""
        try:
            rospy.wait_for_service(service, 1.0)
            answer = rospy.ServiceProxy(service, kind)(*arguments)
        except rospy.ROSException as error:
            self.say(f"{service}: {error}")
            return False
        success = getattr(answer, "success", True)
        self.say("" if success else f"{service}: {answer.status_message}")
        return success

    # What is told

    def say(self, text: str) -> None:
        """Tell something, until something else is told."""
        self._said.content = html.escape(text)

    def tell_time(self, seconds: Optional[float], speed: float, notes: Sequence[str]) -> None:
        """Tell the simulated time, how fast it goes, and what is to be known besides."""
        if seconds is None:
            told = "no simulated time"
        elif math.isnan(speed):
            told = f"{seconds:.2f} s"
        else:
            told = f"{seconds:.2f} s, " + (f"{speed:.2f} x" if speed else "stands still")
        content = "<br>".join(map(html.escape, [told, *notes]))
        if self._time.content != content:
            self._time.content = content

    def offer_noise(self, services: Collection[str]) -> None:
        """Offer to change the noise, where one of these services does."""
        found = [name for name in services if name.rpartition("/")[2] == SET_NOISE]
        if found and not self._noise_services:
            self._noise.value = _present_noise(found[0])
        self._noise_services = found
        self._noise_folder.visible = bool(found)


def _present_noise(service: str) -> float:
    """Return the noise of the node that offers a service, as far as it was told."""
    std = rospy.get_param(f"{service.rpartition('/')[0]}/std", USUAL_NOISE)
    return float(std) if isinstance(std, (int, float)) else USUAL_NOISE


def _slider(gui: Any, label: str, least: float, most: float, value: float) -> Any:
    value = min(max(value, least), most)
    return gui.add_slider(label, min=least, max=most, step=0.05, initial_value=value)


def _within(slider: Any) -> float:
    """Return what a slider says, within its limits."""
    return min(max(slider.value, slider.min), slider.max)


def _chosen(menu: Any, empty: str) -> str:
    """Return what is chosen in a menu, if it offers that; empty where nothing is."""
    return menu.value if menu.value in menu.options and menu.value != empty else ""


def _offer(menu: Any, options: List[str], empty: str, default: Optional[str]) -> None:
    """Put options into a menu; what is chosen stays, if it can."""
    options = options or [empty]
    if list(menu.options) == options:
        return
    chosen = menu.value if menu.value in options and menu.value != empty else default
    menu.options = tuple(options)
    menu.value = chosen if chosen in options else options[0]


def _of_people(handle: Callable[[Any], None]) -> Callable[[Any], None]:
    """Pass on what somebody has done on the page, and not what this program has set."""

    def pass_on(event: Any) -> None:
        if event.client is not None:
            handle(event)

    return pass_on
