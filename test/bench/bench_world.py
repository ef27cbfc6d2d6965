"""Measures models that come and go, and saving a world full of them; scripts/bench.sh world.

--models N: so many. --camera: also before a robot with a camera that looks on.
"""

import math
import statistics
import tempfile
import time
from pathlib import Path

import rospy
from common import Bridge, options, report, start_ros
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


def start(robot):
    """Start a paused bridge at full speed."""
    urdf = f"_robot:=package://bullet_lab/urdf/{robot}_robot.urdf"
    return Bridge("_paused:=true", "_rtf:=0", "_save_folder:=/", urdf)


def step_microseconds(bridge):
    """Return the wall time of one physics step, the median of five series."""
    times = []
    for _ in range(5):
        start = time.perf_counter()
        bridge.step(TIMED_STEPS)
        times.append((time.perf_counter() - start) / TIMED_STEPS)
    return 1e6 * statistics.median(times)


def come_and_go(bridge, model, count, steps):
    """Spawn and delete one model after another."""
    for number in range(count):
        bridge.add_model("passing", number % 64, model)
        bridge.step(steps)
        bridge.delete("passing")


def passing_models(robot, count):
    """Measure memory and step time before and after so many models have come and gone."""
    bridge = start(robot)
    steps = 1
    images = []
    if robot == "camera":
        steps = STEPS_PER_IMAGE
        rospy.Subscriber("mycamera/image_raw", Image, lambda message: images.append(message.header))
        while not images:
            bridge.step(STEPS_PER_IMAGE)
    come_and_go(bridge, PASSING[robot], WARM_UP, steps)
    # Series of steps at full speed take buffers for their images, once.
    step_before, before = step_microseconds(bridge), bridge.megabytes()
    come_and_go(bridge, PASSING[robot], count, steps)
    after, step_after = bridge.megabytes(), step_microseconds(bridge)
    end_all(bridge)
    title = f"{count} models one after another, {robot} robot"
    return [
        (f"{title}: MB more", after - before, ".1f", "<= 5"),
        (f"{title}: µs a step before", step_before, ".1f", ""),
        (f"{title}: µs a step after", step_after, ".1f", "same"),
    ]


def crowd(count, path):
    """Measure how long so many models take to be saved, and how they are loaded again."""
    bridge = start("block")
    for number in range(count):
        bridge.add_model(f"beacon_{number}", number)
    bridge.step(100)
    saved = [bridge.save(str(path), False).seconds for _ in range(5)]
    error = largest_error(bridge, path)
    end_all(bridge)
    return [
        (f"{count} models: saved, s (worst)", max(saved), ".2f", "< 1"),
        (f"{count} models: loaded again, m off", error, ".1g", "<= 1e-6"),
    ]


def largest_error(bridge, path):
    """Return how far any model of a saved world is from where the running one has it, in m."""
    errors = []
    with Simulation(read_world_file(path)) as again:
        for name, instance in again.models.items():
            position = bridge.state(name, "").pose.position
            there = (position.x, position.y, position.z)
            errors.append(math.dist(instance.pose().position, there))
    return max(errors)


def main():
    """Measure, print and write."""
    wanted = options(__doc__, models=1000, camera=False)
    start_ros()
    rows = []
    for robot in PASSING if wanted.camera else ("block",):
        print(f"{wanted.models} models one after another, {robot} robot …")
        rows += passing_models(robot, wanted.models)
    print(f"{wanted.models} models at a time …")
    with tempfile.TemporaryDirectory() as name:
        rows += crowd(wanted.models, Path(name) / "crowd.world")
    report(wanted.out, rows)


if __name__ == "__main__":
    main()
