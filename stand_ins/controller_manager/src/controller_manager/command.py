"""controller_manager COMMAND [CONTROLLER ...]: list, load, start, stop and unload controllers."""

from __future__ import annotations

import contextlib
import sys
from typing import Callable, Dict, List, Sequence

import rospy

from controller_manager import controller_manager_interface as interface

USAGE = """Commands:
    load, unload, start, stop NAME …   one after the other
    spawn NAME …                       load and start
    kill NAME …                        stop and unload
    list                               what is loaded
    list-types                         what can be loaded
    reload-libraries [--restore]       unload all; load and start them again"""
STEPS: Dict[str, Sequence[Callable[[str], bool]]] = {
    "load": (interface.load_controller,),
    "unload": (interface.unload_controller,),
    "start": (interface.start_controller,),
    "stop": (interface.stop_controller,),
    "spawn": (interface.load_controller, interface.start_controller),
    "kill": (interface.stop_controller, interface.unload_controller),
}
SHORT = {"lc": "list", "lt": "list-types", "sp": "spawn", "kl": "kill"}


def main() -> None:
    """Run the node; status 0 if it is a command, as ros_control has it."""
    words: List[str] = rospy.myargv(sys.argv)[1:]
    command = SHORT.get(words[0], words[0]) if words else ""
    listings = {"list": interface.list_controllers, "list-types": interface.list_controller_types}
    if command not in (*STEPS, *listings, "reload-libraries"):
        print(USAGE)
        sys.exit(1 if words else 0)
    rospy.init_node("controller_manager", anonymous=True)
    with contextlib.suppress(rospy.ROSInterruptException):
        if command in listings:
            listings[command]()
        elif command == "reload-libraries":
            interface.reload_libraries(True, restore="--restore" in words)
        for step in STEPS.get(command, ()):
            for name in words[1:]:
                step(name)
