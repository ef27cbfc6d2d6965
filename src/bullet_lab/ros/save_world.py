"""Has the bridge write the running world to an SDF file: rosrun bullet_lab save_world.py FILE.

:ROS Service clients: /bullet_lab/save_world (bullet_lab/SaveWorld)
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Sequence

import rospy

from bullet_lab.ros.gazebo_client import call
from bullet_lab.ros.node import NodeError, run_node
from bullet_lab.srv import SaveWorld

SERVICE = "/bullet_lab/save_world"


def save_world(arguments: Sequence[str]) -> str:
    """Save the world and return a line that says what was saved; raises LabError."""
    if len(arguments) != 1:
        raise NodeError("usage: save_world.py FILE")
    # Relative to where the user is, not to where the bridge runs.
    path = Path(arguments[0]).expanduser().absolute()
    saved = call(SERVICE, SaveWorld, str(path))
    line = f"{saved.models} models at {saved.saved_at.to_sec():g} s saved to {saved.path}"
    return f"{line} in {saved.seconds:.3f} s"


def main() -> None:
    """Run the node."""

    def body() -> None:
        rospy.loginfo("%s", save_world(rospy.myargv(sys.argv)[1:]))

    run_node("save_world", body)
