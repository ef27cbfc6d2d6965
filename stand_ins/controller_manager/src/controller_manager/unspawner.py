"""unspawner CONTROLLER ...: keeps controllers stopped until it ends, then starts them again.

:ROS Service clients: controller_manager/list_controllers, switch_controller
"""

from __future__ import annotations

import contextlib
import sys
import time
from typing import Set

import rospy
from controller_manager_msgs.srv import (
    ListControllers,
    SwitchController,
    SwitchControllerRequest,
)

# Wall seconds between two looks at what runs.
LOOK_SECONDS = 3.0
WAIT_SECONDS = 0.1


def main() -> None:
    """Run the node."""
    names = set(rospy.myargv(sys.argv)[1:])
    if not names or names & {"-h", "--help"}:
        print(__doc__.split("\n\n")[0])
        sys.exit(1)
    rospy.init_node("unspawner", anonymous=True)
    for service in ("switch_controller", "list_controllers"):
        rospy.wait_for_service(f"controller_manager/{service}")
    switch = rospy.ServiceProxy("controller_manager/switch_controller", SwitchController)
    listed = rospy.ServiceProxy("controller_manager/list_controllers", ListControllers)
    stopped: Set[str] = set()

    def start_again() -> None:
        with contextlib.suppress(rospy.ServiceException, rospy.ROSException):
            switch(
                start_controllers=sorted(stopped), strictness=SwitchControllerRequest.BEST_EFFORT
            )

    rospy.on_shutdown(start_again)
    next_look = 0.0
    while not rospy.is_shutdown():
        if time.monotonic() >= next_look:
            next_look = time.monotonic() + LOOK_SECONDS
            found = {one.name for one in listed().controller if one.state == "running"} & names
            if found:
                rospy.loginfo("stopping %s", ", ".join(sorted(found)))
                stopped |= found
                switch(
                    stop_controllers=sorted(found),
                    strictness=SwitchControllerRequest.BEST_EFFORT,
                )
        time.sleep(WAIT_SECONDS)
