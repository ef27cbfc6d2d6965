"""From where the marker is found: closest, farthest, and how well, by distance, bearing, light.

Example:
    python3 -m bullet_lab.studies.detection_range.study results/detection_range
    python3 -m bullet_lab.studies.detection_range.study results/panel --worlds marker_panel
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, NoReturn, Optional, Sequence, Tuple

from bullet_lab.core.figures import save
from bullet_lab.core.files import make_folder, write_json
from bullet_lab.core.parameters import boolean, choices, integer, numbers
from bullet_lab.simulation.rendering.graphics import driver_name
from bullet_lab.studies.detection_range.figures import heat_map, range_figure
from bullet_lab.studies.detection_range.scenes import LIGHTS, WORLDS, Cell, is_reachable
from bullet_lab.studies.detection_range.trial import count_false, try_cell
from bullet_lab.studies.study import (
    MOST_SEED,
    SUMMARY,
    Settings,
    Tell,
    progress,
    run_from,
    silent,
    whole_results,
    write_table,
)
from bullet_lab.studies.workers import (
    Run,
    TaskLostError,
    WorkerSettings,
    this_process,
    workers,
)

TABLE, PICTURE = "cells.csv", "detection_range.png"
DOTS = "docking_dots"
DOTS_PER_BLOCK = 25
FULLY_LIT = ("marker_panel", "docking")
"""These worlds are tried in all lights, the others in their own: the marker is the same one."""

MOST_FRAMES = 100_000
LARGEST_DISTANCE = 50.0
Result = Any
"""A CellResult, or (false detections, finds) in a block of pictures of the dots."""


@dataclass(frozen=True)
class RangeSettings(Settings):
    """What is tried: a grid of positions in each world and light, and pictures of the dots."""

    worlds: Tuple[str, ...] = choices(tuple(WORLDS), "worlds to try", WORLDS)
    lights: Tuple[str, ...] = choices(
        tuple(LIGHTS), "lights to try; default is the world's own", LIGHTS
    )
    distances: Tuple[float, ...] = numbers(
        (
            *(0.3, 0.32, 0.34, 0.35, 0.36, 0.4, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0),
            *(4.5, 5.0, 5.5, 6.0, 6.5, 7.0, 8.0),
        ),
        "from camera to marker, m",
        0.1,
        maximum=LARGEST_DISTANCE,
    )
    bearings: Tuple[float, ...] = numbers(
        (0.0, 15.0, 30.0, 45.0, 60.0),
        "angles from the marker's axis, degrees, each tried on both sides",
        0.0,
        maximum=85.0,
    )
    frames: int = integer(10, "pictures for each distance, bearing and light", 1, MOST_FRAMES)
    dots: int = integer(1000, "pictures of the dots to count false detections in", 0, MOST_FRAMES)
    seed: int = integer(1, "seed of all that is random", 0, MOST_SEED)
    every_light: bool = boolean(
        False, "try each world in each light, not only marker_panel and docking"
    )


@dataclass(frozen=True)
class Task:
    """Something for a worker to do: a cell, or a block of pictures of the dots."""

    cell: Optional[Cell]
    block: int = 0
    frames: int = 0


@functools.lru_cache(maxsize=4)
def tasks(settings: RangeSettings) -> Tuple[Task, ...]:
    """Return all that there is to do, in the order of the results."""
    found = [Task(cell) for cell in _cells(settings) if is_reachable(cell)]
    for block, first in enumerate(range(0, settings.dots, DOTS_PER_BLOCK)):
        found.append(Task(None, block, min(DOTS_PER_BLOCK, settings.dots - first)))
    return tuple(found)


def _cells(settings: RangeSettings) -> Iterator[Cell]:
    for world in settings.worlds:
        for light in settings.lights:
            if light == "default" or world in FULLY_LIT or settings.every_light:
                for bearing in settings.bearings:
                    for distance in settings.distances:
                        yield Cell(world, light, distance, math.radians(bearing))


def do_task(settings: RangeSettings, number: int) -> Result:
    """Do one of the `tasks`: return a CellResult, or false detections and finds of a block."""
    task = tasks(settings)[number]
    if task.cell is None:
        return count_false(DOTS, task.block, task.frames, settings.seed)
    keep = task.cell.light == "default" and task.cell.bearing == 0.0
    return try_cell(task.cell, settings.frames, settings.seed, keep)


Row = Mapping[str, Any]

LEAST_RATE = 0.95
"""A marker that is found in fewer of the pictures is not counted as found."""

CLOSEST_TARGET = 0.35
NEAREST_ASIDE = 0.5
"""m; nearer, a marker that is seen from aside is not wholly in the picture."""

TARGETS = (
    (0.0, NEAREST_ASIDE, 4.0, 1.0),
    (15.0, NEAREST_ASIDE, 4.0, 1.0),
    (30.0, NEAREST_ASIDE, 4.0, 1.0),
    (45.0, NEAREST_ASIDE, 3.0, 1.0),
    (60.0, NEAREST_ASIDE, 2.0, 1.0),
    (0.0, 5.0, 5.0, 0.95),
)
"""Of the free-standing panel in its own light: bearing (deg), least and most m, rate."""
PANEL, OWN_LIGHT = "marker_panel", "default"
SIGNIFICANT = 6
COUNTS = ("other_detections", "double_detections", "false_detections")


def _entry(value: Any) -> Any:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.{SIGNIFICANT}g}" if isinstance(value, float) else value


def detection_summary(rows: Sequence[Row]) -> Dict[str, Any]:
    """Return the ranges of each world and light, and how the panel's targets are met.

    The rows are those of all cells, as in the table.
    """
    lights = list(dict.fromkeys((row["world"], row["light"]) for row in rows))
    worlds: Dict[str, Any] = {}
    for world, light in lights:
        figures = _ranges([r for r in rows if (r["world"], r["light"]) == (world, light)])
        entry = worlds.setdefault(world, {})
        if light == OWN_LIGHT:
            entry.update(figures)
        else:
            entry.setdefault("lights", {})[light] = figures
    return {"least_rate": LEAST_RATE, "worlds": worlds, "targets": _targets(rows)}


def _ranges(rows: Sequence[Row]) -> Dict[str, Any]:
    frontal, aside = (found_range(rows, bearing) for bearing in (0.0, 30.0))
    return {
        "closest_m": frontal[0],
        "farthest_frontal_m": frontal[1],
        "farthest_30deg_m": aside[1],
        **{name: sum(row[name] for row in rows) for name in COUNTS},
    }


def found_range(rows: Sequence[Row], bearing: float) -> Tuple[Optional[float], Optional[float]]:
    """Return the closest and the farthest distance of the longest range without a gap.

    Everywhere in it the marker is found in at least `LEAST_RATE` of the pictures. None, None
    where there is no such distance.
    """
    aligned = [row for row in rows if row["bearing_deg"] == bearing]
    best: List[float] = []
    current: List[float] = []
    for distance, rate in sorted((row["distance_m"], row["rate"]) for row in aligned):
        current = [*current, distance] if rate >= LEAST_RATE else []
        best = max(best, current, key=lambda run: run[-1] - run[0] if run else -1.0)
    return (best[0], best[-1]) if best else (None, None)


def _targets(rows: Sequence[Row]) -> List[Dict[str, Any]]:
    """Return, for each target, in how many pictures the marker should have been found and was."""
    panel = [row for row in rows if (row["world"], row["light"]) == (PANEL, OWN_LIGHT)]
    found = [_target(panel, *target) for target in TARGETS]
    if any(row["bearing_deg"] == 0.0 and row["distance_m"] <= CLOSEST_TARGET for row in panel):
        closest = found_range(panel, 0.0)[0]
        met = closest is not None and closest <= CLOSEST_TARGET
        found.append({"target": f"closest {CLOSEST_TARGET:g} m", "closest_m": closest, "met": met})
    return [target for target in found if target]


def _target(
    panel: Sequence[Row], bearing: float, least: float, most: float, rate: float
) -> Dict[str, Any]:
    chosen = [r for r in panel if r["bearing_deg"] == bearing and least <= r["distance_m"] <= most]
    frames, found = (sum(row[name] for row in chosen) for name in ("frames", "found"))
    if not frames:
        return {}
    where = f"at {most:g} m" if least == most else f"up to {most:g} m"
    return {
        "target": f"{100 * rate:g} % {where}, {bearing:g} deg",
        "frames": frames,
        "found": found,
        "met": found >= rate * frames,
    }


def describe(summary: Mapping[str, Any]) -> List[str]:
    """Return the main figures as lines for people."""
    lines = []
    for world, figures in summary["worlds"].items():
        entries = {OWN_LIGHT: figures, **figures.get("lights", {})}
        for light, entry in entries.items():
            if "closest_m" in entry:
                lines.append(f"{world}, {light} light: {_sentence(entry)}")
    for target in summary["targets"]:
        if "frames" in target:
            count = f"{target['found']} of {target['frames']} frames"
        else:
            count = _metres(target["closest_m"])
        lines.append(f"target {target['target']}: {count}, {'met' if target['met'] else 'MISSED'}")
    dots = summary["dots"]
    if dots["frames"]:
        lines.append(
            f"false detections in {dots['frames']} frames of the dots: {dots['false_detections']}"
        )
    return lines


def _sentence(entry: Mapping[str, Any]) -> str:
    text = (
        f"found from {_metres(entry['closest_m'])} to {_metres(entry['farthest_frontal_m'])} "
        f"frontal, to {_metres(entry['farthest_30deg_m'])} at 30 deg; "
        f"{entry['false_detections']} false detections"
    )
    others = entry["other_detections"]
    return f"{text}, {others} of the marker that is not meant" if others else text


def _metres(value: Optional[float]) -> str:
    return "nowhere" if value is None else f"{value:g} m"


def run_detection_range(
    folder: Path,
    settings: RangeSettings,
    run: Run = this_process,
    tell: Tell = silent,
) -> Dict[str, Any]:
    """Try all cells, leave table, heat maps, picture and summary.json, and return what that says.

    The same settings give the same files, whoever does the work.

    Raises:
        LabError: nothing can be drawn, the folder cannot be written to, or a task was lost.
    """
    make_folder(folder)
    results = _run_all(settings, run, tell)
    of_cells = [r for r, task in zip(results, tasks(settings)) if task.cell is not None]
    of_dots = [r for r, task in zip(results, tasks(settings)) if task.cell is None]
    rows = [result.row() for result in of_cells]
    summary = {
        "job": "detection_range",
        "seed": settings.seed,
        "renderer": driver_name(),
        "frames_per_cell": settings.frames,
        **detection_summary(rows),
        "dots": {
            "frames": settings.dots,
            "false_detections": sum(false for false, _ in of_dots),
            "frames_with_the_marker_found": sum(found for _, found in of_dots),
        },
    }
    pictures = {
        (result.cell.world, result.cell.distance): result.snapshot
        for result in of_cells
        if result.snapshot is not None
    }
    with whole_results(folder) as part:
        write_table(part / TABLE, [rows[0], *(map(_entry, row.values()) for row in rows)])
        for world in settings.worlds:
            of_world = [row for row in rows if row["world"] == world]
            save(heat_map(world, of_world), part / f"heat_map_{world}.png")
        save(range_figure(rows, summary, pictures), part / PICTURE)
        write_json(part / SUMMARY, summary)
    return summary


def _run_all(settings: RangeSettings, run: Run, tell: Tell) -> List[Result]:
    count = len(tasks(settings))
    results: Dict[int, Result] = {}
    with progress("detection_range", count, tell, things=" cells") as note:
        for number, result in run(functools.partial(do_task, settings), range(count)):
            if isinstance(result, TaskLostError):
                raise TaskLostError(f"task {number}: {result}")
            results[number] = result
            note()
    return [results[number] for number in range(count)]


def _run(folder: Path, settings: RangeSettings, who: WorkerSettings, tell: Tell) -> None:
    # Better known now than after the work.
    make_folder(folder)
    distances, bearings = (tuple(sorted(v)) for v in (settings.distances, settings.bearings))
    settings = replace(settings, distances=distances, bearings=bearings)
    for line in describe(run_detection_range(folder, settings, workers(who.workers), tell)):
        tell(line)


def main(words: Optional[Sequence[str]] = None) -> NoReturn:
    """Run from the command line; see `run_from`."""
    run_from("detection_range", __doc__, (RangeSettings, WorkerSettings), _run, words)


if __name__ == "__main__":
    main()
