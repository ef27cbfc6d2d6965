"""One line about the plugins of a model that are not simulated, with the physics that they need."""

from __future__ import annotations

import re
from collections import Counter
from typing import Iterable, Sequence

from bullet_lab.simulation.plugins import Plugin, Sensor
from bullet_lab.simulation.world.description import PluginTag

# The physics that plugins need, with a pattern of their files.
PHYSICS = {
    "thrust of propellers": "rotors_.*motor|multirotor|quadrotor_(propulsion|simple)|ardupilot",
    "lift and drag in air": "liftdrag|quadrotor_aerodynamics|fw_dynamics|parachute",
    "wind": "wind",
    "buoyancy and drag of water": "buoyancy|underwater_object|hydrodynamic|usv_dynamics",
    "thrusters and fins": "thruster|fin_plugin",
    "slip of wheels": "wheel_?slip",
    "tracks": "track(ed)?_?vehicle",
    "a harness": "harness",
    "grasping": "gripper|grasp|vacuum|sticky",
    "a framework of its own for joints": "fetch_gazebo|ros_controller_manager|baxter_gazebo",
    "motion of an obstacle (docs/plugins/path.md has one)": "obstacle",
}


def missing_physics(files: Iterable[str]) -> list[str]:
    """Return the physics that the plugins of some files need and that is not simulated.

    >>> missing_physics(["libLiftDragPlugin.so", "librotors_gazebo_motor_model.so"])
    ['thrust of propellers', 'lift and drag in air']
    """
    names = " ".join(files).lower()
    return [need for need, pattern in PHYSICS.items() if re.search(pattern, names)]


def skipped_line(model: str, tags: Sequence[PluginTag], others: Iterable[Plugin]) -> str:
    """Return the warning about skipped plugins of a model that has others."""
    files = Counter(tag.filename for tag in tags)
    what = f"plugin '{tags[0].name}' ({tags[0].filename}) is not simulated and skipped"
    if len(tags) > 1:
        counted = (f"{count} {name}" if count > 1 else name for name, count in files.items())
        what = f"{len(tags)} plugins are not simulated and skipped ({', '.join(counted)})"
    needs = missing_physics(files)
    drives = any(plugin.acts and not isinstance(plugin, Sensor) for plugin in others)
    missing = f"; missing: {', '.join(needs)}" if needs else ""
    idle = "" if drives else "; no other plugin moves the model"
    return f"model '{model}': {what}{missing}{idle}"
