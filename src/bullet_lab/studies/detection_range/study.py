"""Detection range of the marker: its limits and errors, by distance, bearing and light.

Example:
    bullet_lab detection_range
    bullet_lab detection_range worlds:=marker_panel
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Callable, Iterator, Sequence

from bullet_lab.core.parameters import choices, integer, numbers
from bullet_lab.errors import LabError
from bullet_lab.simulation.rendering import driver_name
from bullet_lab.studies.detection_range.figures import heat_map, range_figure
from bullet_lab.studies.detection_range.trial import (
    WORLDS,
    Cell,
    count_false,
    is_reachable,
    try_cell,
)
from bullet_lab.studies.study import (
    MOST_SEED,
    Record,
    Settings,
    Summary,
    Tell,
    run_from,
    write_results,
)
from bullet_lab.studies.workers import Run, WorkerSettings, run_tasks, this_process, workers
from bullet_lab.studies.worlds import DEFAULT_LIGHT, LIGHTS

DOTS = "docking_dots"
DOTS_PER_BLOCK = 25
FULLY_LIT = ("marker_panel", "docking")
"""Worlds that are tried in all lights, the others only in their own: the marker is the same."""

MOST_FRAMES = 100_000
Task = Callable[[], Any]
LARGEST_DISTANCE = 50.0


@dataclass(frozen=True)
class RangeSettings(Settings):
    """A grid of camera positions in each world and light, and images of the dots."""

    worlds: tuple[str, ...] = choices(tuple(WORLDS), "worlds to try", WORLDS)
    lights: tuple[str, ...] = choices(
        LIGHTS, "lights to try; default is the world's own", LIGHTS
    )
    distances: tuple[float, ...] = numbers(
        (
            *(0.3, 0.32, 0.34, 0.35, 0.36, 0.4, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0),
            *(4.5, 5.0, 5.5, 6.0, 6.5, 7.0, 8.0),
        ),
        "from camera to marker, m",
        0.1,
        maximum=LARGEST_DISTANCE,
    )
    bearings: tuple[float, ...] = numbers(
        (0.0, 15.0, 30.0, 45.0, 60.0),
        "angles from the marker's axis, degrees, each tried on both sides",
        0.0,
        maximum=85.0,
    )
    frames: int = integer(10, "images for each distance, bearing and light", 1, MOST_FRAMES)
    dots: int = integer(1000, "images of the dots to count false detections in", 0, MOST_FRAMES)
    seed: int = integer(1, "seed of all that is random", 0, MOST_SEED)


def tasks(settings: RangeSettings) -> tuple[list[Task], list[Task]]:
    """Return the tasks of the cells, and those of blocks of the dots."""
    frames, seed = settings.frames, settings.seed
    of_cells = [
        functools.partial(
            try_cell, cell, frames, seed, cell.light == DEFAULT_LIGHT and cell.bearing == 0.0
        )
        for cell in _cells(settings)
        if is_reachable(cell)
    ]
    firsts = range(0, settings.dots, DOTS_PER_BLOCK)
    of_dots = [
        functools.partial(count_false, DOTS, block, min(DOTS_PER_BLOCK, settings.dots - one), seed)
        for block, one in enumerate(firsts)
    ]
    return of_cells, of_dots


def _cells(settings: RangeSettings) -> Iterator[Cell]:
    for world, light in product(settings.worlds, settings.lights):
        if light == DEFAULT_LIGHT or world in FULLY_LIT:
            for bearing, distance in product(settings.bearings, settings.distances):
                yield Cell(world, light, distance, math.radians(bearing))


def _do(todo: Sequence[Task], number: int) -> Any:
    return todo[number]()


LEAST_RATE = 0.95
"""Smallest share of the images for which a marker counts as found."""

COUNTS = ("other_detections", "double_detections", "false_detections")


def ranges_of(rows: Sequence[Record]) -> list[Record]:
    """Return a record for each world and light from the rows of all cells, as in the table.

    It has the ranges (m), None if there is none, and the numbers of detections.
    """
    found = []
    for world, light in dict.fromkeys((row["world"], row["light"]) for row in rows):
        of_light = [row for row in rows if (row["world"], row["light"]) == (world, light)]
        frontal, aside = (found_range(of_light, bearing) for bearing in (0.0, 30.0))
        found.append(
            {
                "world": world,
                "light": light,
                "closest_m": frontal[0],
                "farthest_frontal_m": frontal[1],
                "farthest_30deg_m": aside[1],
                **{name: sum(row[name] for row in of_light) for name in COUNTS},
            }
        )
    return found


def found_range(rows: Sequence[Record], bearing: float) -> tuple[float | None, float | None]:
    """Return the closest and the farthest distance of the longest range without a gap.

    In all its cells the marker is found in at least `LEAST_RATE` of the images. Returns
    None, None if there is no such cell.
    """
    aligned = [row for row in rows if row["bearing_deg"] == bearing]
    best: list[float] = []
    current: list[float] = []
    for distance, rate in sorted((row["distance_m"], row["rate"]) for row in aligned):
        current = [*current, distance] if rate >= LEAST_RATE else []
        best = max(best, current, key=lambda run: run[-1] - run[0] if run else -1.0)
    return (best[0], best[-1]) if best else (None, None)


def describe(summary: Summary) -> list[str]:
    """Return the main figures as lines for the user."""
    lines = [f"{one['world']}, {one['light']} light: {_sentence(one)}" for one in summary["ranges"]]
    dots = summary["dots"]
    if dots["frames"]:
        lines.append(
            f"false detections in {dots['frames']} frames of the dots: {dots['false_detections']}"
        )
    return lines


def _sentence(entry: Summary) -> str:
    text = (
        f"found from {_metres(entry['closest_m'])} to {_metres(entry['farthest_frontal_m'])} "
        f"frontal, to {_metres(entry['farthest_30deg_m'])} at 30 deg; "
        f"{entry['false_detections']} false detections"
    )
    others = entry["other_detections"]
    return f"{text}, {others} of another marker with the same id" if others else text


def _metres(value: float | None) -> str:
    return "nowhere" if value is None else f"{value:g} m"


def run_detection_range(
    folder: Path,
    settings: RangeSettings,
    run: Run = this_process,
    tell: Tell = print,
) -> Summary:
    """Try all cells; write table, heat maps, figure and summary.json; return the summary.

    The same settings give the same files, with any workers.

    Raises:
        LabError: no cell has room for the camera, nothing can be rendered, the folder cannot be
            written to, or a task was lost.
    """
    of_cells, of_dots = tasks(settings)
    if not of_cells:
        raise LabError("no cell of the grid has room for the camera: other distances are needed")
    todo = [*of_cells, *of_dots]
    results = run_tasks(functools.partial(_do, todo), len(todo), run, tell, "cells")
    cells, dots = results[: len(of_cells)], results[len(of_cells) :]
    rows = [row for row, _ in cells]
    summary = {
        "job": "detection_range",
        "seed": settings.seed,
        "renderer": driver_name(),
        "frames_per_cell": settings.frames,
        "least_rate": LEAST_RATE,
        "ranges": ranges_of(rows),
        "dots": {
            "frames": settings.dots,
            "false_detections": sum(false for false, _ in dots),
            "frames_with_the_marker_found": sum(found for _, found in dots),
        },
    }
    pictures = {(row["world"], row["distance_m"]): image for row, image in cells if image}
    figures = {
        f"heat_map_{world}.png": heat_map(world, [row for row in rows if row["world"] == world])
        # Not of a world without room.
        for world in dict.fromkeys(row["world"] for row in rows)
    }
    figures["detection_range.png"] = range_figure(rows, summary["ranges"], pictures)
    # Enough digits to read.
    table = [
        {name: f"{v:.6g}" if isinstance(v, float) else v for name, v in row.items()} for row in rows
    ]
    return write_results(folder, summary, {"cells.csv": table}, figures, {})


def _run(folder: Path, settings: RangeSettings, work: WorkerSettings, tell: Tell) -> list[str]:
    distances, bearings = tuple(sorted(settings.distances)), tuple(sorted(settings.bearings))
    settings = replace(settings, distances=distances, bearings=bearings)
    return describe(run_detection_range(folder, settings, workers(work.workers), tell))


main = functools.partial(
    run_from, "detection_range", __doc__, (RangeSettings, WorkerSettings), _run
)
