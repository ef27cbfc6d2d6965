"""move_base, by its names and parameters: drive_to_goal with a map.

:ROS Parameters: of those of move_base and its plugins, those in `PLACES`, `footprint` and the
    topic of the first laser among the `observation_sources`; all others are ignored
:Everything else: see `drive_to_goal`. Its own topics are those below drive_to_goal/
"""

from __future__ import annotations

import math
from typing import Any, Callable

import rospy
import yaml

from bullet_lab.core.parameters import ParameterError, read_parameters
from bullet_lab.ros.node.node import run_node
from bullet_lab.ros.nodes.drive_to_goal import DriveToGoal, DriveToGoalParameters

COSTMAPS = ("~global_costmap", "~local_costmap")
FOOTPRINTS = (*COSTMAPS, "~", "~TrajectoryPlannerROS", "~DWAPlannerROS")
# Parameters of drive_to_goal, and the names in the local planner (without a slash) or elsewhere,
# of which the first that is set counts.
PLACES: dict[str, tuple[str, ...]] = {
    "speed": ("max_vel_x", "max_vel_trans", "max_trans_vel"),
    "turn_speed": ("max_vel_theta", "max_rot_vel", "max_rotational_vel"),
    "acceleration": ("acc_lim_x",),
    "turn_acceleration": ("acc_lim_theta", "acc_lim_th"),
    "tolerance": ("xy_goal_tolerance",),
    "yaw_tolerance": ("yaw_goal_tolerance",),
    "odom": ("odom_topic",),
    "rate": ("~controller_frequency",),
    "wait": ("~planner_patience",),
    "inflation": tuple(
        f"{costmap}/{name}"
        for costmap in COSTMAPS
        for name in ("inflation_layer/inflation_radius", "inflation_radius")
    ),
    "radius": tuple(f"{costmap}/robot_radius" for costmap in COSTMAPS),
    "allow_unknown": ("~NavfnROS/allow_unknown", "~GlobalPlanner/allow_unknown"),
}
# move_base's own defaults where those of drive_to_goal are others.
DEFAULTS = {"map": "map", "radius": 0.46, "tolerance": 0.1, "yaw_tolerance": 0.05}
# Commands per second: other controller_frequencies are brought within these.
RATES = (5.0, 100.0)
# A yaw tolerance of more means: any heading.
ANY_YAW = 3.14


def read(get: Callable[[str, Any], Any]) -> DriveToGoalParameters:
    """Return the parameters from those of move_base, by a function such as rospy.get_param.

    Raises:
        ParameterError: a value cannot be used; the line has move_base's name of it.
    """
    planner = str(get("~base_local_planner", "base_local_planner/TrajectoryPlannerROS"))
    planner = "~" + planner.replace("::", "/").split("/")[-1]
    values: dict[str, Any] = dict(DEFAULTS)
    sources: dict[str, str] = {}
    for name, places in PLACES.items():
        for place in places:
            full = place if place.startswith("~") else f"{planner}/{place}"
            value = get(full, None)
            if value is not None:
                values[name], sources[name] = value, full
                break
    for place in FOOTPRINTS:
        footprint = get(f"{place}/footprint".replace("~/", "~"), None)
        if footprint not in (None, "", []):
            values["radius"] = _radius(footprint)
            break
    for costmap in COSTMAPS[::-1]:
        values.update(_scan(get(costmap, {})))
    if isinstance(values["yaw_tolerance"], (int, float)):
        values["heading"] = values["yaw_tolerance"] < ANY_YAW
    if isinstance(values.get("rate"), (int, float)):
        values["rate"] = min(max(values["rate"], RATES[0]), RATES[1])
    try:
        return read_parameters(
            DriveToGoalParameters, lambda name, default: values.get(name[1:], default)
        )
    except ParameterError as error:
        name = str(error).split()[0]
        raise ParameterError(str(error).replace(name, sources.get(name[1:], name), 1)) from error


def _radius(footprint: Any) -> float:
    """Return the radius (m) of the circle in which a footprint turns; raises ParameterError."""
    try:
        points = yaml.safe_load(footprint) if isinstance(footprint, str) else footprint
        radius = max(math.hypot(float(x), float(y)) for x, y in points)
    except (TypeError, ValueError, yaml.YAMLError):
        radius = math.nan
    if not radius > 0.0:
        raise ParameterError(f"footprint is {footprint}: it must be a list of points [x, y]")
    return radius


def _scan(costmap: Any) -> dict[str, str]:
    """Return the topic of the first laser of a costmap, in it or in one of its layers."""
    layers = [costmap, *costmap.values()] if isinstance(costmap, dict) else []
    for layer in (layer for layer in layers if isinstance(layer, dict)):
        for source in str(layer.get("observation_sources", "")).split():
            found = layer.get(source, {})
            if isinstance(found, dict) and found.get("data_type") == "LaserScan":
                return {"scan": str(found.get("topic", source))}
    return {}


def _run() -> None:
    parameters = read(rospy.get_param)
    rospy.loginfo(
        "radius %.2f m, %.2f m/s, %.2f rad/s, scans on %s",
        parameters.radius, parameters.speed, parameters.turn_speed, parameters.scan,
    )
    DriveToGoal(parameters, "drive_to_goal/").run(parameters.rate)


def main() -> None:
    """Run the node."""
    run_node("move_base", _run)
