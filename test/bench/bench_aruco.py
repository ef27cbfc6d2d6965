"""Measures `aruco.py` from image to pose; scripts/bench.sh aruco.

Everything in one thread, as the node does it: decoding the message, detection, both poses with
covariances. Beside it OpenCV's own detector with its defaults and sub-pixel corners.
--rounds N: looks at each image.
"""

import math
import time

import cv2
import numpy as np
from common import options, report
from detectors.scenes import CAMERA
from std_msgs.msg import Header

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.images import image_message, pixels_of
from bullet_lab.simulation.rendering.renderer import Shot
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.vision.marker_detector import DetectorSettings
from bullet_lab.vision.marker_pose import MarkerObserver

HEIGHT, MARKER_X = 0.44, 4.0
DISTANCES = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0)
BEARINGS = (0.0, 10.0)
# Frames without a marker are looked at twice: the worst case.
WORLDS = ("docking", "docking_nested")


def frames(world, poses):
    """Return what the camera sees from (x, y, yaw) in a world, rgb8."""
    with Simulation.of(f"package://bullet_lab/worlds/{world}.world") as simulation:
        renderer = simulation.renderer()
        shot = Shot(CAMERA, near=0.1, far=100.0)
        return [
            renderer.picture(Pose.from_rpy((x, y, HEIGHT), (0.0, 0.0, yaw)), shot)
            for x, y, yaw in poses
        ]


def milliseconds(work, pictures, rounds):
    """Return the time that a message took, the median of all rounds but the first."""
    messages = [image_message(Header(), picture, "rgb8") for picture in pictures]
    times = []
    for _ in range(rounds + 1):
        for message in messages:
            start = time.perf_counter()
            work(message)
            times.append(time.perf_counter() - start)
    # The first round fills caches.
    return 1e3 * float(np.median(times[len(messages) :]))


def plain_opencv():
    """Return what one would write with OpenCV alone."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h10)
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)
    return lambda message: detector.detectMarkers(pixels_of(message, "mono8"))


def pictures_by_kind():
    """Return what is looked at: the marker before the dock, one within another, and none."""
    places = [(d, math.radians(bearing)) for d in DISTANCES for bearing in BEARINGS]
    poses = [(MARKER_X - d * math.cos(b), d * math.sin(b), -b) for d, b in places]
    kinds = {world: frames(world, poses) for world in WORLDS}
    away = [(x, 0.0, math.pi / 2.0 + turn) for x in (0.0, 2.0) for turn in (0.0, 1.0, 2.0)]
    kinds["docking, marker out of sight"] = frames("docking", away)
    return kinds


def main():
    """Measure, print and write."""
    wanted = options(__doc__, rounds=10)
    cv2.setNumThreads(1)
    observer = MarkerObserver(DetectorSettings())
    rows = []
    shares = {}
    for kind, pictures in pictures_by_kind().items():
        ours = milliseconds(lambda m: observer.observe(pixels_of(m, "mono8"), CAMERA), pictures,
                            wanted.rounds)  # fmt: skip
        plain = milliseconds(plain_opencv(), pictures, wanted.rounds)
        found = sum(bool(observer.observe(picture, CAMERA).markers) for picture in pictures)
        shares[f"{kind}: frames with markers"] = f"{found}/{len(pictures)}"
        rows.append((f"{kind}: image to pose, ms", ours, ".1f", "<= 10"))
        rows.append((f"{kind}: OpenCV's detection alone, ms", plain, ".1f", ""))
        print(f"{kind}: markers in {found} of {len(pictures)}", flush=True)
    report(wanted.out, rows, **shares)


if __name__ == "__main__":
    main()
