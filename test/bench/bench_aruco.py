"""Measures `aruco.py` from image to pose; scripts/bench.sh aruco.

Everything in one thread, as the node does it: decoding the message, detection, both poses with
covariances. Beside it OpenCV's own detector with its defaults and sub-pixel corners.
--rounds N: looks at each image.
"""

from __future__ import annotations

import math
import time
from typing import Any, Callable, Dict, List, Sequence, Tuple

import cv2
import numpy as np
from common import options, write
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


def frames(world: str, poses: Sequence[Tuple[float, float, float]]) -> List[np.ndarray]:
    """Return what the camera sees from (x, y, yaw) in a world, rgb8."""
    with Simulation.of(f"package://bullet_lab/worlds/{world}.world") as simulation:
        renderer = simulation.renderer()
        shot = Shot(CAMERA, near=0.1, far=100.0)
        return [
            renderer.picture(Pose.from_rpy((x, y, HEIGHT), (0.0, 0.0, yaw)), shot)
            for x, y, yaw in poses
        ]


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


def pictures_by_kind() -> Dict[str, List[np.ndarray]]:
    """Return what is looked at: the marker before the dock, nothing, and noise."""
    places = [(d, math.radians(bearing)) for d in DISTANCES for bearing in BEARINGS]
    poses = [(MARKER_X - d * math.cos(b), d * math.sin(b), -b) for d, b in places]
    kinds = {world: frames(world, poses) for world in WORLDS}
    away = [(x, 0.0, math.pi / 2.0 + turn) for x in (0.0, 2.0) for turn in (0.0, 1.0, 2.0)]
    kinds["docking, marker out of sight"] = frames("docking", away)
    chance = np.random.default_rng(1)
    kinds["noise of 10 grey levels"] = [
        np.clip(picture + chance.normal(0.0, 10.0, picture.shape), 0, 255).astype(np.uint8)
        for picture in kinds["docking"]
    ]
    return kinds


def main() -> None:
    """Measure, print and write."""
    wanted = options(__doc__, rounds=10)
    cv2.setNumThreads(1)
    observer = MarkerObserver(DetectorSettings())
    figures: Dict[str, Any] = {}
    columns = ("median", "95 %", "max", "CPU", "OpenCV", "its CPU")
    print(f"{'image to pose, ms':30} " + " ".join(f"{name:>8}" for name in columns) + "    found")
    for kind, pictures in pictures_by_kind().items():
        times = milliseconds(lambda m: observer.observe(pixels_of(m, "mono8"), CAMERA), pictures,
                             wanted.rounds)  # fmt: skip
        plain = milliseconds(plain_opencv(), pictures, wanted.rounds)
        found = [len(observer.observe(picture, CAMERA).markers) > 0 for picture in pictures]
        median, processor = np.median(times, axis=0).tolist()
        most = np.percentile(times[:, 0], (95, 100)).tolist()
        numbers = (median, *most, processor, *np.median(plain, axis=0).tolist())
        share = f"{sum(found)}/{len(found)}"
        print(f"{kind:30} " + " ".join(f"{number:8.1f}" for number in numbers) + f" {share:>8}")
        figures[kind] = {**dict(zip(columns, numbers)), "frames_with_markers": share}
    print("asked: a median of at most 10 ms; OpenCV: its detection alone, with its defaults")
    write(wanted.out, {"asked_median_ms": 10.0, "frames": figures})


if __name__ == "__main__":
    main()
