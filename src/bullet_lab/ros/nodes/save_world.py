"""Writes the running world to an SDF file.

Usage: rosrun bullet_lab save_world.py FILE

:ROS Parameters: see `SaveWorldParameters`.
:ROS Service clients: /bullet_lab/save_world (bullet_lab/SaveWorld),
    /gazebo/get_world_properties (gazebo_msgs/GetWorldProperties)
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import rospy

from bullet_lab.core.files import make_folder, replace_file, write_json
from bullet_lab.core.parameters import integer, number, text
from bullet_lab.ros.gazebo.client import call
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.node.lock_step import time_held_at
from bullet_lab.ros.node.node import NodeError, node, wait_until
from bullet_lab.srv import SaveWorld


@dataclass(frozen=True)
class SaveWorldParameters:
    """Private parameters of save_world."""

    path: str = text("", "file to write; the argument FILE if empty")
    summary: str = text("", "JSON file for figures about it; none if empty")
    models: int = integer(0, "wait until there are this many models", minimum=0)
    at: float = number(0.0, "s; in lock step, the simulated time to save at", minimum=0.0)


@node
def save_world(parameters: SaveWorldParameters) -> None:
    """Save the world; raises LabError."""
    names = [name for name in (parameters.path, *rospy.myargv(sys.argv)[1:]) if name]
    if len(names) != 1:
        raise NodeError("usage: save_world.py FILE")
    # Relative to the working folder of this node, not of the bridge.
    path = Path(names[0]).expanduser().absolute()
    make_folder(path.parent)
    wait_until(lambda: _count() >= parameters.models, f"{parameters.models} models")
    # This node writes the file, as the bridge writes into its own folder only.
    with time_held_at(rospy.Time(parameters.at)):
        saved = call("/bullet_lab/save_world", SaveWorld, str(path), True)
    replace_file(path, lambda part: part.write_text(saved.text, encoding="utf-8"))
    if saved.status_message:
        rospy.logwarn("%s", saved.status_message)
    if parameters.summary:
        figures = {
            "path": saved.path,
            "models": saved.models,
            "simulated_s": saved.saved_at.to_sec(),
            "saving_s": saved.seconds,
            "file_bytes": path.stat().st_size,
        }
        write_json(Path(parameters.summary), figures)
    line = f"{saved.models} models at {saved.saved_at.to_sec():g} s saved to {saved.path}"
    rospy.loginfo("%s in %.3f s", line, saved.seconds)


def _count() -> int:
    return len(call("/gazebo/get_world_properties", srv.GetWorldProperties).model_names)
