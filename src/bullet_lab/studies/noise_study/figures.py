"""Figures of a noise study.

Noisy paths are blue and the perfect one is orange, as in all figures; exact moments are black,
first-order ones vermilion and dashed.
"""

from __future__ import annotations

from typing import Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import viridis
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FixedLocator, FuncFormatter, LogFormatter, NullLocator
from numpy import ndarray

from bullet_lab.core.figures import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    VERMILION,
    gridded,
    labelled,
    legend_below,
    legend_entry,
    new_figure,
    panels,
)
from bullet_lab.core.se2 import LEVEL, ellipse_points
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.noise.exact_moments import Moments, exact_moments
from bullet_lab.noise.noisy_paths import noisy_blocks, noisy_steps, study_generator
from bullet_lab.noise.odometry_noise import MODELS
from bullet_lab.studies.noise_study.regions import (
    CLOUD,
    LEVELS,
    MEANT,
    METHODS,
    TOLERANCE,
    Cloud,
    Region,
    Regions,
    inverse_of,
    level_rule,
    position_density,
    theory,
)
from bullet_lab.studies.noise_study.statistics import (
    Case,
    by_model_of,
    noisy_levels,
    shown_levels,
    spread,
)
from bullet_lab.studies.paths import find_corners, resample

COLUMNS = 5
CURVES = 5
PANELS = 3
SHOWN_RATES = 3
TYPICAL_LEVEL = 0.1

BANDS = "; bands: 95 % confidence"

STYLES = {
    "exact": ("o-", BLACK),
    "first_order": ("s--", VERMILION),
    "exponential": ("D-", GREEN),
    "published": ("^:", BLUE),
}
"""Lines and colours of the methods."""

# Of the size of the path; the rest is cut off.
_LARGEST_MARGIN = 0.6
_RATES_ON_CURVE = 24
# Points per side of a grid of densities.
_GRID = 160

Window = Tuple[ndarray, ndarray]
"""The least and the largest x and y that are drawn (m)."""


def levels_figure(cases: Sequence[Case]) -> Figure:
    """Draw a sheet of noisy paths for each of the cases, which are levels, all to one scale."""
    rows = -(-len(cases) // COLUMNS)
    columns = min(COLUMNS, len(cases))
    least, most = window = _window(cases)
    width, height = most - least
    size = 0.8 + 2.6 * columns, 1.3 + rows * (min(2.6 * height / width, 5.0) + 0.35)
    first = cases[0]
    title = (
        f"{MODELS[first.model].title} noise at {first.rate:g} Hz: "
        f"{len(first.kept)} of {first.regions.paths} paths at each level"
    )
    labels = ("x (m)", "y (m)")
    figure, grid = panels((rows, columns), size, title, labels, False, sharex=True, sharey=True)
    for axes, case in zip(grid.flat, cases):
        _draw_sheet(axes, case, window)
        axes.set_title(f"std {case.std:g}", fontsize=10)
    for axes in grid.flat[len(cases) :]:
        axes.set_axis_off()
    _add_sheet_legend(figure)
    return figure


def distance_figure(cases: Sequence[Case]) -> Figure:
    """Draw the error against the distance travelled, and the closed form over it; one rate."""
    title = "Error against distance"
    labels = ("distance travelled (m)", "rms distance from the perfect path (m)")
    figure, (row,), by_model = _model_panels(cases, (1, 4.3, 0.6, 4.6), title, labels)
    for axes, (model, of_model) in zip(row, by_model.items()):
        shown = shown_levels(of_model, CURVES)
        for case, colour in zip(shown, _colours(len(shown))):
            _draw_error(axes, case, colour)
        axes.set(title=MODELS[model].title, yscale="log")
        _plain_numbers(axes.yaxis)
        axes.margins(x=0.0)
        axes.set_xlim(right=1.2 * cases[0].trajectory.length())
    handles = [
        legend_entry("sample (colour: std)", color=GREY, linewidth=3.2),
        legend_entry("closed form, exact", linestyle="--", color=BLACK, linewidth=1.0),
        legend_entry("first order", linestyle=":", color=VERMILION, linewidth=1.6),
    ]
    legend_below(figure, handles, bottom=0.07)
    return figure


def rates_figure(cases: Sequence[Case], trajectory: Trajectory) -> Figure:
    """Draw the effect of the message rate on each model: paths, and the error at the end.

    The cases are of all models, rates and levels; the trajectory is the given path.
    """
    by_model = by_model_of(cases)
    rates = spread(sorted({case.rate for case in cases}), SHOWN_RATES)
    level = min({case.std for case in cases}, key=lambda std: abs(std - TYPICAL_LEVEL))
    sheets = [case for case in cases if case.std == level and case.rate in rates]
    window = _window(sheets)
    figure, grid = panels(
        (len(by_model), len(rates) + 1),
        (2.5 * len(rates) + 4.4, 0.9 + 2.75 * len(by_model)),
        f"Dependence on the message rate; paths at std {level:g}",
        ("x (m)", ""),
        False,
        gridspec_kw={"width_ratios": [1.0] * len(rates) + [1.35]},
    )
    for row, (model, of_model) in zip(grid, by_model.items()):
        for axes, rate in zip(row, rates):
            case = next(c for c in of_model if c.rate == rate and c.std == level)
            _draw_sheet(axes, case, window)
            axes.set_title(f"{rate:g} Hz", fontsize=10)
        row[0].set_ylabel(f"{MODELS[model].title}\n\ny (m)")
        _draw_rates(row[-1], of_model, trajectory)
    grid[0, -1].set_title("rms error at the end (m) by std", fontsize=10)
    grid[-1, -1].set_xlabel("message rate (Hz); line: exact")
    shared = [axes.get_ylim() for axes in grid[:, -1]]
    for axes in grid[:, -1]:
        axes.set_ylim(min(low for low, _ in shared), 1.3 * max(high for _, high in shared))
    _add_sheet_legend(figure)
    return figure


def regions_figure(cases: Sequence[Case]) -> Figure:
    """Draw coverage at each level of confidence, and the NEES, at the end; one rate."""
    size, title = (len(LEVELS) + 1, 4.0, 0.8, 10.5), "Regions of x, y and heading at the end"
    figure, grid, by_model = _model_panels(cases, size, title, ("std", ""), BANDS)
    for column, (model, of_model) in zip(grid.T, by_model.items()):
        *shares, nees = column
        column[0].set_title(MODELS[model].title)
        std = [case.std for case in of_model]
        for method in METHODS:
            found = [case.regions.found[method][-1] for case in of_model]
            for level, axes in enumerate(shares):
                _draw_shares(axes, std, found, method, level)
            rows = [(x, r.nees, *r.nees_band) for x, r in zip(std, found) if r]
            _draw_band(nees, rows, method)
        nees.axhline(3.0, color=GREY, linewidth=5.0, alpha=0.5, zorder=0.5)
        nees.set(yscale="log")
        _plain_numbers(nees.yaxis)
    for level, axes in zip(LEVELS, grid[:, 0]):
        axes.set_ylabel(f"in the {100 * level:g} % region (%)")
    grid[-1, 0].set_ylabel("mean NEES; 3 is right")
    _add_method_legend(figure, grid)
    return figure


def distances_figure(cases: Sequence[Case]) -> Figure:
    """Draw the coverage of 95 % regions against distance, for some levels; one rate."""
    shown = {m: shown_levels(its, PANELS) for m, its in by_model_of(cases).items()}
    rows = max(1, *map(len, shown.values()))
    title = "95 % regions of x, y and heading along the path"
    labels = ("distance travelled (m)", "in the 95 % region (%)")
    size = (rows, 4.0, 0.8, 2.7 * rows + 0.8)
    figure, grid, _ = _model_panels(cases, size, title, labels, BANDS)
    for column, (model, levels) in zip(grid.T, shown.items()):
        for axes, case in zip(column, levels):
            regions = case.regions
            for method in METHODS:
                _draw_shares(axes, regions.travelled, regions.found[method], method, MEANT)
            axes.set_title(f"{MODELS[model].title}, std {case.std:g}", fontsize=10)
    _add_method_legend(figure, grid)
    return figure


def banana_figure(cases: Sequence[Case], seed: int) -> Figure:
    """Draw clouds of noisy positions and their 95 % regions, for some levels; one rate.

    The model is the one whose clouds are most bent. Above: at the pose of the path with the most
    bent cloud. Below: at the end of a straight line of the same length.
    """
    most = max(cases, key=lambda case: case.theory.quadratic_share())
    bent = noisy_levels(by_model_of(cases)[most.model])
    strong = [case for case in bent if not case.theory.first_order_enough()]
    levels = spread(strong if len(strong) >= PANELS else bent, PANELS)
    title = (
        f"{MODELS[most.model].title} noise: where the robot is, and 95 % regions; "
        "above the path where it is bent most, below a straight line"
    )
    size = 4.0 * max(2, len(levels)) + 0.6, 8.4
    figure, grid = panels((2, len(levels)), size, title, ("error of x (m)", "error of y (m)"))
    for column, case in zip(grid.T, levels):
        on_path = case.regions.cloud(case.regions.most_bent())
        for axes, cloud in zip(column, (on_path, _cloud_of_line(case, seed))):
            _draw_cloud(axes, cloud)
            axes.set_title(f"std {case.std:g}, after {cloud.travelled:.1f} m", fontsize=10)
    handles = [
        legend_entry("noisy", linestyle="", marker=".", color=BLUE),
        legend_entry("perfect", linestyle="", marker="+", color=ORANGE, markeredgewidth=2.5),
        legend_entry(METHODS["first_order"], linestyle="--", color=VERMILION),
        legend_entry(METHODS["exact"], color=BLACK),
        legend_entry(METHODS["exponential"], color=GREEN, linewidth=2.0),
    ]
    legend_below(figure, handles, bottom=0.45 / figure.get_figheight())
    return figure


def _cloud_of_line(case: Case, seed: int) -> Cloud:
    """Return the cloud at the end of a straight line of the length of a case's path."""
    count = len(case.trajectory)
    along = np.linspace(0.0, case.trajectory.length(), count)
    line = Trajectory(np.arange(count), np.column_stack([along, np.zeros((count, 2))]))
    steps = noisy_steps(line.poses, level_rule(case.model, case.std))
    regions = Regions(line, steps, theory(steps))
    # A rate that no case has selects draws that no case has.
    for block in noisy_blocks(steps, study_generator(seed, case.model, case.std, -1.0), CLOUD):
        regions.add(block)
    return regions.cloud(-1)


def _model_panels(
    cases: Sequence[Case],
    size: tuple[int, float, float, float],
    title: str,
    labels: tuple[str, str],
    note: str = "",
) -> tuple[Figure, ndarray, dict[str, list[Case]]]:
    """Return a figure with a column for each model, its axes, and the cases of each model.

    The size is the number of rows, width of a column and of the rest, and height, in inches. The
    rate of the cases and the note are added to the title.
    """
    by_model = by_model_of(cases)
    rows, column, rest, height = size
    shape = rows, len(by_model)
    inches = column * len(by_model) + rest, height
    title = f"{title}, at {cases[0].rate:g} Hz{note}"
    figure, grid = panels(shape, inches, title, labels, sharex=True, sharey="row")
    return figure, grid, by_model


def _add_method_legend(figure: Figure, grid: ndarray) -> None:
    bottom = 0.3 / figure.get_figheight()
    legend_below(figure, labelled(*grid.flat), bottom=bottom, fontsize=9)


def _draw_sheet(axes: Axes, case: Case, window: Window) -> None:
    paths = LineCollection(case.kept[..., :2], colors=BLUE, linewidths=0.5, alpha=0.3)
    axes.add_collection(paths)
    outline = [withStroke(linewidth=2.6, foreground="white")]
    perfect = case.trajectory.poses[:, :2].T
    axes.plot(*perfect, color=ORANGE, linewidth=1.5, path_effects=outline)
    for index in find_corners(case.trajectory):
        for moments, style, colour in (
            (case.theory.exact, "-", BLACK),
            (case.theory.first_order, (0, (3, 2)), VERMILION),
        ):
            ellipse = _ellipse_at(case, moments, index).T
            axes.plot(*ellipse, linestyle=style, color=colour, linewidth=1.1)
    (left, bottom), (right, top) = window
    axes.set(aspect="equal", xlim=(left, right), ylim=(bottom, top))
    axes.tick_params(labelsize=8)


def _ellipse_at(case: Case, moments: Moments, index: int) -> ndarray:
    centre = case.trajectory.poses[index, :2] + moments.mean[index, :2]
    return centre + ellipse_points(moments.covariance[index])


def _add_sheet_legend(figure: Figure) -> None:
    ellipse = f"{100 * LEVEL:g} % ellipse"
    handles = [
        legend_entry("noisy", color=BLUE, linewidth=1.0),
        legend_entry("perfect", color=ORANGE, linewidth=2.0),
        legend_entry(f"{ellipse}, exact", color=BLACK, linewidth=1.2),
        legend_entry(f"{ellipse}, first order", linestyle="--", color=VERMILION, linewidth=1.2),
    ]
    legend_below(figure, handles)
    figure.tight_layout(rect=(0.01, 0.35 / figure.get_figheight(), 1.0, 1.0), pad=0.8)


def _window(cases: Sequence[Case]) -> Window:
    """Return limits that hold paths and ellipses, within a margin around the perfect path."""
    perfect = cases[0].trajectory.poses[:, :2]
    low, high = perfect.min(axis=0), perfect.max(axis=0)
    size = (high - low).max()
    curves = []
    for case in cases:
        for index in find_corners(case.trajectory):
            curves += [case.kept[:, index, :2], _ellipse_at(case, case.theory.exact, index)]
    shown = np.concatenate(curves)
    least, most = shown.min(axis=0) - 0.05 * size, shown.max(axis=0) + 0.05 * size
    return (
        np.clip(least, low - _LARGEST_MARGIN * size, low - 0.08 * size),
        np.clip(most, high + 0.08 * size, high + _LARGEST_MARGIN * size),
    )


def _draw_error(axes: Axes, case: Case, colour) -> None:
    travelled = case.trajectory.travelled()
    # A logarithmic axis cannot show the start, where the error is 0.
    shown = slice(int(np.searchsorted(travelled, 0.02 * travelled[-1])), None)
    far = travelled[shown]
    axes.plot(far, case.rms_distance[shown], color=colour, linewidth=3.2)
    axes.plot(far, case.theory.exact.rms_distance()[shown], "--", color=BLACK, linewidth=1.0)
    axes.plot(
        far, case.theory.first_order.rms_distance()[shown], ":", color=VERMILION, linewidth=1.6
    )
    _label(axes, f"{case.std:g}", (far[-1], case.rms_distance[-1]), 5)


def _label(axes: Axes, text: str, point: tuple[float, float], gap: float) -> None:
    axes.annotate(
        text, point, (gap, 0), textcoords="offset points", va="center", fontsize=9
    )


def _draw_rates(axes: Axes, cases: Sequence[Case], trajectory: Trajectory) -> None:
    """Draw the error at the end against the rate: samples, and the exact curve through them."""
    all_rates = sorted({case.rate for case in cases})
    shown = shown_levels([case for case in cases if case.rate == all_rates[0]], CURVES)
    rates = np.unique(
        [*np.geomspace(0.8 * all_rates[0], 1.25 * all_rates[-1], _RATES_ON_CURVE), *all_rates]
    )
    paths = [resample(trajectory, rate) for rate in rates]
    for first, colour in zip(shown, _colours(len(shown))):
        rule = level_rule(first.model, first.std)
        ends = [exact_moments(noisy_steps(p.poses, rule)).rms_distance()[-1] for p in paths]
        axes.plot(rates, ends, "-", color=BLACK, linewidth=1.0)
        of_level = [case for case in cases if case.std == first.std]
        found = [case.rms_distance[-1] for case in of_level]
        style = {"color": colour, "markeredgecolor": BLACK, "markersize": 6}
        axes.plot([case.rate for case in of_level], found, "o", **style)
        _label(axes, f"{first.std:g}", (rates[-1], ends[-1]), 4)
    gridded(axes, xscale="log", yscale="log")
    axes.set_xlim(0.75 * rates[0], 2.0 * rates[-1])
    axes.xaxis.set_major_locator(FixedLocator(all_rates))
    axes.xaxis.set_minor_locator(NullLocator())
    for axis in (axes.xaxis, axes.yaxis):
        _plain_numbers(axis)
    axes.tick_params(labelsize=8)


def _draw_shares(
    axes: Axes,
    places: Sequence[float],
    found: Sequence[Region | None],
    method: str,
    level: int,
) -> None:
    """Draw the coverage of a method's regions with its bands, where there are any."""
    goal, width = 100.0 * LEVELS[level], 100.0 * TOLERANCE
    axes.axhspan(goal - width, goal + width, color=GREY, alpha=0.12, linewidth=0.0)
    rows = [(x, r.coverage[level], *r.bands[level]) for x, r in zip(places, found) if r]
    _draw_band(axes, np.reshape(rows, (-1, 4)) * (1.0, 100.0, 100.0, 100.0), method)


def _draw_band(axes: Axes, rows: Sequence, method: str) -> None:
    """Draw a line with its band from rows of place, value, and the ends of the band."""
    if len(rows):
        style, colour = STYLES[method]
        x, values, low, high = np.transpose(rows)
        axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0.0)
        axes.plot(x, values, style, color=colour, markersize=4, label=METHODS[method])


def _draw_cloud(axes: Axes, cloud: Cloud) -> None:
    points = cloud.points
    axes.plot(points.real, points.imag, ".", color=BLUE, markersize=2.0, alpha=0.4)
    axes.plot([0.0], [0.0], "+", color=ORANGE, markersize=11.0, markeredgewidth=2.5)
    curves = [points]
    for (mean, covariance), style, colour in (
        (cloud.exact, "-", BLACK),
        (cloud.first_order, "--", VERMILION),
    ):
        x, y = (ellipse_points(covariance) + mean[:2]).T
        axes.plot(x, y, style, color=colour, linewidth=1.4)
        curves.append(x + 1j * y)
    _draw_bent_region(axes, *cloud.exponential, np.concatenate(curves))
    axes.set_aspect("equal", adjustable="datalim")


def _draw_bent_region(axes: Axes, mean, covariance, around: ndarray) -> None:
    """Draw the region of 95 % of the positions, if they are Gaussian in exponential coordinates."""
    if not inverse_of(covariance).any():
        return
    sides = np.array([around.real, around.imag])
    margins = 0.2 * np.ptp(sides, axis=1)
    x, y = np.linspace(sides.min(axis=1) - margins, sides.max(axis=1) + margins, _GRID).T
    density = position_density(mean, covariance, x[None, :] + 1j * y[:, None])
    falling = np.sort(density.ravel())[::-1]
    held = np.cumsum(falling) / falling.sum()
    level = falling[np.searchsorted(held, LEVEL)]
    # Copied from another figure, as a contour would widen the limits to its whole grid.
    contour = new_figure(1.0, 1.0).subplots().contour(x, y, density, levels=[level])
    for curve in contour.allsegs[0]:
        axes.plot(*curve.T, color=GREEN, linewidth=2.0)


def _plain_numbers(axis: Axis) -> None:
    """Format the numbers of a logarithmic axis without powers of ten."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(LogFormatter())


def _colours(count: int) -> ndarray:
    """Return colours from dark to light, which differ in print and for the colour-blind."""
    return viridis(np.linspace(0.1, 0.9, count))
