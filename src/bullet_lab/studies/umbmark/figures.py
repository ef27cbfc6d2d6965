"""The picture of both clusters of return errors, before a correction and after it."""

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
    new_figure,
    plan_axes,
)
from bullet_lab.core.se2 import ellipse_points
from bullet_lab.studies.umbmark.estimate import PARAMETERS, centre_ellipse
from bullet_lab.studies.umbmark.runs import CLOCKWISE, COUNTER_CLOCKWISE, return_errors

WAYS = ((CLOCKWISE, "clockwise", BLUE, "o"), (COUNTER_CLOCKWISE, "counter-clockwise", ORANGE, "s"))


def clusters_figure(before: Any, after: Optional[Any]) -> Figure:
    """Draw the return errors of `Benchmark`s: all to one scale, and after the correction close by.

    A filled ellipse holds a centre of gravity with 95 % confidence, an open one 95 % of runs.
    """
    panels = [("before the correction", before)]
    if after is not None:
        panels += [("after it, to the same scale", after), ("after it", after)]
    figure = new_figure(0.6 + 4.6 * len(panels), 5.0)
    figure.suptitle("Return errors: where the robot really was, seen from where odometry had it")
    every = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (title, benchmark) in zip(every, panels):
        plan_axes(axes, title=title, xlabel="x (mm), ahead at the start", ylabel="y (mm)")
        _draw(axes, benchmark)
    if after is not None:
        errors = [return_errors(before.runs, way)[:, :2] for way in (CLOCKWISE, COUNTER_CLOCKWISE)]
        reach = 1150.0 * np.abs(np.concatenate(errors)).max()
        for axes in every[:2]:
            axes.set_adjustable("box")
            axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    handles, labels = every[0].get_legend_handles_labels()
    columns = 2 if after is None else len(labels)
    figure.legend(handles, labels, loc="lower center", ncol=columns, fontsize=9)
    below = 0.15 if after is None else 0.06
    figure.tight_layout(rect=(0.0, below, 1.0, 1.0))
    return figure


def _draw(axes: Axes, benchmark: Any) -> None:
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    for direction, title, colour, marker in WAYS:
        errors = 1000.0 * return_errors(benchmark.runs, direction)
        centre = errors[:, :2].mean(axis=0)
        axes.plot(*errors[:, :2].T, marker, color=colour, markersize=5, alpha=0.7, label=title)
        label = "centres of gravity" if direction == COUNTER_CLOCKWISE else None
        axes.plot(*centre, "+", color=BLACK, markersize=11, label=label)
        shape = centre_ellipse(errors)
        if shape is not None:
            last = direction == COUNTER_CLOCKWISE
            border = centre + ellipse_points(shape)
            label = "95 % ellipses of the centres" if last else None
            axes.fill(*border.T, color=colour, alpha=0.25, linewidth=0, label=label)
            border = centre + ellipse_points(np.cov(errors[:, :2].T))
            label = "95 % ellipses of the runs" if last else None
            axes.plot(*border.T, color=colour, linewidth=0.9, label=label)


def campaign_figure(records: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw what was found of injected errors, less these: closed forms, the fit, with noise."""
    figure = new_figure(11.0, 4.6)
    for axes, name in zip(figure.subplots(1, len(PARAMETERS)), PARAMETERS):
        injected = np.array([record[name] for record in records])

        def less(kind: str, name: str = name, injected: np.ndarray = injected) -> np.ndarray:
            values = [record[f"{name}_{kind}"] for record in records]
            return np.array([np.nan if v is None else v for v in values], float) - injected

        noisy, low, high = (less(kind) for kind in ("with_noise", "low", "high"))
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.plot(injected, less("closed_form"), "x", color=VERMILION, label="closed forms")
        reach = np.abs(np.stack((noisy - low, high - noisy)))
        style = {"fmt": ".", "color": BLUE, "elinewidth": 1.0}
        axes.errorbar(injected, noisy, reach, label="fit, with noise: 95 % intervals", **style)
        axes.plot(injected, less("found"), "o", color=GREEN, markersize=4, label="fit, no noise")
        axes.set(xlabel=f"injected {name} (%)", ylabel="found less injected")
        axes.xaxis.set_major_formatter(lambda value, _: f"{100.0 * value:g}")
        axes.set_yscale("symlog", linthresh=1e-4)
        axes.grid(alpha=0.3)
    figure.legend(*axes.get_legend_handles_labels(), loc="lower center", ncol=3, fontsize=9)
    figure.tight_layout(rect=(0.0, 0.06, 1.0, 1.0))
    return figure
