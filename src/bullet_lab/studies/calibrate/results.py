"""The result of a calibration by each model: summary, lines, figures, and a file for noisy_odom."""

from __future__ import annotations

import functools
import math
from dataclasses import asdict, dataclass
from typing import Callable, Mapping, Sequence

import numpy as np
import yaml
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import ndtri

from bullet_lab.core import se2
from bullet_lab.core.figures import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    THIN,
    VERMILION,
    labelled,
    legend_below,
    panels,
    plan_axes,
)
from bullet_lab.core.parameters import declarations
from bullet_lab.errors import LabError
from bullet_lab.noise.calibration import Fit, Problem, fit, intervals, on_limit, profile
from bullet_lab.noise.goodness import (
    LENGTHS,
    OWN,
    Goodness,
    Prediction,
    goodness,
    judged,
    parameter_variances,
    predicted,
)
from bullet_lab.noise.likelihood import PARTS, StepPairs
from bullet_lab.noise.odometry_noise import MODELS, WalkRule
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.studies.calibrate.steps import EACH, Steps, long_length, pairs_of, part_of
from bullet_lab.studies.paths import Recording
from bullet_lab.studies.study import Record, Summary

MOST_PATHS = 4  # in a figure
_PART_TITLES = ("turn before the way", "way", "turn after the way")
_COLOURS = (VERMILION, BLUE, GREEN)
# Standard deviations; residuals beyond are drawn at the edge of the figure.
_WIDEST = 6.0
# Of a profile likelihood, at which it is computed.
_POINTS = 11
# Chi-square's 95 % with one degree of freedom.
_LIMIT = 3.841


@dataclass(frozen=True, eq=False)
class ModelCalibration:
    """A noise model, with systematic errors, that is fitted to steps.

    Attributes:
        fit: the most likely values.
        intervals: of the parameters, 95 %, shape (k, 2); as wide as the dispersion makes them.
        goodness: of the fit.
        prediction: how well halves of the steps predict each other.
        length: m and rad of long steps; `EACH` for steps as they were taken.
    """

    fit: Fit
    intervals: np.ndarray
    goodness: Goodness
    prediction: Prediction
    length: tuple[float, float]

    @property
    def model(self) -> str:
        """Name of the noise model."""
        return self.fit.problem.model

    @property
    def limited(self) -> list[str]:
        """The parameters that lie on a limit: then nothing of the model is a result."""
        return on_limit(self.fit)

    def rank(self) -> tuple[bool, float]:
        """Return what sorts models, the best one first."""
        return bool(self.limited), -self.prediction.density

    def published(self) -> dict[str, float]:
        """Return noise and systematic errors as they predict, with the spread of the latter."""
        dispersion = self.prediction.dispersion
        rule = self.fit.rule().scaled(dispersion)
        stds = np.sqrt(OWN * dispersion * parameter_variances(self.fit)).tolist()
        spread = {f"{name}_std": std for name, std in zip(self.fit.problem.systematic, stds)}
        return {**self.fit.values(), **asdict(rule), **spread}

    def parameters(self) -> dict[str, tuple[float, float, float]]:
        """Return estimate, and low and high end of the interval, of each parameter by name."""
        return {
            name: (value, *map(float, ends))
            for (name, value), ends in zip(self.fit.values().items(), self.intervals)
        }


def calibrate(
    steps: Steps, model: str, systematic: Sequence[str], wheel_base: float, seed: int
) -> ModelCalibration:
    """Find the parameters of a model, and how well halves of the steps predict each other.

    A random walk is fitted to the (short) steps as they are if it describes them, or else to long
    ones. The other models depend on the length of steps. Raises LabError if the steps do not
    determine the parameters.
    """
    make = functools.partial(Problem, model=model, systematic=systematic, wheel_base=wheel_base)

    def fitted(length: tuple[float, float]) -> tuple[Fit, Goodness]:
        pairs, follows = pairs_of(steps, length)
        found = fit(make(pairs))
        return found, goodness(found, follows, seed)

    length = EACH
    try:
        found, quality = fitted(length)
        if issubclass(MODELS[model], WalkRule) and not quality.fits:
            length = long_length(steps)
        if length != EACH:
            found, quality = fitted(length)
        prediction = judged(list(predictions(make, steps, length)))
        ends = intervals(found)[0]
    except np.linalg.LinAlgError:
        raise LabError(
            f"{model}: the steps do not determine its parameters: "
            "do odometry and truth belong together, and does the robot drive and turn?"
        ) from None
    problem = found.problem
    coordinates = problem.coordinates(ends.T).T
    middle = found.coordinates[0][:, np.newaxis]
    wider = middle + math.sqrt(prediction.dispersion) * (coordinates - middle)
    # An interval that begins at 0 keeps to it.
    wider = np.where(ends == 0.0, 0.0, problem.values(wider.T).T)
    return ModelCalibration(found, wider, quality, prediction, length)


def predictions(make: Callable[[StepPairs], Problem], steps: Steps, length: tuple[float, float]):
    """Yield windows of each half of the steps, predicted by a fit of the other."""
    for number in (0, 1):
        found = fit(make(pairs_of(part_of(steps, number), length)[0]))
        others = pairs_of(part_of(steps, 1 - number))
        for size in LENGTHS:
            yield predicted(found, *others, size)


def symbol(name: str) -> str:
    """Return the symbol of a parameter: its Greek letter, or else its name.

    >>> symbol("alpha1"), symbol("std"), symbol("base_error")
    ('α1', 'σ', 'base_error')
    """
    return "σ" if name == "std" else name.replace("alpha", "α")


def label_of(name: str) -> str:
    """Return the name of a parameter, with its Greek letter if it has one."""
    return name if symbol(name) == name else f"{name} ({symbol(name)})"


def meaning(model: str, name: str) -> str:
    """Return the description of a parameter from its declaration."""
    known = {**declarations(SystematicErrors), **declarations(MODELS[model])}
    doc = known[name].doc
    return doc[len(model) + 2 :] if doc.startswith(f"{model}: ") else doc


def model_summary(one: ModelCalibration) -> Summary:
    """Return the figures of a model for summary.json."""
    fitted = one.goodness
    return {
        "model": one.model,
        "log_likelihood": float(one.fit.log_likelihood[0]),
        "step_length": one.length,
        "on_limit": one.limited,
        "prediction": {**asdict(one.prediction), "density": one.prediction.density},
        "published": one.published(),
        "parameters": {
            name: {
                "symbol": symbol(name),
                "meaning": meaning(one.model, name),
                "estimate": value,
                "interval_95": [_finite(low), _finite(high)],
            }
            for name, (value, low, high) in one.parameters().items()
        },
        "goodness": {
            "fits": fitted.fits,
            "p_value": fitted.p_value,
            "nees_per_part": fitted.nees,
            "shape": {"ks_distance": fitted.distance, "p_value": fitted.shape_p},
            "size": {"mean_square": _by_part(fitted.mean_squares), "p_value": fitted.size_p},
            "neighbours": {
                "correlation": _by_part(fitted.correlations),
                "p_value": fitted.neighbours_p,
            },
            "said": fitted.words(),
        },
    }


def _by_part(values: np.ndarray) -> dict[str, float | None]:
    return {part: _finite(value) for part, value in zip(PARTS, values.tolist())}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def lines(ranked: Sequence[ModelCalibration], true: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Return the results of all models as lines for the user.

    Args:
        ranked: calibration of each model, the best one first.
        true: true values by model and name, if they are known.
    """
    text: list[str] = []
    for one in ranked:
        less = ranked[0].prediction.density - one.prediction.density
        rank = "predicts best" if one is ranked[0] else f"predicts worse by {less:.2f}"
        steps = "steps of {:g} m or {:g} rad" if one.length != EACH else "each step"
        text.append(f"{one.model}: {rank}; {steps.format(*one.length)}; {_verdict(one.goodness)}")
        text += [f"  NO RESULT: {name} lies on its limit" for name in one.limited]
        text.append(f"  {_predicted(one.prediction)}")
        text += [f"  {line}" for line in _parameter_lines(one, true.get(one.model, {}))]
        text += [f"  does not fit: {reason}" for reason in one.goodness.words()]
    return text


def _parameter_lines(one: ModelCalibration, true: Mapping[str, float]) -> list[str]:
    text = []
    for name, (value, low, high) in one.parameters().items():
        truth = f", true {true[name]:g}" if name in true else ""
        text.append(
            f"{label_of(name):20} {value:11.5g}   95 % {low:.4g} to {high:.4g}{truth}   "
            f"{meaning(one.model, name)}"
        )
    return text


def _predicted(prediction: Prediction) -> str:
    each = ", ".join(
        f"{100.0 * one.held:.0f} % of {one.windows} windows of {one.length:g} m"
        for one in prediction.scores
    )
    return (
        f"variances {prediction.dispersion:.2f} times as large as steps show; "
        + (f"halves then hold each other's ends in {each}" if each else "too short to predict")
    )


def _verdict(found: Goodness) -> str:
    if found.fits:
        return f"nothing speaks against it (p = {found.p_value:.2g})"
    return f"it does NOT fit (p = {found.p_value:.2g})"


def noise_yaml(one: ModelCalibration, source: str, seconds: float) -> str:
    """Return a YAML file with the parameters for noisy_odom, described in comments.

    `seconds` is the median time of a step.
    """
    verdict = _verdict(one.goodness)
    rate = "any steps" if issubclass(MODELS[one.model], WalkRule) else f"steps of {seconds:.3g} s"
    comments = [
        f"Noise of an odometry, found by calibrate from {source}, for {rate}.",
        f"{_predicted(one.prediction)}.",
        f"Of single steps: {verdict}. Their values, with intervals for that factor:",
        *_parameter_lines(one, {}),
    ]
    values = {"model": one.model}
    for name, value in one.published().items():
        values[name] = float(f"{value:.9g}")
    problem = one.fit.problem
    if problem.systematic:
        values["wheel_base"] = problem.wheel_base
    text = "".join(f"# {comment}\n" for comment in comments)
    return text + yaml.safe_dump(values, sort_keys=False)


def residuals_figure(found: Sequence[ModelCalibration]) -> Figure:
    """Draw the whitened residuals of each model against quantiles of the normal distribution."""
    title = "Errors of the steps: on the line, the model is right"
    size = 4.2 * len(found), 4.6
    labels = ("standard normal", "error / standard deviation by the model")
    figure, (row,) = panels((1, len(found)), size, title, labels, sharex=True, sharey=True)
    for axes, one in zip(row, found):
        axes.plot([-4.0, 4.0], [-4.0, 4.0], color=BLACK, linewidth=0.8)
        for values, part, colour in zip(one.goodness.whitened.T, _PART_TITLES, _COLOURS):
            seen = np.sort(values[np.isfinite(values)])
            if seen.size:
                normal = ndtri((np.arange(seen.size) + 0.5) / seen.size)
                shown = np.clip(seen, -_WIDEST, _WIDEST)
                axes.plot(normal, shown, ".", markersize=3.0, color=colour, label=part)
        fitted = one.goodness
        verdict = f"{'fits' if fitted.fits else 'does not fit'}, p = {fitted.p_value:.2g}"
        axes.set_title(f"{MODELS[one.model].title}: {verdict}", fontsize=10)
        axes.set(xlim=(-4.0, 4.0), ylim=(-_WIDEST, _WIDEST))
    row[0].legend(loc="upper left", fontsize=8)
    figure.tight_layout()
    return figure


def profiles_figure(one: ModelCalibration, true: Mapping[str, float]) -> Figure:
    """Draw the profile likelihood of each parameter of a model, with its interval."""
    parameters = one.parameters()
    columns = min(4, len(parameters))
    rows = -(-len(parameters) // columns)
    title = f"{MODELS[one.model].title}: profile likelihoods and 95 % intervals"
    size = 3.1 * columns + 0.4, 2.7 * rows + 0.5
    figure, grid = panels((rows, columns), size, title, ("", "fall of 2 log L"), sharey=True)
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
    grid[0, 0].set_ylim(0.0, 8.0 * one.prediction.dispersion)
    figure.tight_layout()
    return figure


def _draw_profile(axes: Axes, one: ModelCalibration, name: str, found) -> None:
    value, low, high = found
    axes.axhline(_LIMIT * one.prediction.dispersion, **THIN, linestyle="--")
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
        points += zip(side, profile(one.fit, name, side))
    x, fall = np.array(sorted(points)).T
    # The signed root of the fall is nearly linear, and is interpolated.
    root = np.sign(x - value) * np.sqrt(fall)
    fine = np.linspace(x[0], x[-1], 120)
    axes.plot(fine, np.interp(fine, x, root) ** 2, color=BLUE)


def paths_figure(recordings: Sequence[Recording], one: ModelCalibration) -> Figure:
    """Draw truth and odometry from one start, and the truth with the systematic errors found."""
    shown = recordings[:MOST_PATHS]
    figure, (row,) = panels((1, len(shown)), (max(6.4, 5.4 * len(shown)), 5.8))
    values, problem = one.fit.values(), one.fit.problem
    wrong = {name: values[name] for name in problem.systematic}
    errors = SystematicErrors(wheel_base=problem.wheel_base, **wrong)
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


def coverage_figure(found: Sequence[Record]) -> Figure:
    """Draw the share of intervals of each parameter that hold the truth, with bands."""
    labels = ("95 % intervals that hold the truth (%)", "")
    figure, ((axes,),) = panels((1, 1), (8.0, 1.6 + 0.28 * len(found)), "", labels, False)
    axes.axvspan(93.0, 97.0, color=GREY, alpha=0.25, linewidth=0.0)
    axes.axvline(95.0, color=BLACK, linewidth=0.8)
    models = list(dict.fromkeys(one["model"] for one in found))
    for row, one in enumerate(found):
        colour = _COLOURS[models.index(one["model"]) % len(_COLOURS)]
        band = [100.0 * one["band_low"], 100.0 * one["band_high"]]
        axes.plot(band, [row, row], color=colour, linewidth=2.0)
        axes.plot(100.0 * one["share"], row, "o", color=colour)
    axes.set_yticks(range(len(found)))
    names = [f"{one['model']}: {one['parameter']}" for one in found]
    axes.set_yticklabels(names, fontsize=8)
    axes.invert_yaxis()
    axes.grid(alpha=0.3, axis="x")
    axes.set_title(f"{found[0]['paths']} paths for each model", fontsize=10)
    figure.tight_layout()
    return figure
