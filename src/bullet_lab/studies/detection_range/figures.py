"""Figures of the detection range: heat maps, and one of the limits."""

from __future__ import annotations

import math
from typing import Mapping, Optional, Sequence, Tuple

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle, Wedge
from numpy import ndarray

from bullet_lab.core.figures import BLACK, BLUE, GREY, ORANGE, VERMILION, new_figure, panels
from bullet_lab.studies.detection_range.trial import MarkerImage
from bullet_lab.studies.study import Record
from bullet_lab.studies.worlds import DEFAULT_LIGHT

Ends = Tuple[Optional[float], Optional[float]]
"""Closest and farthest distance (m) of a range, None without one."""

# Shares of images with the marker found: none, few, half, most, nearly all (95 %), all.
BOUNDS = (0.0, 0.001, 0.25, 0.5, 0.75, 0.95, 0.9999, 1.0001)
COLOURS = ("#4d4d4d", "#b2182b", "#d6604d", "#f4a582", "#fddbc7", "#92c5de", "#2166ac")
HIDDEN = "#e8e8e8"
ROBOT_RADIUS = 0.2
CAMERA_AHEAD = 0.16
PICTURE_SPAN = 5.0
"""Height of the part of an image that is shown, in sides of the marker."""


def heat_map(world: str, rows: Sequence[Record]) -> Figure:
    """Draw the share of images with the marker found in a world: a map for each light.

    Args:
        world: its name.
        rows: of all its cells, as in the table.
    """
    lights = list(dict.fromkeys(row["light"] for row in rows))
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
    for axes, light in zip(grid.flat, lights):
        of_light = [row for row in rows if row["light"] == light]
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
    rows: Sequence[Record],
    ranges: Sequence[Record],
    pictures: Mapping[tuple[str, float], MarkerImage],
) -> Figure:
    """Draw the answer to the report's question: how close, how far.

    Left: the floor in front of the marker, with the rate of detection. Right: the range in each
    world and light. Below: images from the ends of the first world's range.

    Args:
        rows: of all cells, as in the table.
        ranges: their `ranges_of`.
        pictures: by world and distance, straight ahead in the world's own light.
    """
    figure = new_figure(13.0, 8.8)
    grid = figure.add_gridspec(
        2, 12, height_ratios=(1.6, 1.0), hspace=0.3, wspace=0.4,
        left=0.05, right=0.985, top=0.9, bottom=0.05,
    )  # fmt: skip
    world, light = rows[0]["world"], rows[0]["light"]
    own = [row for row in rows if (row["world"], row["light"]) == (world, light)]
    (entry,) = (one for one in ranges if (one["world"], one["light"]) == (world, light))
    ends = entry["closest_m"], entry["farthest_frontal_m"]
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
    picture = cv2.imdecode(np.frombuffer(snapshot.png, np.uint8), cv2.IMREAD_GRAYSCALE)
    axes.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    axes.set_xticks([])
    axes.set_yticks([])
    for corners in snapshot.corners:
        axes.add_patch(Polygon(corners, fill=False, edgecolor=VERMILION, linewidth=1.5))
    if not len(snapshot.corners):
        axes.set_xlabel("not found", color=VERMILION)
        return
    axes.set_xlabel("found")
    _zoom(axes, snapshot.corners[0], picture.shape)


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
