"""Figures of a calibration: residuals, profile likelihoods, paths, and coverage."""

from __future__ import annotations

import math
from typing import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import ndtri

from bullet_lab.core import se2
from bullet_lab.core.figures import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILION, plan_axes
from bullet_lab.noise.calibration import profile
from bullet_lab.noise.odometry_noise import MODELS
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.studies.calibrate.drive import Coverage
from bullet_lab.studies.calibrate.recordings import Recording
from bullet_lab.studies.calibrate.results import Calibration, label_of
from bullet_lab.studies.results import labelled, legend_below, panels

MOST_PATHS = 4
_PARTS = ("turn before the way", "way", "turn after the way")
_COLOURS = (VERMILION, BLUE, GREEN)
_WIDEST = 6.0
_POINTS = 11
_LIMIT = 3.841


def residuals_figure(found: Sequence[Calibration]) -> Figure:
    """Draw the whitened residuals of each model against quantiles of the normal distribution."""
    title = "Errors of the steps: on the line, the model is right"
    size = 4.2 * len(found), 4.6
    figure, (row,) = panels((1, len(found)), size, title, sharex=True, sharey=True)
    for axes, one in zip(row, found):
        axes.plot([-4.0, 4.0], [-4.0, 4.0], color=BLACK, linewidth=0.8)
        for values, part, colour in zip(one.goodness.whitened.T, _PARTS, _COLOURS):
            seen = np.sort(values[np.isfinite(values)])
            if seen.size:
                normal = ndtri((np.arange(seen.size) + 0.5) / seen.size)
                shown = np.clip(seen, -_WIDEST, _WIDEST)
                axes.plot(normal, shown, ".", markersize=3.0, color=colour, label=part)
        judged = one.goodness
        verdict = f"{'fits' if judged.fits else 'does not fit'}, p = {judged.p_value:.2g}"
        axes.set_title(f"{MODELS[one.model].title}: {verdict}", fontsize=10)
        axes.set(xlabel="standard normal", xlim=(-4.0, 4.0), ylim=(-_WIDEST, _WIDEST))
        axes.grid(alpha=0.3)
    row[0].set_ylabel("error / standard deviation by the model")
    row[0].legend(loc="upper left", fontsize=8)
    figure.tight_layout()
    return figure


def profiles_figure(one: Calibration, true: Mapping[str, float]) -> Figure:
    """Draw the profile likelihood of each parameter of a model, with its interval."""
    parameters = one.parameters()
    columns = min(4, len(parameters))
    rows = -(-len(parameters) // columns)
    title = f"{MODELS[one.model].title}: profile likelihoods and 95 % intervals"
    size = 3.1 * columns + 0.4, 2.7 * rows + 0.5
    figure, grid = panels((rows, columns), size, title, sharey=True)
    for axes, (name, found) in zip(grid.flat, parameters.items()):
        _draw_profile(axes, one, name, found)
        if name in true:
            axes.axvline(true[name], color=ORANGE, linewidth=2.0, label="true")
            axes.legend(fontsize=8, loc="upper center")
        axes.set_xlabel(label_of(name))
        axes.ticklabel_format(axis="x", style="sci", scilimits=(-3, 3))
        axes.locator_params(axis="x", nbins=4)
    for axes in grid.flat[len(parameters) :]:
        axes.set_axis_off()
    for axes in grid[:, 0]:
        axes.set(ylabel="fall of 2 log L", ylim=(0.0, 8.0))
    figure.tight_layout()
    return figure


def _draw_profile(axes: Axes, one: Calibration, name: str, found) -> None:
    value, low, high = found
    axes.axhline(_LIMIT, color=GREY, linewidth=0.8, linestyle="--")
    axes.grid(alpha=0.3)
    axes.axvline(value, color=BLUE, linewidth=1.0)
    if not (math.isfinite(low) and math.isfinite(high)):
        axes.text(0.5, 0.5, "the steps do not end it", transform=axes.transAxes, ha="center")
        return
    axes.axvspan(low, high, color=BLUE, alpha=0.15, linewidth=0.0)
    left, right = value - 1.4 * (value - low), value + 1.4 * (high - value)
    if low == 0.0:
        left = 1e-3 * value
    sides = [
        np.linspace(value, end, _POINTS // 2 + 1)[1:] for end in (left, right) if end != value
    ]
    points = [(value, 0.0)]
    for side in sides:
        points += zip(side, profile(one.problem, one.fit, name, side))
    x, fall = np.array(sorted(points)).T
    # The signed root of the fall is nearly linear, and is interpolated.
    root = np.sign(x - value) * np.sqrt(fall)
    fine = np.linspace(x[0], x[-1], 120)
    axes.plot(fine, np.interp(fine, x, root) ** 2, color=BLUE)


def paths_figure(recordings: Sequence[Recording], one: Calibration) -> Figure:
    """Draw truth and odometry from one start, and the truth with the systematic errors found."""
    shown = recordings[:MOST_PATHS]
    figure, (row,) = panels((1, len(shown)), (max(6.4, 5.4 * len(shown)), 5.8))
    values = one.fit.values()
    wrong = {name: values[name] for name in one.problem.systematic}
    errors = SystematicErrors(wheel_base=one.problem.wheel_base, **wrong)
    for axes, recording in zip(row, shown):
        plan_axes(axes)
        first = int(np.searchsorted(recording.truth.stamps, recording.odometry.stamps[0]))
        truth = recording.truth.poses[min(first, len(recording.truth) - 1) :]
        paths = [(se2.between(truth[0], truth), ORANGE, "-", "truth")]
        odometry = recording.odometry.poses
        paths.append((se2.between(odometry[0], odometry), BLUE, "-", "odometry"))
        if wrong:
            reported = errors.path(paths[0][0])
            paths.append((reported, VERMILION, "--", "truth with the systematic errors found"))
        for poses, colour, style, label in paths:
            axes.plot(poses[:, 0], poses[:, 1], style, color=colour, linewidth=1.4, label=label)
        axes.plot(0.0, 0.0, "o", color=GREEN, markeredgecolor=BLACK, label="start")
        axes.set_title(recording.name.rsplit("/", 2)[-1], fontsize=10)
    legend_below(figure, labelled(row[0]), 4, 0.05, fontsize=8)
    return figure


def coverage_figure(found: Sequence[Coverage]) -> Figure:
    """Draw the share of intervals of each parameter that hold the truth, with bands."""
    figure, ((axes,),) = panels((1, 1), (8.0, 1.6 + 0.28 * len(found)))
    axes.axvspan(93.0, 97.0, color=GREY, alpha=0.25, linewidth=0.0)
    axes.axvline(95.0, color=BLACK, linewidth=0.8)
    models = list(dict.fromkeys(one.model for one in found))
    for row, one in enumerate(found):
        colour = _COLOURS[models.index(one.model) % len(_COLOURS)]
        low, high = one.band()
        axes.plot([100.0 * low, 100.0 * high], [row, row], color=colour, linewidth=2.0)
        axes.plot(100.0 * one.held / one.paths, row, "o", color=colour)
    axes.set_yticks(range(len(found)))
    axes.set_yticklabels([f"{one.model}: {one.name}" for one in found], fontsize=8)
    axes.invert_yaxis()
    axes.grid(alpha=0.3, axis="x")
    axes.set(xlabel="95 % intervals that hold the truth (%)")
    axes.set_title(f"{found[0].paths} paths for each model", fontsize=10)
    figure.tight_layout()
    return figure
