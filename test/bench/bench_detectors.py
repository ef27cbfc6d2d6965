"""Compares detectors of 36h11 on the same pictures; scripts/bench.sh detectors.

Ours, OpenCV's ArUco and AprilTag 3 (pupil-apriltags), each with the best of a few settings, on
renderings of a marker before photographs: found, corners, poses, time; for ours also whether the
covariance is right. False detections are counted in crops of the photographs. Prints a table,
writes JSON and heat maps. What was done before it was stopped is not done again.
--scenes N: for each condition. --crops N: of photographs. --seed S: of all that is random.
--workers N: processes; 0: one for each core. --photos DIR: photographs instead of renderings;
what two detectors find is there.
"""

import json
import math
import time
import warnings
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from common import options, write
from detectors.backgrounds import photographs
from detectors.contestants import CONTESTANTS, described
from detectors.measures import ANGLES, CROPS_AT_ONCE, DISTANCES, Plan, cells, do, measured, scene
from detectors.photos import on_photos
from detectors.rates import rate_of
from tqdm import tqdm

from bullet_lab.core.figures import new_figure, save
from bullet_lab.studies.study import workers


def tuned(seed):
    """Return each detector's settings that find most, of those the ones with the best corners."""
    scenes = [scene(conditions, seed, 1, k) for k, (_, conditions) in enumerate(cells())]
    best = {}
    for name, contestant in CONTESTANTS.items():
        tried = []
        for settings in contestant.grid:
            result = measured(contestant.make(settings), scenes)
            tried.append((-result["found"], result["corner_error_px"] or 9.0, settings))
        best[name] = dict(min(tried, key=lambda one: one[:2])[2])
    return best


def clutter(finders):
    """Return the processor's time on whole photographs, 640x480: the best of three rounds."""
    figures = {}
    for name, find in finders.items():
        times = []
        for image in photographs().values():
            spent = []
            for _ in range(4):
                start = time.process_time()
                find(image)
                spent.append(1e3 * (time.process_time() - start))
            times.append(min(spent[1:]))
        figures[name] = {"median_ms": float(np.median(times)), "max_ms": float(max(times))}
    return figures


def all_figures(plan, journal, count):
    """Return the figures of all tasks; those that a journal of the same plan has are not redone."""
    figures = {}
    first = json.dumps({"plan": plan.key()})
    lines = journal.read_text().splitlines() if journal.exists() else []
    if lines[:1] == [first]:
        figures = dict(json.loads(line) for line in lines[1:])
    else:
        journal.write_text(first + "\n")
    left = [number for number in range(plan.tasks()) if number not in figures]
    with journal.open("a") as file:
        results = workers(count)(partial(do, plan), left)
        for number, found in tqdm(results, total=len(left), desc="tasks", disable=None):
            figures[number] = found
            file.write(json.dumps([number, found]) + "\n")
            file.flush()
    return figures


def compare(plan, journal, count):
    """Run everything and return the figures by detector."""
    figures, named = all_figures(plan, journal, count), cells()
    report = {}
    for name, times in clutter(plan.finders()).items():
        of_cells = {cell: figures[k][name] for k, (cell, _) in enumerate(named)}
        settings = described(plan.settings[name])
        report[name] = {"settings": settings, "cells": of_cells, "photographs": times}
    of_crops = [figures[number] for number in range(len(named), plan.tasks())]
    if not of_crops:
        return report
    seen = sorted({one["photograph"] for one in of_crops})
    for name in CONTESTANTS:
        wrong, sizes = dict.fromkeys(seen, 0), dict.fromkeys(seen, 0)
        for one in of_crops:
            wrong[one["photograph"]] += one[name]
            sizes[one["photograph"]] += CROPS_AT_ONCE
        rate = rate_of(list(wrong.values()), list(sizes.values()))._asdict()
        total = {
            "crops": sum(sizes.values()),
            "photographs": len(seen),
            "false": sum(wrong.values()),
        }
        report[name]["false_detections"] = {**total, **rate}
    return report


def heat_maps(report):
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


def _value(row, key):
    if key == "found":
        return 100.0 * row["found"] / row["scenes"]
    return math.nan if row[key] is None else row[key]


def print_table(report):
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


def main():
    """Measure, print and write."""
    wanted = options(__doc__, scenes=50, crops=50_000, workers=0, seed=1, photos="")
    warnings.simplefilter("ignore")
    cv2.setNumThreads(1)
    if wanted.photos:
        finders = {name: one.make(one.grid[0]) for name, one in CONTESTANTS.items()}
        figures = on_photos(Path(wanted.photos), finders)
        for name, row in figures.items():
            print(name, json.dumps(row))
        write(wanted.out, figures)
        return
    plan = Plan(wanted.scenes, wanted.crops, wanted.seed, tuned(wanted.seed))
    report = compare(plan, wanted.out.with_suffix(".jsonl"), wanted.workers)
    print_table(report)
    write(wanted.out, report)
    save(heat_maps(report), wanted.out.with_suffix(".png"))


if __name__ == "__main__":
    main()
