"""Measures `aruco.py` from image to pose; run it with scripts/bench.sh aruco.

Everything in one thread, as the node does it: decoding the message, detection, both poses with
covariances. Beside it OpenCV's own detector with its defaults and sub-pixel corners. Prints a
table and writes JSON.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import time
from pathlib import Path
from typing import Any, Callable, Dict, List

import cv2
import numpy as np
from std_msgs.msg import Header

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.images import image_message, pixels_of
from bullet_lab.simulation.rendering.renderer import Shot
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.vision.marker_detector import DetectorSettings
from bullet_lab.vision.marker_pose import MarkerObserver

CAMERA = PinholeCamera(640, 480, 502.3, 502.3, 319.5, 239.5)
HEIGHT, MARKER_X = 0.44, 4.0
DISTANCES = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0)
BEARINGS = (0.0, 10.0)
# Frames without a marker are looked at twice: the worst case.
WORLDS = ("docking", "docking_dots", "docking_nested", "docking_decoy")
Work = Callable[[Any], Any]


def frames(world: str, poses: List[Any]) -> List[np.ndarray]:
    """Return what the camera sees from (x, y, yaw) in a world, rgb8."""
    simulation = Simulation.of(f"package://bullet_lab/worlds/{world}.world")
    renderer = simulation.renderer()
    shot = Shot(CAMERA, near=0.1, far=100.0)
    pictures = []
    for x, y, yaw in poses:
        pose = Pose.from_rpy((x, y, HEIGHT), (0.0, 0.0, yaw))
        pictures.append(renderer.picture(pose, shot))
    simulation.close()
    return pictures


def before_the_dock() -> List[Any]:
    """Return poses (m, m, rad) that look at the marker."""
    poses = []
    for distance in DISTANCES:
        for bearing in map(math.radians, BEARINGS):
            x, y = distance * math.cos(bearing), distance * math.sin(bearing)
            poses.append((MARKER_X - x, y, -bearing))
    return poses


def milliseconds(work: Work, pictures: List[np.ndarray], rounds: int) -> np.ndarray:
    """Return wall and processor time (n, 2) that each message took, in all rounds."""
    messages = [image_message(Header(), picture, "rgb8") for picture in pictures]
    times = []
    for number in range(rounds + 1):
        for message in messages:
            wall, processor = time.perf_counter(), time.process_time()
            work(message)
            spent = (time.perf_counter() - wall, time.process_time() - processor)
            # The first round fills caches.
            if number:
                times.append(spent)
    return 1e3 * np.array(times)


def plain_opencv() -> Work:
    """Return what one would write with OpenCV alone."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h10)
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)
    return lambda message: detector.detectMarkers(pixels_of(message, "mono8"))


def measure(rounds: int) -> Dict[str, Any]:
    """Run everything and return the figures."""
    cv2.setNumThreads(1)
    observer = MarkerObserver(DetectorSettings())
    ours = lambda message: observer.observe(pixels_of(message, "mono8"), CAMERA)  # noqa: E731
    kinds: Dict[str, List[np.ndarray]] = {}
    for world in WORLDS:
        kinds[world] = frames(world, before_the_dock())
    away = [(x, 0.0, math.pi / 2.0 + turn) for x in (0.0, 2.0) for turn in (0.0, 1.0, 2.0)]
    kinds["docking, marker out of sight"] = frames("docking", away)
    chance = np.random.default_rng(1)
    kinds["noise of 10 grey levels"] = [
        np.clip(picture + chance.normal(0.0, 10.0, picture.shape), 0, 255).astype(np.uint8)
        for picture in kinds["docking"]
    ]
    figures: Dict[str, Any] = {}
    for kind, pictures in kinds.items():
        times = milliseconds(ours, pictures, rounds)
        plain = milliseconds(plain_opencv(), pictures, rounds)
        found = [len(observer.observe(picture, CAMERA).markers) > 0 for picture in pictures]
        figures[kind] = {
            "median_ms": float(np.median(times[:, 0])),
            "percentile_95_ms": float(np.percentile(times[:, 0], 95)),
            "max_ms": float(times[:, 0].max()),
            "processor_median_ms": float(np.median(times[:, 1])),
            "opencv_median_ms": float(np.median(plain[:, 0])),
            "opencv_processor_median_ms": float(np.median(plain[:, 1])),
            "frames_with_markers": f"{sum(found)}/{len(found)}",
        }
    machine = {"machine": platform.processor() or platform.machine(), "cores": os.cpu_count()}
    return {**machine, "asked_median_ms": 10.0, "frames": figures}


def print_table(figures: Dict[str, Any]) -> None:
    """Print what was measured."""
    columns = {
        "median": "median_ms",
        "95 %": "percentile_95_ms",
        "max": "max_ms",
        "CPU": "processor_median_ms",
        "OpenCV": "opencv_median_ms",
        "its CPU": "opencv_processor_median_ms",
    }
    print(f"{'image to pose, ms':30} " + " ".join(f"{name:>8}" for name in columns) + "    found")
    for kind, row in figures["frames"].items():
        numbers = " ".join(f"{row[key]:8.1f}" for key in columns.values())
        print(f"{kind:30} {numbers} {row['frames_with_markers']:>8}")
    print("asked: a median of at most 10 ms; OpenCV: its detection alone, with its defaults")


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="JSON file to write")
    parser.add_argument("--rounds", type=int, default=10, help="looks at each image")
    wanted = parser.parse_args()
    figures = measure(wanted.rounds)
    print_table(figures)
    wanted.out.parent.mkdir(parents=True, exist_ok=True)
    wanted.out.write_text(json.dumps(figures, indent=2) + "\n")
    print(f"\nwritten to {wanted.out}")


if __name__ == "__main__":
    main()
