"""Measures models that come and go, and saving a world full of them; run it with scripts/bench.sh.

Prints a table and writes JSON. Starts a ROS master of its own unless one is given.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, List

import psutil
import rospy
from bullet_lab.srv import SaveWorld, Step
from geometry_msgs.msg import Point, Pose, Quaternion
from sensor_msgs.msg import Image

from bullet_lab.ros.launcher.supervision import prepare_master
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.sdf import read_world_file

ROBOTS = {"block": "block_robot", "camera": "camera_robot"}
INCLUDE = '<sdf version="1.6"><include><uri>model://{}</uri></include></sdf>'
BEACON = INCLUDE.format("beacon")
# What comes and goes before each robot: the camera's is to see textures.
PASSING = {"block": BEACON, "camera": INCLUDE.format("marker_panel")}
TIMED_STEPS = 5000
# Simulated time from one image to the next, and a little.
STEPS_PER_IMAGE = 40
WARM_UP = 100


class Bridge:
    """A paused bridge at full speed in a process of its own."""

    def __init__(self, robot: str):
        rospy.set_param("/use_sim_time", False)
        command = ["rosrun", "bullet_lab", "pybullet_bridge.py", "_paused:=true", "_rtf:=0"]
        command.append("_save_folder:=/")
        command.append(f"_robot:=package://bullet_lab/urdf/{ROBOTS[robot]}.urdf")
        self._process = subprocess.Popen(command)
        rospy.wait_for_service("/bullet_lab/advance", 60.0)
        keep = {"persistent": True}
        self.spawn = rospy.ServiceProxy("/gazebo/spawn_sdf_model", srv.SpawnModel, **keep)
        self.delete = rospy.ServiceProxy("/gazebo/delete_model", srv.DeleteModel, **keep)
        self.state = rospy.ServiceProxy("/gazebo/get_model_state", srv.GetModelState, **keep)
        self.step = rospy.ServiceProxy("/bullet_lab/step", Step, **keep)
        self.save = rospy.ServiceProxy("/bullet_lab/save_world", SaveWorld, **keep)

    def megabytes(self) -> float:
        """Return the resident memory of the node."""
        family = [psutil.Process(self._process.pid)]
        family += family[0].children(recursive=True)
        return max(process.memory_info().rss for process in family) / 1e6

    def step_microseconds(self) -> float:
        """Return the wall time of one physics step, the median of five series."""
        times = []
        for _ in range(5):
            start = time.perf_counter()
            self.step(TIMED_STEPS)
            times.append((time.perf_counter() - start) / TIMED_STEPS)
        return 1e6 * statistics.median(times)

    def stop(self) -> None:
        """End it."""
        self._process.terminate()
        self._process.wait(20.0)


def place(number: int) -> Pose:
    """Return the pose of the n-th beacon in a square field, out of the robot's way."""
    row, column = divmod(number, 32)
    return Pose(Point(3.0 + column, row - 16.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))


def come_and_go(bridge: Bridge, model: str, count: int, steps: int) -> List[float]:
    """Spawn and delete one model after another; return the wall time of each, in ms."""
    times = []
    for number in range(count):
        start = time.perf_counter()
        bridge.spawn("passing", model, "", place(number % 64), "")
        bridge.step(steps)
        bridge.delete("passing")
        times.append(1e3 * (time.perf_counter() - start))
    return times


def passing_models(robot: str, count: int) -> Dict[str, float]:
    """Return memory and step time before and after so many models have come and gone."""
    bridge = Bridge(robot)
    steps = 1
    images: List[Any] = []
    if robot == "camera":
        steps = STEPS_PER_IMAGE
        rospy.Subscriber("mycamera/image_raw", Image, lambda message: images.append(message.header))
        while not images:
            bridge.step(STEPS_PER_IMAGE)
    model = PASSING[robot]
    come_and_go(bridge, model, WARM_UP, steps)
    # Series of steps at full speed take buffers for their images, once.
    step_before, before = bridge.step_microseconds(), bridge.megabytes()
    times = come_and_go(bridge, model, count, steps)
    after, step_after = bridge.megabytes(), bridge.step_microseconds()
    bridge.stop()
    return {
        "models": count,
        "megabytes_before": before,
        "megabytes_after": after,
        "step_microseconds_before": step_before,
        "step_microseconds_after": step_after,
        "milliseconds_each": statistics.median(times),
        "images": len(images),
    }


def crowd(count: int, folder: Path) -> Dict[str, float]:
    """Return how long so many models take to be spawned, saved, loaded and deleted."""
    bridge = Bridge("block")
    start = time.perf_counter()
    for number in range(count):
        bridge.spawn(f"beacon_{number}", BEACON, "", place(number), "")
    spawned = time.perf_counter() - start
    bridge.step(100)
    path = folder / "crowd.world"
    saved = [bridge.save(str(path), False).seconds for _ in range(5)]
    error = largest_error(bridge, path)
    start = time.perf_counter()
    for number in range(count):
        bridge.delete(f"beacon_{number}")
    deleted = time.perf_counter() - start
    bridge.stop()
    return {
        "crowd": count,
        "spawn_milliseconds": 1e3 * spawned / count,
        "delete_milliseconds": 1e3 * deleted / count,
        "save_seconds": statistics.median(saved),
        "save_seconds_worst": max(saved),
        "file_megabytes": os.path.getsize(path) / 1e6,
        "largest_error_metres": error,
    }


def largest_error(bridge: Bridge, path: Path) -> float:
    """Return how far any model of a saved world is from where the running one has it, in m."""
    errors = []
    with Simulation(read_world_file(path)) as again:
        for name, instance in again.models.items():
            position = bridge.state(name, "").pose.position
            there = (position.x, position.y, position.z)
            errors.append(math.dist(instance.pose().position, there))
    return max(errors)


def print_table(figures: Dict[str, Any]) -> None:
    """Print what was measured beside what is asked for."""
    rows = []
    for robot in ROBOTS:
        found = figures.get(f"passing_{robot}")
        if found:
            grown = found["megabytes_after"] - found["megabytes_before"]
            before, after = (found[f"step_microseconds_{when}"] for when in ("before", "after"))
            steps = f"{before:.1f} → {after:.1f}"
            title = f"{found['models']} models one after another, {robot} robot"
            rows.append((f"{title}: MB more", f"{grown:.1f}", "<= 5"))
            rows.append((f"{title}: µs a step", steps, "same"))
            rows.append((f"{title}: ms each", f"{found['milliseconds_each']:.1f}", ""))
    found = figures["crowd"]
    title = f"{found['crowd']} models"
    rows.append((f"{title}: spawned, ms each", f"{found['spawn_milliseconds']:.1f}", ""))
    rows.append((f"{title}: saved, s (worst)", f"{found['save_seconds_worst']:.2f}", "< 1"))
    error = f"{found['largest_error_metres']:.1g}"
    rows.append((f"{title}: loaded again, m off", error, "<= 1e-6"))
    rows.append((f"{title}: deleted, ms each", f"{found['delete_milliseconds']:.1f}", ""))
    print(f"\n{'':60} {'measured':>14} {'asked':>8}")
    for name, value, asked in rows:
        print(f"{name:60} {value:>14} {asked:>8}")


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="JSON file to write")
    parser.add_argument("--models", type=int, default=1000)
    parser.add_argument("--camera", action="store_true", help="with a camera that looks on, too")
    wanted = parser.parse_args()
    prepare_master()
    rospy.init_node("bench", disable_signals=True)
    figures: Dict[str, Any] = {"cores": os.cpu_count()}
    for robot in ROBOTS if wanted.camera else ("block",):
        print(f"{wanted.models} models one after another, {robot} robot …")
        figures[f"passing_{robot}"] = passing_models(robot, wanted.models)
    print(f"{wanted.models} models at a time …")
    with tempfile.TemporaryDirectory() as name:
        figures["crowd"] = crowd(wanted.models, Path(name))
    print_table(figures)
    wanted.out.parent.mkdir(parents=True, exist_ok=True)
    wanted.out.write_text(json.dumps(figures, indent=2) + "\n")
    print(f"\nwritten to {wanted.out}")


if __name__ == "__main__":
    main()
