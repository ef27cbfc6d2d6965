"""Compares three detectors of 36h11 on the same pictures; run it with scripts/bench.sh detectors.

Ours, OpenCV's ArUco and AprilTag 3 (pupil-apriltags), each with the best of a few settings, on
renderings of a marker before photographs: found, corners, poses, time; for ours also whether the
covariance is right. False detections are counted in crops of the photographs. Prints a table,
writes JSON and heat maps.
"""

from __future__ import annotations

import argparse
import json
import math
import time
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import cv2
import numpy as np
from detectors.backgrounds import crops, originals, photographs
from detectors.contestants import CONTESTANTS, Find, described
from detectors.rates import rate_of
from detectors.scenes import CAMERA, SIZE, Conditions, Scene, draw_scene
from scipy.stats import chi2
from tqdm import tqdm

from bullet_lab.core.figures import new_figure, save
from bullet_lab.vision.marker_detector import DetectorSettings, MarkerDetector
from bullet_lab.vision.marker_pose import estimate_pose

DISTANCES = (0.5, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0)
ANGLES = (0.0, 20.0, 40.0, 60.0)
STRESSES: Dict[str, Dict[str, Tuple[float, ...]]] = {
    "motion": {"motion": (3.0, 7.0, 10.0, 13.0)},
    "blur": {"blur": (1.0, 1.5, 2.0, 3.0)},
    "noise": {"noise": (5.0, 10.0, 20.0)},
    "contrast": {"contrast": (0.3, 0.15, 0.08)},
    "occlusion": {"occlusion": (0.02, 0.06, 0.2)},
    "glare": {"glare": (0.3, 0.6, 1.0)},
}
CROP = (320, 240)
PIXEL_SIGMA = 1e-3
"""px; the renderings have no lens or print that would add to the noise."""
BOUNDS = (0.005, 0.995)


def cells() -> List[Tuple[str, Conditions]]:
    """Return all conditions with their names."""
    found = [
        (f"{d:g} m, {a:g} deg", Conditions(distance=d, angle=a)) for d in DISTANCES for a in ANGLES
    ]
    for name, values in STRESSES.items():
        ((field, levels),) = values.items()
        found += [(f"{name} {level:g}", Conditions(**{field: level})) for level in levels]
    return found


def right(scene: Scene, found: Sequence[Tuple[int, np.ndarray]]) -> Optional[np.ndarray]:
    """Return the corners of the scene's marker as it was found, or None."""
    side = float(np.linalg.norm(scene.corners[0] - scene.corners[2])) / math.sqrt(2.0)
    for marker, corners in found:
        if marker == scene.marker and np.abs(corners - scene.corners).max() < 2.0 + 0.15 * side:
            return corners
    return None


def measured(find: Find, scenes: Sequence[Scene]) -> Dict[str, Any]:
    """Return what a detector finds in pictures, how well, and how fast."""
    times, errors, poses = [], [], []
    for scene in scenes:
        start = time.perf_counter()
        found = find(scene.image)
        times.append(1e3 * (time.perf_counter() - start))
        corners = right(scene, found)
        if corners is not None:
            errors.append(float(np.linalg.norm(corners - scene.corners, axis=1).max()))
            pose = estimate_pose(corners, SIZE, CAMERA).best
            poses.append(1e3 * float(np.linalg.norm(pose.translation - scene.translation)))
    return {
        "scenes": len(scenes),
        "found": len(errors),
        "corner_error_px": _median(errors),
        "corner_error_95_px": float(np.percentile(errors, 95)) if errors else None,
        "pose_error_mm": _median(poses),
        "median_ms": _median(times),
        "max_ms": max(times),
    }


def _median(values: Sequence[float]) -> Optional[float]:
    return float(np.median(values)) if len(values) else None


def consistency(settings: Mapping[str, Any], scenes: Sequence[Scene]) -> Dict[str, Any]:
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
            estimate = estimate_pose(
                marker.corners, SIZE, CAMERA, PIXEL_SIGMA, marker.covariance
            )
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
        "nees_median": float(np.median(squares)),
        "bounds": [low, high],
        "within": low <= mean <= high,
        "corner_nees": float(np.mean(of_corners)) / 8.0,
    }


def tuned(scenes: Sequence[Scene]) -> Dict[str, Dict[str, Any]]:
    """Return each detector's settings that find most, of those the ones with the best corners."""
    best = {}
    for name, contestant in CONTESTANTS.items():
        tried = []
        for settings in contestant.grid:
            result = measured(contestant.make(settings), scenes)
            tried.append((-result["found"], result["corner_error_px"] or 9.0, settings))
        best[name] = dict(min(tried, key=lambda one: one[:2])[2])
    return best


def false_detections(
    finders: Mapping[str, Find], count: int, seed: int
) -> Dict[str, Dict[str, Any]]:
    """Return how often something is found in crops of photographs, which show no marker."""
    pictures = originals()
    each = -(-count // len(pictures))
    wrong: Dict[str, List[int]] = {name: [] for name in finders}
    for number, image in enumerate(tqdm(pictures.values(), desc="crops", disable=None)):
        tally = dict.fromkeys(finders, 0)
        for crop in crops(image, each, CROP, [seed, number]):
            for name, find in finders.items():
                tally[name] += bool(find(crop))
        for name, number_of in tally.items():
            wrong[name].append(number_of)
    sizes = [each] * len(pictures)
    return {
        name: {"crops": sum(sizes), "photographs": len(sizes), **asdict(rate_of(counts, sizes))}
        for name, counts in wrong.items()
    }


def clutter(finders: Mapping[str, Find], rounds: int) -> Dict[str, Dict[str, float]]:
    """Return the time on whole photographs without a marker, 640x480: the best of some rounds."""
    figures = {}
    for name, find in finders.items():
        times = []
        for image in photographs().values():
            spent = []
            for _ in range(rounds + 1):
                start = time.perf_counter()
                find(image)
                spent.append(1e3 * (time.perf_counter() - start))
            times.append(min(spent[1:]))
        figures[name] = {"median_ms": float(np.median(times)), "max_ms": float(max(times))}
    return figures


def compare(per_cell: int, crop_count: int, seed: int) -> Dict[str, Any]:
    """Run everything and return the figures by detector."""
    backgrounds = list(photographs().values())
    named = cells()
    draw = lambda c, *key: draw_scene(c, backgrounds, [seed, *key])  # noqa: E731
    chosen = [draw(c, 1, k) for k, (_, c) in enumerate(named)]
    settings = tuned(chosen)
    finders = {name: CONTESTANTS[name].make(settings[name]) for name in CONTESTANTS}
    report: Dict[str, Any] = {
        name: {"settings": described(settings[name]), "cells": {}} for name in finders
    }
    for index, (name, conditions) in enumerate(tqdm(named, desc="conditions", disable=None)):
        scenes = [draw(conditions, 2, index, k) for k in range(per_cell)]
        for contestant, find in finders.items():
            report[contestant]["cells"][name] = measured(find, scenes)
        report["ours"]["cells"][name]["pose_nees"] = consistency(settings["ours"], scenes)
    for contestant, figures in clutter(finders, 3).items():
        report[contestant]["photographs"] = figures
    if crop_count:
        for contestant, figures in false_detections(finders, crop_count, seed).items():
            report[contestant]["false_detections"] = figures
    return report


def heat_maps(report: Mapping[str, Any]) -> Any:
    """Draw the share that is found, and corners' errors, by distance and angle."""
    figure = new_figure(13.0, 6.0)
    grid = figure.subplots(2, len(CONTESTANTS))
    for column, name in enumerate(CONTESTANTS):
        rows = report[name]["cells"]
        of = lambda key, rows=rows: np.array(  # noqa: E731
            [[_value(rows[f"{d:g} m, {a:g} deg"], key) for d in DISTANCES] for a in ANGLES]
        )
        for row, (key, title, most) in enumerate(
            (("found", "found, %", 100.0), ("corner_error_px", "corner error, px", 0.6))
        ):
            axes, values = grid[row, column], of(key)
            axes.imshow(values, vmin=0.0, vmax=most, cmap="Blues" if not row else "Oranges",
                        origin="lower", aspect="auto")  # fmt: skip
            for (y, x), value in np.ndenumerate(values):
                text = "–" if math.isnan(value) else f"{value:.0f}" if not row else f"{value:.2f}"
                dark = not math.isnan(value) and value > 0.6 * most
                axes.text(x, y, text, ha="center", va="center", fontsize=8,
                          color="white" if dark else "black")  # fmt: skip
            axes.set_xticks(range(len(DISTANCES)), [f"{d:g}" for d in DISTANCES])
            axes.set_yticks(range(len(ANGLES)), [f"{a:g}" for a in ANGLES])
            axes.set_title(f"{name}: {title}", fontsize=10)
            axes.set(xlabel="distance (m)", ylabel="angle (°)")
    figure.tight_layout()
    return figure


def _value(row: Mapping[str, Any], key: str) -> float:
    if key == "found":
        return 100.0 * row["found"] / row["scenes"]
    return math.nan if row[key] is None else row[key]


def print_table(report: Mapping[str, Any]) -> None:
    """Print what was measured: found / corners' error in px / pose error in mm."""
    print(f"{'':16}" + "".join(f"{name:>26}" for name in CONTESTANTS) + "   NEES of ours (6)")
    for cell in report["ours"]["cells"]:
        texts = []
        for name in CONTESTANTS:
            row = report[name]["cells"][cell]
            text = f"{row['found']}/{row['scenes']}"
            if row["found"]:
                text += f" / {row['corner_error_px']:.2f} / {row['pose_error_mm']:.0f}"
            texts.append(f"{text:>26}")
        nees = report["ours"]["cells"][cell]["pose_nees"]
        last = ""
        if nees["poses"]:
            (low, high), mark = nees["bounds"], "" if nees["within"] else " !"
            last = f"   {nees['nees']:.1f} in {low:.1f}..{high:.1f}{mark}, {nees['flips']} flips"
        print(f"{cell:16}" + "".join(texts) + last)
    for name in CONTESTANTS:
        print(name, json.dumps({k: v for k, v in report[name].items() if k != "cells"}))


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="JSON file to write")
    parser.add_argument("--scenes", type=int, default=50, help="for each condition")
    parser.add_argument("--crops", type=int, default=50_000, help="of photographs")
    parser.add_argument("--seed", type=int, default=1, help="of all that is random")
    wanted = parser.parse_args()
    warnings.simplefilter("ignore")
    cv2.setNumThreads(1)
    report = compare(wanted.scenes, wanted.crops, wanted.seed)
    print_table(report)
    wanted.out.parent.mkdir(parents=True, exist_ok=True)
    wanted.out.write_text(json.dumps(report, indent=2) + "\n")
    save(heat_maps(report), wanted.out.with_suffix(".png"))
    print(f"\nwritten to {wanted.out} and {wanted.out.with_suffix('.png')}")


if __name__ == "__main__":
    main()
