"""Measures models that come and go, and saving a world full of them; scripts/bench.sh world.

--models N: so many. --camera: also before a robot with a camera that looks on.
"""

from __future__ import annotations

import math
import os
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, List

import rospy
from common import Bridge, options, print_table, start_ros, write
from lab_nodes import end_all
from sensor_msgs.msg import Image

from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.sdf import read_world_file

# What comes and goes before each robot: the camera's is to see textures.
PASSING = {"block": "beacon", "camera": "marker_panel"}
TIMED_STEPS = 5000
# Simulated time from one image to the next, and a little.
STEPS_PER_IMAGE = 40
WARM_UP = 100


def start(robot: str) -> Bridge:
    """Start a paused bridge at full speed."""
    urdf = f"_robot:=package://bullet_lab/urdf/{robot}_robot.urdf"
    return Bridge("_paused:=true", "_rtf:=0", "_save_folder:=/", urdf)


def step_microseconds(bridge: Bridge) -> float:
    """Return the wall time of one physics step, the median of five series."""
    times = []
    for _ in range(5):
        start = time.perf_counter()
        bridge.step(TIMED_STEPS)
        times.append((time.perf_counter() - start) / TIMED_STEPS)
    return 1e6 * statistics.median(times)


def come_and_go(bridge: Bridge, model: str, count: int, steps: int) -> List[float]:
    """Spawn and delete one model after another; return the wall time of each, in ms."""
    times = []
    for number in range(count):
        start = time.perf_counter()
        bridge.add_model("passing", number % 64, model)
        bridge.step(steps)
        bridge.delete("passing")
        times.append(1e3 * (time.perf_counter() - start))
    return times


def passing_models(robot: str, count: int) -> Dict[str, float]:
    """Return memory and step time before and after so many models have come and gone."""
    bridge = start(robot)
    steps = 1
    images: List[Any] = []
    if robot == "camera":
        steps = STEPS_PER_IMAGE
        rospy.Subscriber("mycamera/image_raw", Image, lambda message: images.append(message.header))
        while not images:
            bridge.step(STEPS_PER_IMAGE)
    come_and_go(bridge, PASSING[robot], WARM_UP, steps)
    # Series of steps at full speed take buffers for their images, once.
    step_before, before = step_microseconds(bridge), bridge.megabytes()
    times = come_and_go(bridge, PASSING[robot], count, steps)
    after, step_after = bridge.megabytes(), step_microseconds(bridge)
    end_all(bridge)
    return {
        "models": count,
        "megabytes_before": before,
        "megabytes_after": after,
        "step_microseconds_before": step_before,
        "step_microseconds_after": step_after,
        "milliseconds_each": statistics.median(times),
        "images": len(images),
    }


def crowd(count: int, path: Path) -> Dict[str, float]:
    """Return how long so many models take to be spawned, saved, loaded and deleted."""
    bridge = start("block")
    start_of_all = time.perf_counter()
    for number in range(count):
        bridge.add_model(f"beacon_{number}", number)
    spawned = time.perf_counter() - start_of_all
    bridge.step(100)
    saved = [bridge.save(str(path), False).seconds for _ in range(5)]
    error = largest_error(bridge, path)
    start_of_end = time.perf_counter()
    for number in range(count):
        bridge.delete(f"beacon_{number}")
    deleted = time.perf_counter() - start_of_end
    end_all(bridge)
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


def main() -> None:
    """Measure, print and write."""
    wanted = options(__doc__, models=1000, camera=False)
    start_ros()
    figures: Dict[str, Any] = {}
    rows = []
    for robot in PASSING if wanted.camera else ("block",):
        print(f"{wanted.models} models one after another, {robot} robot …")
        found = figures[f"passing_{robot}"] = passing_models(robot, wanted.models)
        grown = found["megabytes_after"] - found["megabytes_before"]
        before, after = (found[f"step_microseconds_{when}"] for when in ("before", "after"))
        title = f"{wanted.models} models one after another, {robot} robot"
        rows += [
            (f"{title}: MB more", f"{grown:.1f}", "<= 5"),
            (f"{title}: µs a step", f"{before:.1f} → {after:.1f}", "same"),
            (f"{title}: ms each", f"{found['milliseconds_each']:.1f}", ""),
        ]
    title = f"{wanted.models} models at a time"
    print(f"{title} …")
    with tempfile.TemporaryDirectory() as name:
        found = figures["crowd"] = crowd(wanted.models, Path(name) / "crowd.world")
    rows += [
        (f"{title}: spawned, ms each", f"{found['spawn_milliseconds']:.1f}", ""),
        (f"{title}: saved, s (worst)", f"{found['save_seconds_worst']:.2f}", "< 1"),
        (f"{title}: loaded again, m off", f"{found['largest_error_metres']:.1g}", "<= 1e-6"),
        (f"{title}: deleted, ms each", f"{found['delete_milliseconds']:.1f}", ""),
    ]
    print_table(rows)
    write(wanted.out, figures)


if __name__ == "__main__":
    main()
