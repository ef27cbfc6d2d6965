"""How a robot comes up in a running simulation, and what its parts and topics are.

roslaunch runs the launch file of a user. The ROS master knows the topics and services, the bridge
describes the models.
"""

from __future__ import annotations

import contextlib
import functools
import os
import re
import shlex
import signal
import subprocess
import time
from collections import Counter
from pathlib import Path
from typing import Any, Iterable, Mapping, Sequence

import rosgraph
import rospy
import rosservice
from std_srvs.srv import Empty

from bullet_lab.msg import ModelDescription
from bullet_lab.reports.robot import Robot
from bullet_lab.ros.gazebo.client import call
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.node.node import MASTER_ERRORS, NodeError, check_running
from bullet_lab.srv import DescribeModels, DescribeModelsResponse

# Wall seconds for roslaunch to end its nodes; this node itself has six.
GOODBYE = 5.0
COLOURS = re.compile(r"\x1b(\[[\d;]*m|\][^\x07]*\x07)")
# A line of roslaunch that reports an error.
ERROR = re.compile(r"rror\b|Exception|not found|died")
NOT_LAUNCHED = re.compile(r"cannot launch node of type \[(.+?)/(.+?)\]: (.*)")
DIED = re.compile(r"\[([^][]+)\] process has died .*?(exit code (-?\d+)|without exit code)")
# What Python and C++ write of an exception that ends a program.
EXCEPTION = re.compile(
    r"^(?:Traceback .*\n(?:\s.*\n)*|terminate called .*\n\s+what\(\):\s+)(\S.*)", re.MULTILINE
)
SIGNALS = {str(-one): f", {one.name}" for one in signal.Signals}
# Names of Debian packages with the nodes of a ROS package, the likeliest first.
DEBIAN = ("{}-tools", "lib{}lib-tools", "ros-{}", "ros-noetic-{}", "{}", "python3-{}")
DEBIAN_XML = ("lib{}-dev",)
INSTALLED = Path("/var/lib/dpkg/info")
ROS = re.compile(r"Robot OS|\bROS\b|ros\.org")

SERVICE = "/bullet_lab/describe_models"
VELOCITIES = "geometry_msgs/Twist"
ODOMETRY = "nav_msgs/Odometry"
CONTROLLERS = "/list_controllers"
# Types of messages for programs that change settings.
SETTINGS = "dynamic_reconfigure/"
# Topics of the simulator itself.
OWN_TOPICS = ("/clock", "/rosout", "/tf", "/tf_static", "/gazebo/", "/bullet_lab/")
TOUCHED = "/bullet_lab/touched"
# rad/s or m/s; a joint above it turns.
TURNING = 0.05
# Models that a line names.
MOST_NAMES = 10
# Wall seconds for the simulation to start, and for the robot to be spawned.
SIMULATION = 60.0
ARRIVAL = 120.0
# A launch file has started everything when nothing new came for this many wall seconds; the wait is
# longer without a subscriber to velocities.
SETTLED = 3.0
SETTLED_WITHOUT_DRIVE = 20.0
# Wall seconds between two checks.
CHECK_PERIOD = 0.5


def assignments(words: str) -> list[str]:
    """Split words like name:=value or name=value, and return them as name:=value."""
    return [re.sub("^([^=:]+):?=", r"\1:=", word) for word in shlex.split(words)]


def reason_in(log: str) -> str:
    """Return the line of roslaunch's output that best explains why it has ended."""
    lines = [line.strip() for line in COLOURS.sub("", log).splitlines() if line]
    first = next((n for n, line in enumerate(lines) if ERROR.search(line)), 0)
    # After a colon, the message goes on in the next line.
    last = next((n for n in range(first, len(lines)) if not lines[n].endswith(":")), first)
    return " ".join(lines[first : last + 1]) or "no output"


def failures_in(log: str) -> list[str]:
    """Return a line for each node that could not start or died, from roslaunch's output."""
    log = COLOURS.sub("", log)
    found = []
    for package, name, why in NOT_LAUNCHED.findall(log):
        # The nodes may be there, and the package.xml in another Debian package.
        debian = debian_package(package) or (why == package and debian_package(package, DEBIAN_XML))
        hint = f"; Debian has it: {debian}" if debian else ""
        if why == package:
            why = f"there is no ROS package '{package}'"
            hint = hint or "; Debian has none that is known"
        found.append(f"{package}/{name}: {why}{hint}")
    start = 0
    for died in DIED.finditer(log):
        name, why, status = died.groups()
        # roslaunch shows what a node writes to its standard error.
        last = EXCEPTION.findall(log, start, died.start())[-1:]
        found.append(": ".join((f"{name} has died ({why}{SIGNALS.get(status, '')})", *last)))
        start = died.end()
    counts = Counter(found)
    return [line if n == 1 else f"{line} ({n} times)" for line, n in counts.items()]


@functools.lru_cache
def debian_package(package: str, forms: Sequence[str] = DEBIAN) -> str:
    """Return the Debian package with a ROS package's nodes, by the lists of apt.

    The text is empty if there is none, or if it is installed. `forms` are those of its name.
    """
    full = package.replace("_", "-")
    names = [form.format(name) for form in forms for name in (full, full.replace("-ros", ""))]
    command = ["apt-cache", "show", *names]
    try:
        shown = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL).stdout
    except OSError:
        return ""
    parts = shown.decode(errors="replace").split("Package: ")
    # A name alone is not enough: Debian's package tf is a game.
    known = {part.split(None, 1)[0] for part in parts if ROS.search(part)}
    found = next((name for name in names if name in known), "")
    # Some file names have the architecture after a colon.
    return "" if any(INSTALLED.glob(f"{found}[.:]*list")) else found


class Launched:
    """A roslaunch process that runs a launch file until it is closed; none if `path` is empty."""

    def __init__(self, path: str, arguments: str):
        self.path = path
        self._log = Path(os.environ.get("ROS_LOG_DIR") or ".") / "launch_file.log"
        self._process: subprocess.Popen | None = None
        if path:
            words = ["roslaunch", "--sigint-timeout", "3", "--sigterm-timeout", "1", path]
            words += assignments(arguments)
            with self._log.open("w") as log:
                self._process = subprocess.Popen(words, stdout=log, stderr=subprocess.STDOUT)

    def check(self) -> None:
        """Raise NodeError if it has ended."""
        if self._process is not None and self._process.poll() is not None:
            reason = reason_in(self._output())
            raise NodeError(f"{self.path} has ended, see {self._log}: {reason}")

    def failures(self) -> list[str]:
        """Return a line for each node that could not start or has died."""
        return failures_in(self._output())

    def close(self) -> None:
        """End roslaunch and its nodes."""
        if self._process is not None:
            self._process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(GOODBYE)

    def _output(self) -> str:
        return self._log.read_text(errors="replace") if self.path else ""


class Master:
    """The simulator's topics and all services, as the ROS master knows them at a moment.

    It subscribes to `subscribed` and publishes `published`, both topics with their types.
    """

    def __init__(self):
        master = rosgraph.Master(rospy.get_name())
        try:
            published, subscribed, services = master.getSystemState()
            kinds = dict(master.getTopicTypes())
        except MASTER_ERRORS as error:
            raise NodeError(f"the ROS master does not answer: {error}") from error
        # The simulator is the node that publishes the time.
        simulators = set(dict(published).get("/clock", ()))

        def topics(entries: Iterable[Any]) -> dict[str, str]:
            found = sorted(topic for topic, users in entries if simulators.intersection(users))
            return {
                topic: kinds.get(topic, "*")
                for topic in found
                if not topic.startswith(OWN_TOPICS) and not topic.endswith(TOUCHED)
            }

        self.services = {name for name, _ in services}
        self.subscribed = topics(subscribed)
        self.published = topics(published)


def drives_of(master: Master) -> list[str]:
    """Return the topics with velocities that the simulator subscribes to."""
    return [topic for topic, kind in master.subscribed.items() if kind == VELOCITIES]


def described(name: str = "", with_picture: bool = False) -> DescribeModelsResponse:
    """Return the bridge's description of a model, or of all; raises NodeError."""
    return call(SERVICE, DescribeModels, name, with_picture)


def find_robot(name: str, launched: Launched) -> ModelDescription:
    """Wait for the robot, and until nothing new comes: controllers are loaded after their robot."""
    start = since = time.monotonic()
    models: list[ModelDescription] = []
    found: ModelDescription | None = None
    before: Any = None
    while True:
        launched.check()
        master = Master()
        if SERVICE in master.services:
            models = described().models
        now = (vars(master), [model.name for model in models])
        if now != before:
            since, before = time.monotonic(), now
        quiet = time.monotonic() - since
        waited = time.monotonic() - start
        drives = drives_of(master)
        if found is None and launched.path and choose(models, name, drives, True) is not None:
            with contextlib.suppress(rospy.ServiceException):
                rospy.ServiceProxy("/gazebo/unpause_physics", Empty)()
        found = choose(models, name, drives, quiet > SETTLED_WITHOUT_DRIVE)
        patience = SETTLED if drives else SETTLED_WITHOUT_DRIVE
        if found is not None and (quiet > patience or not launched.path):
            return found
        if waited > SIMULATION and not models and SERVICE not in master.services:
            hint = "a launch file that only spawns the robot needs world:=… beside it"
            raise NodeError(f"no simulation has started within {SIMULATION:g} s; {hint}")
        if waited > ARRIVAL and found is None:
            what = f"no model '{name}'" if name else "no robot"
            raise NodeError(f"{what} was spawned within {ARRIVAL:g} s; {candidates(models)}")
        check_running()
        time.sleep(CHECK_PERIOD)


def choose(
    models: Iterable[ModelDescription],
    name: str,
    drives: Iterable[str],
    of_world_file: bool = False,
) -> ModelDescription | None:
    """Return the model that is the robot; None while there is none.

    Args:
        models: of the world.
        name: of the robot; if empty, models that can be driven come first, then those with
            plugins, then those that move, each in the order of their names.
        drives: the topics with velocities that the simulator subscribes to.
        of_world_file: whether a model of the world file may be chosen if nothing was spawned:
            one that moves and has plugins, if something can be driven.
    """
    if name:
        return next((model for model in models if model.name == name), None)
    found = [model for model in models if not model.of_world_file]
    if of_world_file and drives and not found:
        found = [model for model in models if model.plugins and not model.is_static]

    def rank(model: ModelDescription) -> tuple[bool, bool, bool, str]:
        return not is_drivable(model, drives), not model.plugins, model.is_static, model.name

    return min(found, key=rank, default=None)


def is_drivable(model: ModelDescription, drives: Iterable[str]) -> bool:
    """Return whether a plugin of the model takes velocities."""
    return any(topic in drives for plugin in model.plugins for topic in plugin.inputs)


def candidates(models: Iterable[ModelDescription]) -> str:
    """Return which models the argument `model` may name, those with plugins first."""
    moving = sorted((m for m in models if not m.is_static), key=lambda m: not m.plugins)
    names = ", ".join(model.name for model in moving[:MOST_NAMES])
    return f"model:=NAME takes one of {names}" if names else "no model in the world can move"


def why_it_stands(model: ModelDescription, drive: str, is_connected: bool) -> list[str]:
    """Return known reasons why a robot does not move although velocities are sent to it."""
    if model.is_static:
        return ["the model is static"]
    if not is_connected:
        return [f"nothing listens to {drive}"]
    ask = rospy.ServiceProxy("/gazebo/get_joint_properties", srv.GetJointProperties)
    rates = {joint: ask(f"{model.name}::{joint}").rate for joint in model.joints}
    turning = [joint for joint, rate in rates.items() if rate and abs(rate[0]) > TURNING]
    found = [f"{', '.join(turning) or 'none'} of its joints turn"] if rates else []
    return [*found, f"it stands on {', '.join(model.stands_on) or 'nothing'}"]


def robot_of(
    model: ModelDescription,
    others: Sequence[ModelDescription],
    warnings: Iterable[str],
    master: Master,
) -> Robot:
    """Return the parts of a robot and the topics that it is driven by, beside all other models.

    `warnings` are those of the simulation about all models.
    """
    own, foreign = _topics([model]), _topics(others)
    drives = drives_of(master)
    drive = _nearest(drives, own, foreign, "")
    odometry = ""
    if drive:
        # The odometry of a plugin that drives is its own; that of a controller is no plugin's.
        of_plugin = {t for one in model.plugins if drive in one.inputs for t in one.outputs}
        if drive not in own:
            foreign = foreign | own
        published = [topic for topic, kind in master.published.items() if kind == ODOMETRY]
        odometry = _nearest(published, of_plugin, foreign, drive)
    of_world = [other.name for other in others if other.of_world_file]
    alternatives = [other for other in others if other.of_world_file == model.of_world_file]
    return Robot(
        name=model.name,
        links=tuple(model.links),
        joints=tuple(model.joints),
        plugins=tuple(model.plugins),
        controllers=tuple(controllers(master.services)),
        drive=drive,
        odometry=odometry,
        said=tuple(w for w in warnings if not any(f"'{name}'" in w for name in of_world)),
        choice=tuple(
            sorted(one.name for one in [model, *alternatives] if is_drivable(one, drives))
        ),
    )


def _topics(models: Iterable[ModelDescription]) -> set[str]:
    plugins = [plugin for model in models for plugin in model.plugins]
    return {topic for plugin in plugins for topic in (*plugin.inputs, *plugin.outputs)}


def _nearest(topics: Iterable[str], own: set[str], foreign: set[str], drive: str) -> str:
    """Return the robot's topic: its own, else one of no other model, named like `drive`."""

    def rank(topic: str) -> tuple[bool, int, bool]:
        shared = os.path.commonprefix([topic, drive])
        return topic in own, shared.count("/"), "odom" in topic

    possible = [topic for topic in topics if topic in own or topic not in foreign]
    return max(possible, key=rank, default="")


def topics_of(
    model: ModelDescription, others: Iterable[ModelDescription], published: Mapping[str, str]
) -> dict[str, str]:
    """Return the topics that a robot publishes, of all that are published, with their types.

    Topics that no model's plugin names are those of its controllers.
    """
    foreign = _topics(others) - _topics([model])
    return {
        topic: kind
        for topic, kind in published.items()
        if topic not in foreign and not kind.startswith(SETTINGS)
    }


def controllers(services: Iterable[str]) -> list[Any]:
    """Return the states of the controllers of ros_control that are loaded."""
    found = []
    for name in sorted(name for name in services if name.endswith(CONTROLLERS)):
        try:
            kind = rosservice.get_service_class_by_name(name)
            found += rospy.ServiceProxy(name, kind)().controller
        except (rosservice.ROSServiceException, rospy.ServiceException, OSError) as error:
            rospy.logwarn("%s: %s", name, error)
    return found
