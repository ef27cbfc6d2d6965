"""Figures of the published noise: its paths, and the effect of each defect."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Callable, Mapping, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy import ndarray

from bullet_lab.core.figures import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    VERMILION,
    legend_below,
    legend_entry,
    new_figure,
    panels,
)
from bullet_lab.core.se2 import wrap
from bullet_lab.noise.published_noise import ALL, DEFECTS, NONE, Defects
from bullet_lab.studies.published_noise.results import (
    EVIDENCE,
    LENGTHS,
    PublishedFigure,
    PValue,
    Result,
    groups_of_same,
)

PLAIN_NAMES = {
    "aliasing": "aliasing",
    "unwrapped": "no wrapping",
    "noise_at_rest": "noise at rest",
    "sampled": "0.9 Hz",
    "unbent": "heading bends nothing",
}
"""Names of the defects in figures."""

_WINDOW = ((-0.55, 2.35), (-2.4, 0.5))  # m, of all small paths
# The perfect path is wide and below, so that both are visible where they coincide.
_PERFECT = {"color": ORANGE, "linewidth": 3.2, "zorder": 3}
_NOISY = {"color": BLUE, "linewidth": 1.2, "zorder": 4}
_OTHERS = {"color": BLUE, "linewidth": 0.5, "alpha": 0.3, "zorder": 2}
_PERFECT_MARKS = {"color": ORANGE, "marker": "s", "linestyle": "", "markersize": 4}
_SMALLEST_DRAWN = 1e-4  # m; smaller lengths are drawn here

Shown = Callable[[Defects], Tuple[ndarray, PValue]]
"""Returns noisy paths (m), shape (n, m, 2), and the p-value of figure 1b."""


def compare_figure(
    figure_1b: PublishedFigure, corners: ndarray, replays: Sequence[ndarray], seed: int
) -> Figure:
    """Draw figure 1b, the report's algorithm replayed, and the mended one, with a seed.

    `corners` are those of the simulated perfect path (m), (5, 2), `replays` the points of the two
    algorithms (m), (n, 2).
    """
    labels = ("x (m)", "y (m)")
    figure, (row,) = panels((1, 3), (11.0, 4.3), "", labels, sharex=True, sharey=True)
    figure.subplots_adjust(left=0.06, right=0.99, top=0.91, bottom=0.2, wspace=0.06)
    contents = (
        ("Figure 1b as published", figure_1b.points, figure_1b.perfect_corners),
        (f"The report's algorithm, seed {seed}", replays[0], corners),
        (f"The mended algorithm, seed {seed}", replays[1], corners),
    )
    for axes, (title, noisy, square) in zip(row, contents):
        _frame(axes)
        axes.set_title(title, fontsize=11)
        axes.plot(*noisy.T, **_NOISY)
        axes.plot(*square.T, **_PERFECT)
    noisy = legend_entry("noisy odometry", **_NOISY)
    legend_below(figure, [noisy, legend_entry("perfect odometry", **_PERFECT)])
    return figure


def defects_figure(
    figure_1b: PublishedFigure, corners: ndarray, shown: Shown, best: Defects, std: float
) -> Figure:
    """Draw a sheet of small paths: figure 1b, all defects, the best one, none, each, all but each.

    `shown` returns some noisy paths of a combination, of which the first is drawn in bold; `best`
    is the combination with the largest p-value. The corners of the simulated perfect path are in m,
    (5, 2).
    """
    figure, grid = panels((3, 5), (11.5, 7.9), sharex=True, sharey=True)
    figure.subplots_adjust(left=0.05, right=0.99, top=0.94, bottom=0.05, wspace=0.06, hspace=0.25)
    for axes in grid.flat:
        _frame(axes)
        axes.tick_params(labelsize=8)
    first, alone, all_but = grid
    first[0].set_title("figure 1b, as published", fontsize=9, fontweight="bold")
    first[0].plot(*figure_1b.points.T, **_NOISY)
    first[0].plot(*figure_1b.perfect_corners.T, **_PERFECT)
    found = "the most usual: " + (" + ".join(PLAIN_NAMES[name] for name in best.names) or "none")
    drawn = [
        (first[1], "all five: as published", ALL),
        (first[2], found, best),
        (first[3], "none: mended", NONE),
    ]
    for one, other, (name, plain) in zip(alone, all_but, PLAIN_NAMES.items()):
        drawn.append((one, f"only {plain}", replace(NONE, **{name: True})))
        drawn.append((other, f"all but {plain}", replace(ALL, **{name: False})))
    for axes, title, defects in drawn:
        _draw_paths(axes, title, corners, *shown(defects))
    _draw_legend(first[4], std)
    return figure


def _frame(axes: Axes) -> None:
    ticks = {"xticks": (0, 1, 2), "yticks": (0, -1, -2)}
    axes.set(aspect="equal", xlim=_WINDOW[0], ylim=_WINDOW[1], **ticks)


def _draw_paths(axes: Axes, title: str, corners: ndarray, paths: ndarray, p_value: PValue) -> None:
    axes.set_title(_in_two_lines(title), fontsize=9)
    axes.plot(paths[:, 1:, 0], paths[:, 1:, 1], **_OTHERS)
    axes.plot(*paths[:, 0].T, **_NOISY)
    axes.plot(*corners.T, **_PERFECT)
    explains = p_value.explains
    words = "explains 1b" if explains else "does not" if p_value.excludes else "too few seeds"
    axes.text(
        *corners[:4].mean(axis=0),
        f"p {_p_text(p_value, '= ')}\n{words}",
        ha="center",
        va="center",
        fontsize=9,
        fontweight="bold" if explains else "normal",
        bbox={"facecolor": "white", "edgecolor": BLACK if explains else "none", "alpha": 0.9},
        zorder=5,
    )


def _in_two_lines(title: str) -> str:
    if len(title) <= 28:
        return title
    spaces = (k for k, letter in enumerate(title) if letter == " ")
    middle = min(spaces, key=lambda k: abs(k - len(title) / 2))
    return f"{title[:middle]}\n{title[middle + 1 :]}"


def _draw_legend(axes: Axes, std: float) -> None:
    axes.axis("off")
    handles = [
        legend_entry("perfect path", **_PERFECT),
        legend_entry("noisy path, first seed", **_NOISY),
        legend_entry("other seeds", **_OTHERS),
    ]
    axes.legend(handles=handles, loc="upper center", fontsize=9, frameon=False)
    text = f"std = {std:g}; axes in m.\n\np: how usual figure 1b\nwould be, were these\nthe defects"
    axes.text(0.5, 0.5, text, ha="center", va="top", fontsize=9, transform=axes.transAxes)


def corners_figure(
    figure_1b: PublishedFigure, corners: ndarray, shown: Mapping[str, ndarray]
) -> Figure:
    """Draw the beginning and the end of the first side, enlarged: figure 1b and some replays.

    `shown` has noisy paths (m), (n, m, 2), by name, the first in bold; the corners of the simulated
    perfect path are in m, (5, 2).
    """
    shape, labels = (2, 1 + len(shown)), ("", "y (mm)")
    figure, grid = panels(shape, (11.0, 6.4), "", labels, sharex="row", sharey="row")
    figure.subplots_adjust(left=0.07, right=0.99, top=0.94, bottom=0.16, wspace=0.06, hspace=0.27)
    published = figure_1b.points[:, np.newaxis], figure_1b.perfect_corners
    contents = {"figure 1b": published, **{name: (p, corners) for name, p in shown.items()}}
    for (start, corner), (title, (paths, square)) in zip(grid.T, contents.items()):
        start.set_title(title, fontsize=11)
        for axes, place in ((start, square[0]), (corner, square[1])):
            lines = np.moveaxis(1e3 * (paths - place), 2, 0)
            axes.plot(*lines[:, :, 1:], **_OTHERS)
            axes.plot(*lines[:, :, 0], marker="o", markersize=4, **_NOISY)
            axes.plot(*(1e3 * (square - place)).T, **_PERFECT)
        start.set(xlim=(-30, 900), ylim=(-8, 8), xlabel="x from the start (mm)")
        corner.set(xlim=(-80, 80), ylim=(-40, 20), xlabel="x from corner 1 (mm)")
    handles = [
        legend_entry("noisy odometry", marker="o", **_NOISY),
        legend_entry("other seeds", **_OTHERS),
        legend_entry("perfect odometry", **_PERFECT),
    ]
    legend_below(figure, handles)
    return figure


def lengths_figure(results: Sequence[Result], measured: ndarray) -> Figure:
    """Draw the lengths read from replays of all combinations, and from figure 1b (m, (6,)).

    Equal ones of the ranked results share a line.
    """
    rows = groups_of_same(results)
    figure = new_figure(13.5, 1.45 + 0.26 * len(rows))
    head = 0.48 / figure.get_figheight()
    grid = figure.add_gridspec(
        1,
        2 + len(LENGTHS),
        width_ratios=[2.0, *[1.7] * len(LENGTHS), 2.6],
        left=0.01,
        right=0.995,
        top=1.0 - head,
        bottom=0.95 / figure.get_figheight(),
        wspace=0.06,
    )
    left, *middle, right = [figure.add_subplot(cell) for cell in grid]
    _draw_switches(left, rows)
    quantiles = np.array([group[0].quantiles for group in rows])
    for number, (axes, name) in enumerate(zip(middle, LENGTHS)):
        axes.set_title(name.replace("side", "side "), fontsize=10)
        _draw_length(axes, quantiles[:, :, number], measured[number])
    _draw_p_values(right, [group[0].p_values for group in rows])
    for axes in (left, *middle, right):
        axes.set_ylim(len(rows) - 0.5, -0.5)
        for y in range(0, len(rows), 2):
            axes.axhspan(y - 0.5, y + 0.5, color="0.94", zorder=0, linewidth=0)
    handles = [
        legend_entry("defect: in", **_mark(True)),
        legend_entry("mended", **_mark(False)),
        legend_entry("in or mended: the same", **_mark(None)),
        legend_entry("figure 1b", color=VERMILION, linewidth=1.5),
        legend_entry("5 to 95 % of the seeds", color=BLUE, linewidth=1.0),
        legend_entry("25 to 75 %", color=BLUE, linewidth=4.0),
        legend_entry("median", color="white", marker="o", markeredgecolor=BLACK),
    ]
    legend_below(figure, handles, 4, fontsize=8.5)
    return figure


def _draw_switches(axes: Axes, rows: Sequence[Sequence[Result]]) -> None:
    axes.set_xlim(-0.7, len(DEFECTS) - 0.3)
    for y, group in enumerate(rows):
        for x, name in enumerate(DEFECTS):
            values = {getattr(result.defects, name) for result in group}
            axes.plot(x, y, zorder=3, **_mark(values.pop() if len(values) == 1 else None))
    axes.set_xticks(range(len(DEFECTS)))
    axes.xaxis.tick_top()
    axes.set_xticklabels(
        ["alias-\ning", "no\nwrap", "noise\nat rest", "0.9\nHz", "bends\nnothing"], fontsize=7
    )
    axes.tick_params(length=0, left=False, labelleft=False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _mark(switch: bool | None) -> dict:
    """Return the style of a switch that is on, off, or None: without effect."""
    if switch is None:
        return {"linestyle": "", "marker": "_", "color": BLACK, "markersize": 7}
    face, edge = (BLACK, BLACK) if switch else ("white", GREY)
    colours = {"markerfacecolor": face, "markeredgecolor": edge}
    return {"linestyle": "", "marker": "o", "markersize": 6.5, **colours}


def _draw_length(axes: Axes, quantiles: ndarray, measured: float) -> None:
    """Draw quantiles (m), a row of five for each line, and the measured length."""
    low, lower, middle, upper, high = np.maximum(quantiles, _SMALLEST_DRAWN).T
    y = np.arange(len(quantiles))
    axes.hlines(y, low, high, color=BLUE, linewidth=1.0, zorder=2)
    axes.hlines(y, lower, upper, color=BLUE, linewidth=4.0, zorder=2)
    axes.plot(middle, y, "o", color="white", markeredgecolor=BLACK, markersize=4.5, zorder=4)
    axes.axvline(max(measured, _SMALLEST_DRAWN), color=VERMILION, linewidth=1.5, zorder=3)
    axes.set_xscale("log")
    axes.set_xlim(0.8 * _SMALLEST_DRAWN, 6.0)
    axes.set_xticks([1e-4, 1e-3, 1e-2, 0.1, 1.0])
    axes.set_xticklabels(["≤.1", "1", "10", "100", "1000"], fontsize=8)
    axes.minorticks_off()
    axes.set_xlabel("length (mm)", fontsize=8)
    axes.tick_params(left=False, labelleft=False)
    axes.grid(axis="x", alpha=0.3)


def _draw_p_values(axes: Axes, rows: Sequence[Mapping[str, PValue]]) -> None:
    axes.axis("off")
    axes.set_xlim(-0.5, len(EVIDENCE) - 0.5)
    for x, name in enumerate(EVIDENCE):
        axes.text(x, -0.75, f"p of\n{name}", ha="center", va="bottom", fontsize=8)
        for y, row in enumerate(rows):
            weight = "bold" if row[name].explains else "normal"
            text = _p_text(row[name])
            axes.text(x, y, text, ha="center", va="center", fontsize=9, fontweight=weight)


def _p_text(p_value: PValue, equals: str = "") -> str:
    """Return a p-value, or its upper bound if that is small enough."""
    if p_value.excludes:
        return f"< {math.ceil(1e3 * p_value.high) / 1e3:g}"
    return f"{equals}{p_value.value:.2f}"


def first_turns_figure(
    runs: Mapping[Defects, tuple[ndarray, ndarray, ndarray]],
    third_side: tuple[float, float],
) -> Figure:
    """Draw the heading, the first rotation of each step and the error of replays.

    Args:
        runs: for each combination (with aliasing) the stamps (s), the perfect poses the
            algorithm sees and the noisy ones, shapes (n,), (n, 3) and (n, 3).
        third_side: when it begins and ends (s).
    """
    shape, labels = (3, len(runs)), ("time (s)", "")
    figure, rows = panels(shape, (9.0, 6.2), "", labels, sharex=True, sharey="row")
    figure.subplots_adjust(left=0.1, right=0.985, top=0.94, bottom=0.15, wspace=0.06, hspace=0.14)
    for column, (defects, run) in zip(rows.T, runs.items()):
        _draw_turns(column, defects.unwrapped, *run)
        for axes in column:
            axes.axvspan(*third_side, color="0.88", zorder=0, linewidth=0)
    labels = ("published yaw (°)", "rot1 of the step (°)", "position error (mm)")
    for axes, label in zip(rows[:, 0], labels):
        axes.set_ylabel(label)
    rows[0, 0].set(ylim=(-200, 200), yticks=(-180, -90, 0, 90, 180))
    rows[1, 0].set(ylim=(-400, 400), yticks=(-360, -180, 0, 180, 360))
    rows[2, 0].set_ylim(bottom=0.0)
    handles = [
        legend_entry("noisy odometry", marker="o", markersize=3, **_NOISY),
        legend_entry("perfect odometry", **_PERFECT_MARKS),
        Patch(facecolor="0.88", label="third side"),
    ]
    legend_below(figure, handles)
    return figure


def _draw_turns(
    column: Sequence[Axes], unwrapped: bool, stamps: ndarray, perfect: ndarray, noisy
) -> None:
    heading, turn, error = column
    heading.set_title("as published" if unwrapped else "the same, but wrapped")
    steps = perfect[1:, :2] - noisy[:-1, :2]
    rot1 = np.arctan2(steps[:, 1], steps[:, 0]) - noisy[:-1, 2]
    rot1 = rot1 if unwrapped else wrap(rot1)
    heading.plot(stamps, np.degrees(perfect[:, 2]), **_PERFECT_MARKS)
    heading.plot(stamps, np.degrees(noisy[:, 2]), "o-", markersize=3, **_NOISY)
    turn.plot(stamps[1:], np.degrees(rot1), "o-", markersize=3, **_NOISY)
    distance = np.hypot(*(noisy - perfect)[:, :2].T)
    error.plot(stamps, 1e3 * distance, "o-", markersize=3, **_NOISY)
