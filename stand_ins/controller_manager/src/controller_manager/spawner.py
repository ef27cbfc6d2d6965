"""spawner [options] CONTROLLER ...: loads and starts controllers, and takes them down at its end.

A CONTROLLER may be a YAML file: its parameters are set, and all controllers in it are meant.

:ROS Service clients: controller_manager/load_controller, switch_controller, unload_controller
:ROS Subscribers: the topic of --wait-for (std_msgs/Bool)
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from pathlib import Path
from typing import Any, List, Optional, Sequence

import rospy
import yaml
from controller_manager_msgs.srv import (
    LoadController,
    SwitchController,
    SwitchControllerRequest,
    UnloadController,
)
from std_msgs.msg import Bool

SERVICES = ("load_controller", "switch_controller", "unload_controller")
# Wall seconds between two looks for a service.
LOOK_SECONDS = 0.2
# Wall seconds after which it is said that nothing comes on the topic of --wait-for.
PATIENCE = 30.0


def parse_spawner_arguments(words: Sequence[str]) -> argparse.Namespace:
    """Read the arguments, those of ros_control for Noetic, less those of ROS."""
    parser = argparse.ArgumentParser(prog="spawner")
    parser.add_argument("--stopped", action="store_true", help="load, and do not start")
    parser.add_argument("--wait-for", metavar="TOPIC", help="begin when it says True (Bool)")
    parser.add_argument("--namespace", metavar="NS", default="", help="of the controller manager")
    parser.add_argument(
        "--timeout", metavar="S", type=float, default=30.0, help="for its services; 0: for ever"
    )
    parser.add_argument("--no-timeout", action="store_true", help="the same as --timeout 0")
    parser.add_argument("--shutdown-timeout", help="passed over")
    parser.add_argument("controllers", metavar="CONTROLLER", nargs="+")
    told = parser.parse_args(words)
    if told.no_timeout or told.timeout <= 0.0:
        told.timeout = None
    if told.namespace and not told.namespace.endswith("/"):
        told.namespace += "/"
    return told


class Spawner:
    """Controllers that are loaded while this process runs."""

    def __init__(self, namespace: str):
        self._namespace = namespace
        self._loaded: List[str] = []

    def wait(self, seconds: Optional[float]) -> bool:
        """Wait in wall time for the services; return whether they are there.

        Before the simulated time is there, the clock of the waiting stands still.
        """
        end = None if seconds is None else time.monotonic() + seconds
        for name in SERVICES:
            service = f"{self._namespace}controller_manager/{name}"
            rospy.loginfo("waiting for %s", service)
            while not _is_there(service):
                waits_for_clock = rospy.get_param("/use_sim_time", False) and not rospy.get_time()
                if waits_for_clock and seconds is not None:
                    end = time.monotonic() + seconds
                elif end is not None and time.monotonic() > end:
                    rospy.logwarn("there is no %s", service)
                    return False
        return True

    def load(self, names: Sequence[str]) -> None:
        """Load controllers, those that can be."""
        for name in names:
            if self._call("load_controller", LoadController, name).ok:
                self._loaded.append(name)
            else:
                rospy.logerr("Failed to load %s", name)
        rospy.loginfo("loaded: %s", ", ".join(self._loaded))

    def start(self) -> None:
        """Start all that are loaded."""
        strict = SwitchControllerRequest.STRICT
        done = self._call("switch_controller", SwitchController, self._loaded, [], strict, False, 0)
        if done.ok:
            rospy.loginfo("started: %s", ", ".join(self._loaded))
        else:
            rospy.logerr("Failed to start %s", ", ".join(self._loaded))

    def end(self) -> None:
        """Stop and unload what was loaded, where the simulation is there still."""
        effort = SwitchControllerRequest.BEST_EFFORT
        try:
            self._call("switch_controller", SwitchController, [], self._loaded, effort, False, 0)
            for name in reversed(self._loaded):
                self._call("unload_controller", UnloadController, name)
        except (rospy.ServiceException, rospy.ROSException) as error:
            rospy.logwarn("controllers not taken down: %s", error)

    def _call(self, name: str, kind: Any, *wanted: Any) -> Any:
        service = f"{self._namespace}controller_manager/{name}"
        return rospy.ServiceProxy(service, kind)(*wanted)


def _is_there(service: str) -> bool:
    if rospy.is_shutdown():
        raise rospy.ROSInterruptException("shutdown")
    try:
        rospy.wait_for_service(service, LOOK_SECONDS)
        return True
    except rospy.ROSInterruptException:
        raise
    except rospy.ROSException:
        return False


def controllers_in(words: Sequence[str]) -> List[str]:
    """Return the names of controllers; the parameters in files are set."""
    names: List[str] = []
    for word in words:
        if Path(word).is_file():
            told = yaml.safe_load(Path(word).read_text())
            for name, parameters in told.items():
                rospy.set_param(name, parameters)
                names.append(name)
        else:
            names.append(word)
    return names


def wait_for_true(topic: str) -> None:
    """Wait until a topic says True; raises ROSInterruptException if ROS shuts down first."""
    come = threading.Event()

    def hear(message: Bool) -> None:
        if message.data:
            come.set()

    subscriber = rospy.Subscriber(topic, Bool, hear)
    report = time.monotonic() + PATIENCE
    while not come.wait(LOOK_SECONDS):
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException("shutdown")
        if time.monotonic() > report:
            report = time.monotonic() + PATIENCE
            rospy.logwarn("%s has not said True yet", topic)
    subscriber.unregister()


def main() -> None:
    """Run the node."""
    arguments = parse_spawner_arguments(rospy.myargv(sys.argv)[1:])
    rospy.init_node("spawner", anonymous=True)
    spawner = Spawner(arguments.namespace)
    try:
        if not spawner.wait(arguments.timeout):
            return
        if arguments.wait_for:
            wait_for_true(arguments.wait_for)
        rospy.on_shutdown(spawner.end)
        spawner.load(controllers_in(arguments.controllers))
        if not arguments.stopped:
            spawner.start()
        rospy.spin()
    except (rospy.ROSInterruptException, rospy.ServiceException) as error:
        if not rospy.is_shutdown():
            raise error
