"""What is measured of the detectors, in pieces that any process can do."""

import hashlib
import math
import time
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from detectors.backgrounds import crops, originals, photographs
from detectors.contestants import CONTESTANTS
from detectors.scenes import CAMERA, SIZE, Conditions, draw_scene
from scipy.stats import chi2

import bullet_lab.vision
from bullet_lab.vision.marker_detector import DetectorSettings, MarkerDetector
from bullet_lab.vision.marker_pose import estimate_pose

DISTANCES = (0.5, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0)
ANGLES = (0.0, 20.0, 40.0, 60.0)
# Levels of the conditions of these names.
STRESSES = {
    "motion": (3.0, 7.0, 10.0, 13.0),
    "blur": (1.0, 1.5, 2.0, 3.0),
    "noise": (5.0, 10.0, 20.0),
    "contrast": (0.3, 0.15, 0.08),
    "occlusion": (0.02, 0.06, 0.2),
    "glare": (0.3, 0.6, 1.0),
}
CROP = (320, 240)
PIXEL_SIGMA = 1e-3
"""px; the renderings have no lens or print that would add to the noise."""
BOUNDS = (0.005, 0.995)


CROPS_AT_ONCE = 250


def cells():
    """Return all conditions with their names."""
    found = [
        (f"{d:g} m, {a:g} deg", Conditions(distance=d, angle=a)) for d in DISTANCES for a in ANGLES
    ]
    for name, levels in STRESSES.items():
        found += [(f"{name} {level:g}", Conditions(**{name: level})) for level in levels]
    return found


def right(scene, found):
    """Return the corners of the scene's marker as it was found, or None."""
    side = float(np.linalg.norm(scene.corners[0] - scene.corners[2])) / math.sqrt(2.0)
    for marker, corners in found:
        if marker == scene.marker and np.abs(corners - scene.corners).max() < 2.0 + 0.15 * side:
            return corners
    return None


def measured(find, scenes):
    """Return what a detector finds in pictures, how well, and how fast."""
    times, errors, poses = [], [], []
    for scene in scenes:
        start = time.process_time()
        found = find(scene.image)
        times.append(1e3 * (time.process_time() - start))
        corners = right(scene, found)
        if corners is not None:
            errors.append(float(np.linalg.norm(corners - scene.corners, axis=1).max()))
            pose = estimate_pose(corners, SIZE, CAMERA).best
            poses.append(1e3 * float(np.linalg.norm(pose.translation - scene.translation)))
    return {
        "scenes": len(scenes),
        "found": len(errors),
        "corner_error_px": _median(errors),
        "pose_error_mm": _median(poses),
        "median_ms": _median(times),
        "max_ms": max(times),
    }


def _median(values):
    return float(np.median(values)) if len(values) else None


def consistency(settings, scenes):
    """Return the NEES of our poses (mean over 6 degrees of freedom) and its 99 % bounds.

    Poses of which the other one is nearer to the truth are flips, which are counted apart.
    """
    detector = MarkerDetector(DetectorSettings("apriltag_36h11", **settings))
    squares, of_corners, flips = [], [], 0
    for scene in scenes:
        for marker in detector.detect(scene.image).markers:
            if right(scene, [(marker.id, marker.corners)]) is None:
                continue
            off = (marker.corners - scene.corners).ravel()
            of_corners.append(float(off @ np.linalg.solve(marker.covariance, off)))
            estimate = estimate_pose(marker.corners, SIZE, CAMERA, PIXEL_SIGMA, marker.covariance)
            pose = estimate.nearest_to(scene.rotation)
            flips += pose is not estimate.best
            turned = cv2.Rodrigues(scene.rotation @ pose.rotation.T)[0].ravel()
            error = np.concatenate((scene.translation - pose.translation, turned))
            squares.append(float(error @ np.linalg.solve(pose.covariance, error)))
    count = len(squares)
    if not count:
        return {"poses": 0}
    low, high = (float(chi2.ppf(share, 6 * count)) / count for share in BOUNDS)
    mean = float(np.mean(squares))
    return {
        "poses": count,
        "flips": flips,
        "nees": mean,
        "bounds": [low, high],
        "within": low <= mean <= high,
        "corner_nees": float(np.mean(of_corners)) / 8.0,
    }


class Plan(NamedTuple):
    """All that is measured: `cells()`, then crops of the photographs in turn.

    Attributes:
        scenes: for each condition.
        crops: so many at least.
        seed: of all that is random.
        settings: of each detector.
    """

    scenes: int
    crops: int
    seed: int
    settings: dict

    def tasks(self):
        """Return the number of tasks."""
        return len(cells()) + -(-self.crops // CROPS_AT_ONCE)

    def key(self):
        """Return what is the same where results are: the plan's and the sources' digest."""
        digest = hashlib.sha256(repr(self).encode())
        for folder in (*bullet_lab.vision.__path__, Path(__file__).parent):
            for path in sorted(Path(folder).glob("*.py")):
                digest.update(path.read_bytes())
        return digest.hexdigest()

    def finders(self):
        """Return the detectors with their settings."""
        return {name: one.make(self.settings[name]) for name, one in CONTESTANTS.items()}


def do(plan, number):
    """Do a task of a plan and return its figures by detector."""
    cv2.setNumThreads(1)
    chosen = cells()
    if number < len(chosen):
        scenes = [scene(chosen[number][1], plan.seed, 2, number, k) for k in range(plan.scenes)]
        found = {name: measured(find, scenes) for name, find in plan.finders().items()}
        found["ours"]["pose_nees"] = consistency(plan.settings["ours"], scenes)
        return found
    chunk = number - len(chosen)
    images = list(_originals().values())
    tally = dict.fromkeys(CONTESTANTS, 0)
    finders = plan.finders()
    seed = [plan.seed, 3, chunk]
    for crop in crops(images[chunk % len(images)], CROPS_AT_ONCE, CROP, seed):
        for name, find in finders.items():
            tally[name] += bool(find(crop))
    return {"photograph": chunk % len(images), **tally}


def scene(conditions, *seed):
    """Return a picture of a marker before one of the photographs."""
    return draw_scene(conditions, list(_photographs().values()), seed)


_photographs = lru_cache(maxsize=None)(photographs)
_originals = lru_cache(maxsize=None)(originals)
