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
from typing import Any, Callable, Iterator, Mapping, Optional, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle, Wedge
from numpy import ndarray

from bullet_lab.core.figures import BLACK, BLUE, GREY, ORANGE, VERMILION, new_figure, panels
from bullet_lab.core.parameters import choices, integer, numbers
from bullet_lab.errors import LabError
from bullet_lab.simulation.rendering import driver_name
from bullet_lab.studies.detection_range.trial import (
    WORLDS,
    Cell,
    MarkerImage,
    count_false,
    is_reachable,
    try_cell,
)
from bullet_lab.studies.study import (
    MOST_SEED,
    Record,
    Run,
    Settings,
    Summary,
    Tell,
    WorkerSettings,
    run_from,
    run_tasks,
    this_process,
    workers,
    write_results,
)
from bullet_lab.studies.worlds import DEFAULT_LIGHT, LIGHTS

DOTS = "docking_dots"
DOTS_PER_BLOCK = 25
FULLY_LIT = ("marker_panel", "docking")
"""Worlds that are tried in all lights, the others only in their own: the marker is the same."""

MOST_FRAMES = 100_000
LARGEST_DISTANCE = 50.0
Task = Callable[[], Any]
Ends = Tuple[Optional[float], Optional[float]]
"""Closest and farthest distance (m) of a range, None without one."""

LEAST_RATE = 0.95
"""Smallest share of the images for which a marker counts as found."""

# Shares of images with the marker found: none, few, half, most, nearly all (95 %), all.
BOUNDS = (0.0, 0.001, 0.25, 0.5, 0.75, 0.95, 0.9999, 1.0001)
COLOURS = ("#4d4d4d", "#b2182b", "#d6604d", "#f4a582", "#fddbc7", "#92c5de", "#2166ac")
HIDDEN = "#e8e8e8"
ROBOT_RADIUS = 0.2
CAMERA_AHEAD = 0.16
PICTURE_SPAN = 5.0
"""Height of the part of an image that is shown, in sides of the marker."""


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


COUNTS = ("other_detections", "double_detections", "false_detections")


def grouped(rows: Sequence[Record], *names: str) -> dict[tuple, list[Record]]:
    """Return rows by what they have in some columns, in the order in which that comes."""
    groups: dict[tuple, list[Record]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in names), []).append(row)
    return groups


def ranges_of(rows: Sequence[Record]) -> list[Record]:
    """Return a record for each world and light from the rows of all cells, as in the table.

    It has the ranges (m), None if there is none, and the numbers of detections.
    """
    found = []
    for (world, light), of_light in grouped(rows, "world", "light").items():
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


def found_range(rows: Sequence[Record], bearing: float) -> Ends:
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


def heat_map(world: str, rows: Sequence[Record]) -> Figure:
    """Draw the share of images with the marker found in a world: a map for each light.

    `rows` are those of all its cells, as in the table.
    """
    lights = grouped(rows, "light")
    bearings = sorted({row["bearing_deg"] for row in rows})
    distances = sorted({row["distance_m"] for row in rows})
    width = max(1.6 + 0.52 * len(distances), 6.0)
    height = 1.3 + len(lights) * (0.75 + 0.34 * len(bearings))
    title = f"{world}: pictures in which the marker is found, in %"
    labels = (
        "distance from camera to marker (m); grey: behind a wall; white: no room",
        "bearing (°)",
    )
    figure, grid = panels((len(lights), 1), (width, height), title, labels, False)
    for axes, ((light,), of_light) in zip(grid.flat, lights.items()):
        _draw_map(axes, of_light, distances, bearings)
        axes.set_title(f"{light} light", fontsize=10, loc="left")
    figure.tight_layout(rect=(0.0, 0.0, 1.0, 1.0 - 0.05 / height))
    return figure


def _draw_map(
    axes: Axes, rows: Sequence[Record], distances: Sequence[float], bearings: Sequence[float]
) -> None:
    axes.set_xlim(-0.5, len(distances) - 0.5)
    axes.set_ylim(-0.5, len(bearings) - 0.5)
    axes.set_xticks(range(len(distances)), [f"{value:g}" for value in distances], fontsize=8)
    axes.set_yticks(range(len(bearings)), [f"{value:g}" for value in bearings], fontsize=8)
    for row in rows:
        x, y = distances.index(row["distance_m"]), bearings.index(row["bearing_deg"])
        square = Rectangle((x - 0.5, y - 0.5), 1.0, 1.0)
        square.set(facecolor=_colour(row), edgecolor="white", linewidth=0.5)
        axes.add_patch(square)
        if row["visible"] or row["found"]:
            shade = "white" if row["rate"] < 0.25 or row["rate"] > 0.9999 else BLACK
            text = f"{math.floor(100.0 * row['rate']):d}"
            axes.text(x, y, text, ha="center", va="center", fontsize=7.5, color=shade)


def _colour(row: Record) -> str:
    if not row["visible"] and not row["found"]:
        return HIDDEN
    return COLOURS[int(np.searchsorted(BOUNDS, row["rate"], side="right")) - 1]


def range_figure(
    rows: Sequence[Record], pictures: Mapping[tuple[str, float], MarkerImage]
) -> Figure:
    """Draw the answer to the report's question: how close, how far.

    Left: the floor in front of the marker, with the rate of detection. Right: the `ranges_of` each
    world and light. Below: images from the ends of the first world's range, straight ahead in its
    own light, by world and distance.
    """
    figure = new_figure(13.0, 8.8)
    grid = figure.add_gridspec(
        2, 12, height_ratios=(1.6, 1.0), hspace=0.3, wspace=0.4,
        left=0.05, right=0.985, top=0.9, bottom=0.05,
    )  # fmt: skip
    (world, light), own = next(iter(grouped(rows, "world", "light").items()))
    ranges = ranges_of(rows)
    ends = ranges[0]["closest_m"], ranges[0]["farthest_frontal_m"]
    floor = figure.add_subplot(grid[0, :8])
    _draw_floor(floor, own, ends)
    floor.set_title(f"{world}, {light} light: where the marker is found")
    _add_scale(figure, floor)
    _draw_bars(figure.add_subplot(grid[0, 9:12]), ranges)
    of_world = {distance: pictures[name, distance] for name, distance in pictures if name == world}
    for index, distance in enumerate(_chosen(sorted(of_world), ends)):
        axes = figure.add_subplot(grid[1, 3 * index : 3 * index + 3])
        _show_picture(axes, of_world[distance])
        axes.set_title(f"{distance:g} m", fontsize=10)
    figure.suptitle(_headline(world, ends, own), fontsize=15)
    return figure


def _headline(world: str, ends: Ends, rows: Sequence[Record]) -> str:
    if ends[0] is None:
        return f"{world}: the marker is found from nowhere"
    limit = ", the farthest tried" if ends[1] == max(row["distance_m"] for row in rows) else ""
    where = f"from {ends[0]:g} m to {ends[1]:g} m{limit}"
    return f"Straight ahead the marker is found {where} ({world})"


def _draw_floor(axes: Axes, rows: Sequence[Record], ends: Ends) -> None:
    """Draw sectors of rings around the marker from above; it is on top and faces down."""
    rings = _edges(sorted({row["distance_m"] for row in rows}))
    sectors = _edges(sorted({row["bearing_deg"] for row in rows}))
    for row in rows:
        inner, outer = rings[row["distance_m"]]
        first, last = sectors[row["bearing_deg"]]
        for low, high in {(first, last), (-last, -first)}:
            axes.add_patch(
                Wedge((0.0, 0.0), outer, 270.0 + low, 270.0 + high, width=outer - inner,
                      facecolor=_colour(row), edgecolor="white", linewidth=0.4)
            )  # fmt: skip
    axes.plot([-0.125, 0.125], [0.0, 0.0], color=BLACK, linewidth=4.0, solid_capstyle="butt")
    for distance, colour in zip(ends, (ORANGE, VERMILION)):
        if distance is not None:
            _draw_robot(axes, distance, colour)
    reach = max(outer for _, outer in rings.values())
    wide = reach * math.sin(math.radians(min(90.0, max(last for _, last in sectors.values()))))
    axes.set_xlim(-wide - 0.3, wide + 0.3)
    axes.set_ylim(-reach - 0.3, 0.5)
    labels = {"xlabel": "beside the marker's axis (m)", "ylabel": "before the marker (m)"}
    axes.set(aspect="equal", **labels)


def _draw_robot(axes: Axes, distance: float, colour: str) -> None:
    """Draw the robot from above with its camera at a distance from the marker."""
    middle = -distance - CAMERA_AHEAD
    axes.add_patch(
        Circle((0.0, middle), ROBOT_RADIUS, facecolor="white", edgecolor=colour, linewidth=2.5)
    )
    axes.plot([0.0, 0.0], [middle, -distance], color=colour, linewidth=2.5)
    axes.annotate(
        f"{distance:g} m", (0.2, middle), (0.9, middle), va="center", fontsize=11,
        arrowprops={"arrowstyle": "-", "color": BLACK},
        bbox={"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": GREY},
    )  # fmt: skip


def _edges(values: Sequence[float]) -> dict[float, tuple[float, float]]:
    """Return, for each of the sorted values, the midpoints to its neighbours."""
    middles = [0.5 * (a + b) for a, b in zip(values, values[1:])]
    first = max(0.0, values[0] - (middles[0] - values[0] if middles else 0.1))
    last = values[-1] + (values[-1] - middles[-1] if middles else 0.1)
    edges = [first, *middles, last]
    return dict(zip(values, zip(edges, edges[1:])))


def _add_scale(figure: Figure, axes: Axes) -> None:
    norm = BoundaryNorm(range(len(BOUNDS)), len(COLOURS))
    names = ("never", "< 25 %", "< 50 %", "< 75 %", "< 95 %", "≥ 95 %", "all")
    scale = figure.colorbar(
        ScalarMappable(norm, ListedColormap(COLOURS)), ax=axes, fraction=0.03, pad=0.015
    )
    scale.set_ticks([k + 0.5 for k in range(len(names))], labels=names)
    scale.ax.tick_params(length=0, labelsize=8)


def _draw_bars(axes: Axes, bars: Sequence[Record]) -> None:
    for index, entry in enumerate(bars):
        first, last, aside = (
            entry[k] for k in ("closest_m", "farthest_frontal_m", "farthest_30deg_m")
        )
        if first is None:
            axes.text(0.1, index, "nowhere", va="center", fontsize=8, color=VERMILION)
            continue
        axes.barh(index, last - first, left=first, height=0.55, color=BLUE)
        text = f"{first:g} – {last:g}"
        axes.text(last + 0.1, index, text, va="center", fontsize=8)
        if aside is not None:
            axes.plot([aside], [index], marker="D", color=ORANGE, markersize=5, linestyle="")
    names = [
        one["world"] if one["light"] == DEFAULT_LIGHT else f"{one['world']}\n{one['light']} light"
        for one in bars
    ]
    axes.set_yticks(range(len(bars)), names, fontsize=8)
    axes.set_ylim(max(len(bars) - 0.4, 4.6), -0.6)
    axes.set_xlim(0.0, 1.3 * max(one["farthest_frontal_m"] or 1.0 for one in bars))
    axes.set_xlabel("distance with ≥ 95 % found (m)")
    axes.set_title("frontal; ◆ farthest at 30°", fontsize=10)
    axes.grid(axis="x", alpha=0.3)
    axes.set_axisbelow(True)


def _chosen(distances: Sequence[float], ends: Ends) -> Sequence[float]:
    """Return up to four distances: the range's ends, one between them, and one beyond."""
    if not distances or ends[0] is None:
        return distances[:4]
    inside = [d for d in distances if ends[0] <= d <= ends[1]]
    beyond = [d for d in distances if d > ends[1]][:1]
    return list(dict.fromkeys([inside[0], inside[len(inside) // 2], inside[-1], *beyond]))


def _show_picture(axes: Axes, snapshot: MarkerImage) -> None:
    axes.imshow(snapshot.picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    axes.set_xticks([])
    axes.set_yticks([])
    for corners in snapshot.corners:
        axes.add_patch(Polygon(corners, fill=False, edgecolor=VERMILION, linewidth=1.5))
    if not len(snapshot.corners):
        axes.set_xlabel("not found", color=VERMILION)
        return
    axes.set_xlabel("found")
    _zoom(axes, snapshot.corners[0], snapshot.picture.shape)


def _zoom(axes: Axes, corners: ndarray, shape: tuple[int, ...]) -> None:
    """Limit the axes to a marker and its surroundings, within the image."""
    side = float(np.linalg.norm(corners[0] - corners[1]))
    middle = corners.mean(axis=0)
    height = min(PICTURE_SPAN * side, shape[0])
    width = min(height * shape[1] / shape[0], shape[1])
    left = np.clip(middle[0] - 0.5 * width, 0.0, shape[1] - width) - 0.5
    top = np.clip(middle[1] - 0.5 * height, 0.0, shape[0] - height) - 0.5
    axes.set_xlim(left, left + width)
    axes.set_ylim(top + height, top)


def run_detection_range(
    folder: Path,
    settings: RangeSettings,
    run: Run = this_process,
    tell: Tell = print,
) -> Summary:
    """Try all cells; write table, heat maps, figure and summary.json; return the summary.

    The same settings give the same files, with any workers. Raises LabError if no cell has room for
    the camera, nothing can be rendered, the folder cannot be written to, or a task was lost.
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
    # Not of a world without room.
    figures = {
        f"heat_map_{world}.png": heat_map(world, of_world)
        for (world,), of_world in grouped(rows, "world").items()
    }
    figures["detection_range.png"] = range_figure(rows, pictures)
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
