"""The pictures of regions of confidence: how often they hold, and what they look like."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bullet_lab.core.figures import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILION, new_figure
from bullet_lab.core.se2 import LEVEL, ellipse_points, straightening
from bullet_lab.noise.exact_moments import Moments, exponential_moments
from bullet_lab.noise.noisy_paths import noisy_blocks, noisy_steps, study_generator
from bullet_lab.noise.odometry_noise import MODELS
from bullet_lab.studies.noise_study.figures import (
    STYLES,
    add_legend,
    by_model_of,
    plain_numbers,
    shown_levels,
)
from bullet_lab.studies.noise_study.regions import (
    CLOUD,
    LEVELS,
    MEANT,
    METHODS,
    TOLERANCE,
    Region,
)
from bullet_lab.studies.noise_study.statistics import Case
from bullet_lab.studies.noise_study.theory import Theory, inverse_of, level_rule, theory

PANELS = 3

Gaussian = Tuple[np.ndarray, np.ndarray]
"""Its mean (3,) and covariance (3, 3), in m and rad."""

Found = Sequence[Optional[Region]]

_GRID, _HEADINGS, _REACH = 160, 41, 4.5


def regions_figure(cases: Sequence[Case]) -> Figure:
    """Draw coverage at each level of confidence, and the NEES, at the end; one rate."""
    by_model = by_model_of(cases)
    figure = new_figure(4.0 * len(by_model) + 0.8, 10.5)
    figure.suptitle(
        f"Regions of x, y and heading at the end, at {cases[0].rate:g} Hz; bands: 95 % confidence"
    )
    shape = (len(LEVELS) + 1, len(by_model))
    grid = figure.subplots(*shape, squeeze=False, sharex=True, sharey="row")
    for column, (model, of_model) in zip(grid.T, by_model.items()):
        column[0].set_title(MODELS[model].title)
        std = [case.std for case in of_model]
        for method in METHODS:
            found = [case.sample.regions.found[method][-1] for case in of_model]
            for level, axes in enumerate(column[:-1]):
                _draw_shares(axes, std, found, method, level)
            _draw_nees(column[-1], std, found, method)
        column[-1].axhline(3.0, color=GREY, linewidth=5.0, alpha=0.5, zorder=0.5)
        column[-1].set(yscale="log", xlabel="std")
        plain_numbers(column[-1].yaxis)
    _name_rows(grid[:-1, 0])
    grid[-1, 0].set_ylabel("mean NEES; 3 is right")
    add_legend(figure, grid.flat)
    figure.tight_layout(rect=(0.0, 0.3 / figure.get_figheight(), 1.0, 1.0))
    return figure


def distances_figure(cases: Sequence[Case]) -> Figure:
    """Draw the coverage of 95 % regions against distance, for some levels; one rate."""
    by_model = by_model_of(cases)
    shown = {model: shown_levels(of_model, PANELS) for model, of_model in by_model.items()}
    rows = max(1, *map(len, shown.values()))
    figure = new_figure(4.0 * len(by_model) + 0.8, 2.7 * rows + 0.8)
    figure.suptitle(
        f"95 % regions of x, y and heading along the path, at {cases[0].rate:g} Hz; "
        "bands: 95 % confidence"
    )
    grid = figure.subplots(rows, len(by_model), squeeze=False, sharex=True, sharey="row")
    for column, (model, levels) in zip(grid.T, shown.items()):
        for axes, case in zip(column, levels):
            regions = case.sample.regions
            for method in METHODS:
                _draw_shares(axes, regions.travelled, regions.found[method], method, MEANT)
            axes.set_title(f"{MODELS[model].title}, std {case.std:g}", fontsize=10)
        column[-1].set_xlabel("distance travelled (m)")
    for axes in grid[:, 0]:
        axes.set_ylabel("in the 95 % region (%)")
    add_legend(figure, grid.flat)
    figure.tight_layout(rect=(0.0, 0.3 / figure.get_figheight(), 1.0, 1.0))
    return figure


def banana_figure(cases: Sequence[Case], seed: int) -> Figure:
    """Draw clouds of noisy positions, and what is to hold 95 % of them, for some levels.

    They are of the model that bends them most: above at the pose of the path where they are bent
    most, below at the end of a straight line that is as long.

    Args:
        cases: of one rate, one of them with noise.
        seed: of the noise on the straight line.
    """
    most = max(cases, key=lambda case: case.theory.quadratic_share())
    bent = [case for case in cases if case.model == most.model and case.std > 0.0]
    strong = [case for case in bent if not case.theory.first_order_enough()]
    levels = shown_levels(strong if len(strong) >= PANELS else bent, PANELS)
    figure = new_figure(4.0 * max(2, len(levels)) + 0.6, 8.4)
    figure.suptitle(
        f"{MODELS[most.model].title} noise: where the robot is, and 95 % regions; "
        "above the path where it is bent most, below a straight line"
    )
    grid = figure.subplots(2, len(levels), squeeze=False)
    for column, case in zip(grid.T, levels):
        for axes, cloud in zip(column, (_path_cloud(case), _line_cloud(case, seed))):
            _draw_cloud(axes, cloud)
            axes.set_title(f"std {case.std:g}, after {cloud.travelled:.1f} m", fontsize=10)
        column[-1].set_xlabel("error of x (m)")
    for axes in grid[:, 0]:
        axes.set_ylabel("error of y (m)")
    axes = grid[0, 0]
    handles = [
        *axes.plot([], [], ".", color=BLUE, label="noisy"),
        *axes.plot([], [], "+", color=ORANGE, markeredgewidth=2.5, label="perfect"),
        *axes.plot([], [], "--", color=VERMILION, label=METHODS["first_order"]),
        *axes.plot([], [], color=BLACK, label=METHODS["exact"]),
        *axes.plot([], [], color=GREEN, linewidth=2.0, label=METHODS["exponential"]),
    ]
    figure.legend(handles=handles, loc="lower center", ncol=len(handles), frameon=False)
    figure.tight_layout(rect=(0.0, 0.45 / figure.get_figheight(), 1.0, 1.0))
    return figure


@dataclass(frozen=True, eq=False)
class _Cloud:
    """Errors of positions at one pose, x + iy (m), and the mean and covariance of three methods."""

    points: np.ndarray
    travelled: float
    first_order: Gaussian
    exact: Gaussian
    exponential: Gaussian


def _cloud_at(theory: Theory, exponential: Moments, pose: int, k: int, **more) -> _Cloud:
    return _Cloud(
        first_order=(theory.first_order.mean[pose], theory.first_order.covariance[pose]),
        exact=(theory.exact.mean[pose], theory.exact.covariance[pose]),
        exponential=(exponential.mean[k], exponential.covariance[k]),
        **more,
    )


def _path_cloud(case: Case) -> _Cloud:
    regions = case.sample.regions
    k = int(np.argmax([case.theory.quadratic_share(pose) for pose in regions.poses]))
    points, travelled = regions.cloud[:, k], float(regions.travelled[k])
    pose = int(regions.poses[k])
    return _cloud_at(case.theory, regions.exponential, pose, k, points=points, travelled=travelled)


def _line_cloud(case: Case, seed: int) -> _Cloud:
    length, count = case.trajectory.length(), len(case.trajectory)
    along = np.linspace(0.0, length, count)
    line = np.column_stack([along, np.zeros((count, 2))])
    steps = noisy_steps(line, level_rule(case.model, case.std))
    # A rate that no case has, so that the draws are those of none.
    blocks = noisy_blocks(steps, study_generator(seed, case.model, case.std, -1.0), CLOUD)
    points = np.concatenate([block.position[:, -1] - length for block in blocks])
    exponential = exponential_moments(steps, [count - 1])
    return _cloud_at(theory(steps), exponential, -1, 0, points=points, travelled=length)


def _name_rows(column: Sequence[Axes]) -> None:
    for level, axes in zip(LEVELS, column):
        axes.set_ylabel(f"in the {100 * level:g} % region (%)")


def _draw_shares(axes: Axes, where, found: Found, method: str, level: int) -> None:
    """Draw the coverage of a method's regions with its bands, where there are any."""
    goal, width = 100.0 * LEVELS[level], 100.0 * TOLERANCE
    axes.axhspan(goal - width, goal + width, color=GREY, alpha=0.12, linewidth=0.0)
    known = [(x, r.coverage[level], *r.bands[level]) for x, r in zip(where, found) if r]
    _draw_band(axes, [(x, *(100.0 * share for share in shares)) for x, *shares in known], method)


def _draw_nees(axes: Axes, where, found: Found, method: str) -> None:
    _draw_band(axes, [(x, r.nees, *r.nees_band) for x, r in zip(where, found) if r], method)


def _draw_band(axes: Axes, rows: Sequence[Sequence[float]], method: str) -> None:
    """Draw what a method gives, from rows of place, value, and the ends of its band."""
    axes.grid(alpha=0.3)
    if rows:
        style, colour = STYLES[method]
        x, values, low, high = zip(*rows)
        axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0.0)
        axes.plot(x, values, style, color=colour, markersize=4, label=METHODS[method])


def _draw_cloud(axes: Axes, cloud: _Cloud) -> None:
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
    axes.grid(alpha=0.3)


def _draw_bent_region(axes: Axes, mean, covariance, around: np.ndarray) -> None:
    """Draw what holds 95 % of the positions, if they are Gaussian in exponential coordinates."""
    if inverse_of(covariance) is None:
        return
    x, y = (np.linspace(*_widened(side, 0.2), _GRID) for side in (around.real, around.imag))
    density = _density(mean, covariance, x[None, :] + 1j * y[:, None])
    falling = np.sort(density.ravel())[::-1]
    held = np.cumsum(falling) / falling.sum()
    level = falling[np.searchsorted(held, LEVEL)]
    # Drawn elsewhere and copied: a contour would widen the limits to its whole grid.
    contour = new_figure(1.0, 1.0).subplots().contour(x, y, density, levels=[level])
    for curve in contour.allsegs[0]:
        axes.plot(*curve.T, color=GREEN, linewidth=2.0)


def _widened(values: np.ndarray, share: float = 0.05) -> Tuple[float, float]:
    margin = share * np.ptp(values)
    return values.min() - margin, values.max() + margin


def _density(mean: np.ndarray, covariance: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the density of positions x + iy (m) whose exponential coordinates are Gaussian.

    For each heading the first two coordinates are a linear function of the position; the density is
    the mean of theirs over the headings.
    """
    deviation = math.sqrt(covariance[2, 2])
    result = np.zeros(place.shape)
    slope = covariance[:2, 2] / covariance[2, 2]
    inverse = np.linalg.inv(covariance[:2, :2] - np.outer(slope, covariance[2, :2]))
    for h in np.linspace(-_REACH, _REACH, _HEADINGS) * deviation:
        if abs(h) < math.pi:
            straight = straightening(h)
            off = straight * place - complex(*(mean[:2] + slope * h))
            square = inverse[0, 0] * off.real**2 + inverse[1, 1] * off.imag**2
            square += 2.0 * inverse[0, 1] * off.real * off.imag + (h / deviation) ** 2
            result += np.exp(-0.5 * square) * abs(straight) ** 2
    return result
