"""Figures of UMBmark: return errors before and after a correction, and errors of a campaign."""

from __future__ import annotations

from typing import Any, Mapping, Optional, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bullet_lab.core.figures import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    VERMILION,
    plan_axes,
)
from bullet_lab.core.se2 import ellipse_points
from bullet_lab.studies.results import labelled, legend_below, panels
from bullet_lab.studies.umbmark.estimate import PARAMETERS, centre_ellipse
from bullet_lab.studies.umbmark.runs import CLOCKWISE, COUNTER_CLOCKWISE, return_errors

STYLES = (
    (CLOCKWISE, "clockwise", BLUE, "o"),
    (COUNTER_CLOCKWISE, "counter-clockwise", ORANGE, "s"),
)


def clusters_figure(before: Any, after: Optional[Any]) -> Figure:
    """Draw the return errors of `Benchmark`s, to one scale, and those after the correction larger.

    A filled ellipse holds a centre of gravity with 95 % confidence, an open one 95 % of the runs.
    """
    shown = [("before the correction", before)]
    if after is not None:
        shown += [("after it, to the same scale", after), ("after it", after)]
    title = "Return errors: where the robot really was, seen from where odometry had it"
    figure, (every,) = panels((1, len(shown)), (0.6 + 4.6 * len(shown), 5.0), title)
    for axes, (title, benchmark) in zip(every, shown):
        plan_axes(axes, title=title, xlabel="x (mm), ahead at the start", ylabel="y (mm)")
        _draw(axes, benchmark)
    if after is not None:
        errors = [return_errors(before.runs, way)[:, :2] for way in (CLOCKWISE, COUNTER_CLOCKWISE)]
        reach = 1150.0 * np.abs(np.concatenate(errors)).max()
        for axes in every[:2]:
            axes.set_adjustable("box")
            axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    columns, below = (2, 0.15) if after is None else (0, 0.06)
    legend_below(figure, labelled(every[0]), columns, frameon=None, fontsize=9)
    figure.tight_layout(rect=(0.0, below, 1.0, 1.0))
    return figure


def _draw(axes: Axes, benchmark: Any) -> None:
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    for direction, title, colour, marker in STYLES:
        # Both directions share an entry of the legend.
        once = "_" if direction == CLOCKWISE else ""
        errors = 1000.0 * return_errors(benchmark.runs, direction)
        centre = errors[:, :2].mean(axis=0)
        axes.plot(*errors[:, :2].T, marker, color=colour, markersize=5, alpha=0.7, label=title)
        axes.plot(*centre, "+", color=BLACK, markersize=11, label=f"{once}centres of gravity")
        shape = centre_ellipse(errors)
        if shape is not None:
            border = centre + ellipse_points(shape)
            label = f"{once}95 % ellipses of the centres"
            axes.fill(*border.T, color=colour, alpha=0.25, linewidth=0, label=label)
            border = centre + ellipse_points(np.cov(errors[:, :2].T))
            label = f"{once}95 % ellipses of the runs"
            axes.plot(*border.T, color=colour, linewidth=0.9, label=label)


def campaign_figure(records: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw estimated minus injected errors, by the closed forms and by the fit."""
    figure, (every,) = panels((1, len(PARAMETERS)), (11.0, 4.6))
    for axes, name in zip(every, PARAMETERS):
        injected = np.array([record[name] for record in records])

        # None becomes NaN, which is not drawn.
        closed, found, noisy, low, high = (
            np.array([record[f"{name}_{kind}"] for record in records], float) - injected
            for kind in ("closed_form", "found", "with_noise", "low", "high")
        )
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.plot(injected, closed, "x", color=VERMILION, label="closed forms")
        reach = np.abs(np.stack((noisy - low, high - noisy)))
        style = {"fmt": ".", "color": BLUE, "elinewidth": 1.0}
        axes.errorbar(injected, noisy, reach, label="fit, with noise: 95 % intervals", **style)
        axes.plot(injected, found, "o", color=GREEN, markersize=4, label="fit, no noise")
        axes.set(xlabel=f"injected {name} (%)", ylabel="found less injected")
        axes.xaxis.set_major_formatter(lambda value, _: f"{100.0 * value:g}")
        axes.set_yscale("symlog", linthresh=1e-4)
        axes.grid(alpha=0.3)
    legend_below(figure, labelled(axes), frameon=None, fontsize=9)
    figure.tight_layout(rect=(0.0, 0.06, 1.0, 1.0))
    return figure
