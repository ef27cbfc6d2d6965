"""All dockings of a campaign: where they started, where they ended, and how far off."""

from __future__ import annotations

import math
from typing import Any, Iterable, List, Mapping, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bullet_lab.core.figures import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    VERMILION,
    Outline,
    draw_plan,
    new_figure,
)
from bullet_lab.studies.dock_campaign.results import DOCKED

Record = Mapping[str, Any]

TICK = 0.18
BINS = 24
HISTOGRAMS = (
    ("distance_error_m", 1000.0, "distance error (mm)"),
    ("lateral_error_m", 1000.0, "lateral error (mm)"),
    ("yaw_error_deg", 1.0, "yaw error (°)"),
)


def campaign_figure(
    records: Sequence[Record], outlines: Iterable[Outline], dock: Sequence[float], title: str
) -> Figure:
    """Draw starts and ends over the dock's plan, the ends close up, and the errors.

    Blue is docked and vermilion is not; those that are not are crossed as well.

    Args:
        records: of at least one docking.
        outlines: of all that stands in the worlds, in m.
        dock: x, y (m) and yaw (rad) of the floor below the marker's face.
        title: above all.
    """
    figure = new_figure(11.0, 8.8)
    figure.suptitle(title)
    left, right = figure.add_gridspec(
        1, 2, width_ratios=(0.75, 1.0), wspace=0.2, left=0.07, right=0.98, top=0.93, bottom=0.07
    )
    docked = [record for record in records if record["result"] == DOCKED]
    failed = [record for record in records if record["result"] != DOCKED]
    _draw_all(figure.add_subplot(left), (docked, failed), outlines, dock)
    rows = right.subgridspec(4, 1, height_ratios=(2.1, 1.0, 1.0, 1.0), hspace=0.5)
    _draw_close_up(figure.add_subplot(rows[0]), docked)
    for row, (name, scale, label) in zip(list(rows)[1:], HISTOGRAMS):
        _draw_histogram(figure.add_subplot(row), [scale * record[name] for record in docked], label)
    return figure


def _draw_all(
    axes: Axes,
    groups: Tuple[Sequence[Record], Sequence[Record]],
    outlines: Iterable[Outline],
    dock: Sequence[float],
) -> None:
    draw_plan(axes, outlines, dock)
    docked, failed = groups
    for records, colour, name in ((docked, BLUE, "docked"), (failed, VERMILION, "failed")):
        if not records:
            continue
        size = 5.0 if records is failed else 3.0
        starts = _poses(records, "start")
        axes.plot(*_ticks(starts), color=colour, linewidth=0.8)
        label = f"start, {name} ({len(records)})"
        axes.plot(starts[:, 0], starts[:, 1], "o", color=colour, markersize=size, label=label)
        ends = _poses([r for r in records if r["end_x_m"] is not None], "end")
        face = ORANGE if records is docked else VERMILION
        mark, label = ("s", "end, docked") if records is docked else ("X", "end, failed")
        axes.plot(
            ends[:, 0],
            ends[:, 1],
            mark,
            color=face,
            markeredgecolor=BLACK,
            markeredgewidth=0.5,
            markersize=5.0 if records is docked else 7.0,
            label=label,
        )
    axes.legend(loc="lower right", fontsize="small")


def _poses(records: Sequence[Record], which: str) -> np.ndarray:
    """Return x, y (m) and yaw (rad) of starts or ends, shape (n, 3)."""
    rows: List[Tuple[float, float, float]] = [
        (
            record[f"{which}_x_m"],
            record[f"{which}_y_m"],
            math.radians(record[f"{which}_yaw_deg"]),
        )
        for record in records
    ]
    return np.array(rows).reshape(-1, 3)


def _ticks(poses: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return x and y of a broken line with a short piece in the heading of each pose."""
    x, y, yaw = poses.T
    gap = np.full_like(x, np.nan)
    ahead = np.stack([x, x + TICK * np.cos(yaw), gap], axis=1).ravel()
    return ahead, np.stack([y, y + TICK * np.sin(yaw), gap], axis=1).ravel()


def _draw_close_up(axes: Axes, docked: Sequence[Record]) -> None:
    axes.set(xlabel="distance error (mm)", ylabel="lateral error (mm)")
    axes.set_title("where the docked robots stand", fontsize="medium")
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    axes.grid(alpha=0.3)
    if not docked:
        return
    distance = [1000.0 * record["distance_error_m"] for record in docked]
    lateral = [1000.0 * record["lateral_error_m"] for record in docked]
    axes.plot(distance, lateral, ".", color=BLUE, markersize=5.0)
    axes.set_aspect("equal", adjustable="datalim")


def _draw_histogram(axes: Axes, values: Sequence[float], label: str) -> None:
    axes.set(xlabel=label, ylabel="dockings")
    axes.grid(alpha=0.3)
    if not values:
        return
    axes.hist(values, bins=BINS, color=BLUE, edgecolor="white", linewidth=0.4)
    median = float(np.median(np.abs(values)))
    # Half of the dockings are between these two lines.
    axes.axvline(-median, color=BLACK, linestyle="-")
    axes.axvline(median, color=BLACK, linestyle="-", label=f"median of the sizes {median:.2f}")
    largest = values[int(np.argmax(np.abs(values)))]
    axes.axvline(largest, color=BLACK, linestyle=":", label=f"largest {abs(largest):.2f}")
    axes.legend(fontsize="small")
