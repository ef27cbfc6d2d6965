"""What calibration finds: of each model, as figures, as lines, and as a file for noisy_odom."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.parameters import declarations
from bullet_lab.errors import LabError
from bullet_lab.noise.calibration import Fit, Problem, covariance, fit, intervals
from bullet_lab.noise.goodness import Goodness, goodness
from bullet_lab.noise.likelihood import PARTS
from bullet_lab.noise.odometry_noise import MODELS
from bullet_lab.noise.systematic import SystematicErrors

_ALIKE = 0.99  # correlation of two estimates that the steps cannot tell apart


class UndeterminedError(LabError):
    """Steps do not tell what the parameters of a model are."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a noise model, with systematic errors, has to say of the steps.

    Attributes:
        problem: which parameters were asked of which steps.
        fit: the values that are most likely.
        intervals: of the parameters, 95 %, shape (k, 2).
        goodness: of the fit.
    """

    problem: Problem
    fit: Fit
    intervals: np.ndarray
    goodness: Goodness

    @property
    def model(self) -> str:
        """Name of the noise model."""
        return self.fit.model

    @property
    def aic(self) -> float:
        """Akaike's criterion: less is better."""
        return float(self.fit.aic()[0])

    def parameters(self) -> Dict[str, Tuple[float, float, float]]:
        """Return estimate and interval of each parameter by name."""
        return {
            name: (value, *map(float, ends))
            for (name, value), ends in zip(self.fit.values().items(), self.intervals)
        }

    def inseparable(self) -> List[Tuple[str, str]]:
        """Return parameters that the steps cannot tell apart, two and two."""
        inverse = covariance(self.fit.information)[0][0]
        spread = np.sqrt(np.diagonal(inverse))
        alike = np.abs(inverse / np.outer(spread, spread)) > _ALIKE
        pairs = np.argwhere(np.triu(alike, 1)).tolist()
        return [(self.fit.names[i], self.fit.names[j]) for i, j in pairs]


def calibrate(problem: Problem, follows: np.ndarray, seed: int) -> Calibration:
    """Find the parameters of a problem with one odometry; for the arguments see `goodness`.

    Raises:
        UndeterminedError: the steps do not determine them.
    """
    try:
        found = fit(problem)
        ends, quality = intervals(problem, found)[0], goodness(problem, found, follows, seed)
    except np.linalg.LinAlgError:
        raise UndeterminedError(
            f"{problem.model}: the steps do not determine its parameters: "
            "do odometry and truth belong together, and does the robot drive and turn?"
        ) from None
    return Calibration(problem, found, ends, quality)


def symbol(name: str) -> str:
    """Return how a parameter is written, its Greek letter where it has one.

    >>> symbol("alpha1"), symbol("std"), symbol("base_error")
    ('α1', 'σ', 'base_error')
    """
    return name.replace("alpha", "α") if name.startswith("alpha") else {"std": "σ"}.get(name, name)


def meaning(model: str, name: str) -> str:
    """Return what a parameter is, as it is declared."""
    known = {**declarations(SystematicErrors), **declarations(MODELS[model])}
    doc = known[name].check.doc
    return doc[len(model) + 2 :] if doc.startswith(f"{model}: ") else doc


def calibration_summary(found: Sequence[Calibration]) -> Dict[str, Any]:
    """Return the figures of all models, for summary.json, the best one first."""
    ranked = sorted(found, key=lambda one: one.aic)
    return {"best": ranked[0].model, "models": [_summary(one, ranked[0].aic) for one in ranked]}


def _summary(one: Calibration, best: float) -> Dict[str, Any]:
    judged = one.goodness
    return {
        "model": one.model,
        "log_likelihood": float(one.fit.log_likelihood[0]),
        "aic": one.aic,
        "aic_above_best": one.aic - best,
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
            "fits": judged.fits,
            "p_value": judged.p_value,
            "nees_per_part": judged.nees,
            "shape": {"ks_distance": judged.distance, "p_value": judged.shape_p},
            "size": {"mean_square": _by_part(judged.mean_squares), "p_value": judged.size_p},
            "neighbours": {
                "correlation": _by_part(judged.correlations),
                "p_value": judged.neighbours_p,
            },
            "said": judged.words(),
        },
        "inseparable": one.inseparable(),
    }


def _by_part(values: np.ndarray) -> Dict[str, Optional[float]]:
    return {part: _finite(value) for part, value in zip(PARTS, values.tolist())}


def _finite(value: float) -> Optional[float]:
    return value if math.isfinite(value) else None


def lines(found: Sequence[Calibration], true: Mapping[str, Mapping[str, float]]) -> List[str]:
    """Return what people read: all models, the best first.

    Args:
        found: of each model.
        true: values by model and name, where they are known.
    """
    ranked = sorted(found, key=lambda one: one.aic)
    said: List[str] = []
    for one in ranked:
        known = true.get(one.model, {})
        above = one.aic - ranked[0].aic
        rank = "the likeliest model" if one is ranked[0] else f"AIC {above:.1f} above the best"
        said.append(f"{one.model}: {rank}; {_verdict(one.goodness)}")
        for name, (value, low, high) in one.parameters().items():
            truth = f", true {known[name]:g}" if name in known else ""
            label = name if symbol(name) == name else f"{name} ({symbol(name)})"
            said.append(
                f"  {label:20} {value:11.5g}   95 % {low:.4g} to {high:.4g}{truth}"
                f"   {meaning(one.model, name)}"
            )
        said += [f"  does not fit: {reason}" for reason in one.goodness.words()]
        said += [
            f"  {first} and {second} can hardly be told apart on this path; leave one of them out "
            "by systematic:=, or drive backwards as well"
            for first, second in one.inseparable()
            if one is ranked[0]
        ]
    return said


def _verdict(judged: Goodness) -> str:
    if judged.fits:
        return f"nothing speaks against it (p = {judged.p_value:.2g})"
    return f"it does NOT fit (p = {judged.p_value:.2g})"


def noise_yaml(one: Calibration, source: str, seconds: float) -> str:
    """Return parameters as noisy_odom loads them, with what they are in comments.

    Args:
        one: what was found.
        source: of the steps.
        seconds: the usual time of a step.
    """
    verdict = _verdict(one.goodness)
    rows = [
        f"# Noise of an odometry, found by calibrate from {source}.",
        f"# Steps of {seconds:.3g} s; for others only rate_invariant is about the same.",
        f"# The model: {verdict}.",
        f"model: {one.model}",
    ]
    for name, (value, low, high) in one.parameters().items():
        label = "" if symbol(name) == name else f"{symbol(name)}, "
        said = f"{label}{meaning(one.model, name)}: {low:.4g} to {high:.4g} (95 %)"
        rows.append(f"{name}: {_plain(value)}  # {said}")
    if one.problem.systematic:
        rows.append(f"wheel_base: {_plain(one.problem.wheel_base)}  # m, as it was taken to be")
    return "\n".join(rows) + "\n"


def _plain(value: float) -> str:
    """Return a number as YAML's readers take it, which know 1.0e-05 but not 1e-05."""
    text = repr(float(f"{value:.9g}"))
    return text if "." in text or "e" not in text else text.replace("e", ".0e")
