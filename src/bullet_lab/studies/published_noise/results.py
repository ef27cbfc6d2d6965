"""Likelihood of figure 1b under replays of the report's noise, and the verdict on its defects.

Two lengths count as alike when they differ by about the resolution of the measurement, or by
about a quarter of their size: a length d is known to sqrt(RESOLUTION² + (TOLERANCE · d)²). On
the scale asinh(d · TOLERANCE / RESOLUTION), straight for small lengths and logarithmic for large
ones, that is the same TOLERANCE everywhere. The likelihood of a measurement is that of a
Gaussian of that width around each simulated run, averaged over the runs; the Gaussian is folded
at 0, since what is read from a picture is the size of a deviation, never less than 0.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, replace
from typing import Any, Dict, List, Mapping, Sequence

import numpy as np
from scipy.special import logsumexp, ndtr

from bullet_lab.errors import LabError
from bullet_lab.studies.published_noise.defects import DEFECTS, Defects
from bullet_lab.studies.published_noise.side_deviation import SIDES

RESOLUTION = 0.003
"""m; what can be read from figure 1 of the report."""

TOLERANCE = 0.25
"""As a share; wide enough to have some of a thousand runs within it."""

SIGNIFICANCE = 0.05
"""Runs for which a measurement has a smaller p-value than this do not explain it."""

_MOST_REPLICAS = 500  # for the p-value, which takes the product of runs and replicas
_BLOCK = 100


class LikenessError(LabError):
    """The lengths cannot be compared."""


@dataclass(frozen=True, eq=False)
class Likeness:
    """How well the runs explain the measurement.

    Attributes:
        log_likelihood: natural logarithm of the likelihood, on the scale of this module; of use
            only beside that of other runs.
        log_likelihood_error: its standard error, from the number of runs.
        percentiles: share of the runs below each measured length, the measurement's error
            included, 0 to 1, shape (k,).
        p_value: share of runs, measured as badly, that would be as unlikely as the measurement
            or more, of 500 at most. Small: the runs do not explain it. Never less than 1 / 501.
        nearest: which of the runs is most like the measurement.
    """

    log_likelihood: float
    log_likelihood_error: float
    percentiles: np.ndarray
    p_value: float
    nearest: int


def log_likelihood(
    measured, runs, resolution: float = RESOLUTION, tolerance: float = TOLERANCE
) -> float:
    """Return that of `compare`, for another resolution (m) and tolerance (as a share)."""
    measured, runs = _checked(measured, runs)
    point, cloud = (_scale(lengths, resolution, tolerance) for lengths in (measured, runs))
    return float(_log_mean(_exponents(point[np.newaxis], cloud, tolerance))[0])


def compare(measured, runs, seed: int) -> Likeness:
    """Say how well runs explain a measurement.

    Args:
        measured: k lengths (m), shape (k,).
        runs: the same of m simulated runs, shape (m, k), m at least 2.
        seed: of the errors that the runs get for the p-value.

    Raises:
        LikenessError: the shapes do not go together or a length is not finite and >= 0.
    """
    measured, runs = _checked(measured, runs)
    point, cloud = _scale(measured), _scale(runs)
    exponents = _exponents(point[np.newaxis], cloud)[0]
    logarithm = float(_log_mean(exponents))
    weights = np.exp(exponents - exponents.max())
    return Likeness(
        log_likelihood=logarithm,
        log_likelihood_error=float(np.std(weights) / np.mean(weights) / math.sqrt(len(runs))),
        # Shares of the folded Gaussians.
        percentiles=(ndtr((point - cloud) / TOLERANCE) - ndtr(-(point + cloud) / TOLERANCE)).mean(
            axis=0
        ),
        p_value=_p_value(logarithm, cloud, seed),
        nearest=int(np.argmax(exponents)),
    )


def _checked(measured, runs) -> tuple[np.ndarray, np.ndarray]:
    measured, runs = np.asarray(measured, dtype=float), np.asarray(runs, dtype=float)
    if runs.ndim != 2 or measured.shape != runs.shape[1:] or len(runs) < 2:
        raise LikenessError(f"lengths of shape {measured.shape} and {runs.shape}")
    for lengths in (measured, runs):
        if not (np.isfinite(lengths).all() and (lengths >= 0.0).all()):
            raise LikenessError("a length is not finite and >= 0")
    return measured, runs


def _scale(
    lengths: np.ndarray, resolution: float = RESOLUTION, tolerance: float = TOLERANCE
) -> np.ndarray:
    return np.arcsinh(lengths * (tolerance / resolution))


def _exponents(points: np.ndarray, cloud: np.ndarray, tolerance: float = TOLERANCE) -> np.ndarray:
    """Return the logarithm of the folded Gaussian of each of the cloud at each point."""
    norm = cloud.shape[1] * math.log(tolerance * math.sqrt(2.0 * math.pi))
    exponents = np.full((len(points), len(cloud)), -norm)
    folds = np.ones_like(exponents)
    for point, centre in zip(points.T, cloud.T):
        exponents -= (point[:, np.newaxis] - centre) ** 2 / (2.0 * tolerance**2)
        folds *= 1.0 + np.exp(np.outer(point, centre) * (-2.0 / tolerance**2))
    return exponents + np.log(folds)


def _log_mean(exponents: np.ndarray) -> np.ndarray:
    """Return the logarithm of the mean of exp(exponents) over the last axis."""
    return logsumexp(exponents, axis=-1) - math.log(exponents.shape[-1])


def _p_value(log_likelihood: float, cloud: np.ndarray, seed: int) -> float:
    """Measure each run as the figure was measured, and judge it by the other runs."""
    count = min(len(cloud), _MOST_REPLICAS)
    errors = np.random.default_rng(seed).standard_normal((count, cloud.shape[1]))
    replicas = np.abs(cloud[:count] + TOLERANCE * errors)
    as_unlikely = 0
    for start in range(0, count, _BLOCK):
        rows = np.arange(start, min(start + _BLOCK, count))
        exponents = _exponents(replicas[rows], cloud)
        exponents[np.arange(len(rows)), rows] = -np.inf
        others = _log_mean(exponents) + math.log(len(cloud) / (len(cloud) - 1))
        as_unlikely += int(np.count_nonzero(others <= log_likelihood))
    return (as_unlikely + 1) / (count + 1)


QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_SHARES = ("q05", "q25", "q50", "q75", "q95")

PLACES = (*(f"side{side}" for side in range(1, SIDES + 1)), "end")
"""Where a path deviates: across each side at most, and at the end of the drive."""

DOUBT = 0.01
"""A defect is needed (or ruled out) if less than this share of the likelihood is without it
(or with it). In between, the figure cannot tell."""

SAME = 1e-4
"""m; combinations whose deviations are never further apart do the same: no figure shows it."""


@dataclass(frozen=True, eq=False)
class Result:
    """What came of one combination of defects.

    Attributes:
        defects: the combination.
        deviations: m, of each noisy path, shape (seeds, 5): see `PLACES`.
        likeness: how well these explain the deviations in the published figure.
    """

    defects: Defects
    deviations: np.ndarray
    likeness: Likeness

    def quantiles(self) -> np.ndarray:
        """Return the `QUANTILES` of the deviations (m), a row for each, columns as `PLACES`."""
        return np.quantile(self.deviations, QUANTILES, axis=0)

    def does_the_same_as(self, other: Result) -> bool:
        """Return whether each path strays as far with these defects as with the others."""
        return bool(np.abs(self.deviations - other.deviations).max() <= SAME)


def ranked(results: Sequence[Result]) -> List[Result]:
    """Return the results, the one that explains the figure best first."""
    return sorted(results, key=lambda result: -result.likeness.log_likelihood)


def groups_of_same(results: Sequence[Result]) -> List[List[Result]]:
    """Put results together that are the same to `SAME`, in the order given."""
    groups: List[List[Result]] = []
    for result in results:
        home = next((group for group in groups if group[0].does_the_same_as(result)), None)
        if home is None:
            groups.append([result])
        else:
            home.append(result)
    return groups


def log10_to_best(results: Sequence[Result]) -> List[float]:
    """Return the decimal logarithm of each likelihood over that of the first."""
    best = results[0].likeness.log_likelihood
    return [(result.likeness.log_likelihood - best) / math.log(10.0) for result in results]


def published_summary(
    about: Mapping[str, Any],
    figure: Mapping[str, Any],
    measured: np.ndarray,
    results: Sequence[Result],
) -> Dict[str, Any]:
    """Return what summary.json says.

    Args:
        about: the settings.
        figure: what is to be said of the published figure.
        measured: its deviations (m), at each of `PLACES`.
        results: of all combinations, ranked.
    """
    # The share that each has in the likelihood of all, all held equally likely before.
    shares = np.power(10.0, log10_to_best(results))
    weights = shares / shares.sum()
    findings = {name: _finding(name, results, weights) for name in DEFECTS}
    needed = [name for name in DEFECTS if findings[name]["verdict"] == "needed"]
    return {
        "job": "published_noise",
        **about,
        "figure_1b": dict(figure),
        "explained": results[0].likeness.p_value >= SIGNIFICANCE,
        "winners": [str(r.defects) for r, weight in zip(results, weights) if weight > DOUBT],
        "needed": needed,
        "cannot_be_told": [
            name for name in DEFECTS if findings[name]["verdict"] == "cannot be told"
        ],
        # Were lengths read half or twice as well.
        "robustness": [
            _judge_anew(measured, results, needed, resolution * RESOLUTION, tolerance * TOLERANCE)
            for resolution in (0.5, 1.0, 2.0)
            for tolerance in (0.5, 1.0, 2.0)
        ],
        "defects": findings,
        "combinations": [
            {"rank": rank, **_describe(result, ratio, weight, results)}
            for rank, (result, ratio, weight) in enumerate(
                zip(results, log10_to_best(results), weights), start=1
            )
        ],
    }


def _finding(name: str, results: Sequence[Result], weights: np.ndarray) -> Dict[str, Any]:
    """Say what the figure says about one defect."""
    weight = float(sum(w for r, w in zip(results, weights) if getattr(r.defects, name)))
    best_with, best_without = (
        next(r for r in results if getattr(r.defects, name) == is_in) for is_in in (True, False)
    )
    best = results[0]
    twin = replace(best.defects, **{name: not getattr(best.defects, name)})
    verdict = "needed" if weight > 1.0 - DOUBT else "ruled out" if weight < DOUBT else None
    with_over_without = log10_to_best([best_without, best_with])[1]
    return {
        "verdict": verdict or "cannot be told",
        "weight": round(weight, 6),
        "log10_likelihood_with_over_without": round(with_over_without, 3),
        "best_without": str(best_without.defects),
        "changes_nothing_in_the_best": best.does_the_same_as(
            next(result for result in results if result.defects == twin)
        ),
    }


def _judge_anew(
    measured: np.ndarray,
    results: Sequence[Result],
    needed: Sequence[str],
    resolution: float,
    tolerance: float,
) -> Dict[str, Any]:
    logs = {
        r.defects: log_likelihood(measured, r.deviations, resolution, tolerance) / math.log(10.0)
        for r in results
    }
    best = max(logs, key=lambda defects: logs[defects])
    without = [log for defects, log in logs.items() if not set(needed) <= set(defects.names)]
    return {
        "resolution_m": resolution,
        "tolerance": tolerance,
        "best": str(best),
        "log10_likelihood_without_all_needed": (
            round(max(without) - logs[best], 3) if without else None
        ),
    }


def _describe(
    result: Result, ratio: float, weight: float, results: Sequence[Result]
) -> Dict[str, Any]:
    likeness, quantiles = result.likeness, result.quantiles()
    return {
        "name": str(result.defects),
        "defects": list(result.defects.names),
        "log10_likelihood_to_best": round(ratio, 3),
        "log10_likelihood_error": round(likeness.log_likelihood_error / math.log(10.0), 3),
        "weight": float(f"{weight:.3g}"),
        "p_value": round(likeness.p_value, 4),
        "side_percentile_of_figure_1b": rounded(100.0 * likeness.percentiles[:SIDES], 1),
        "side_deviation_m": {share: rounded(row[:SIDES]) for share, row in zip(_SHARES, quantiles)},
        "end_percentile_of_figure_1b": round(100.0 * float(likeness.percentiles[SIDES]), 1),
        "end_deviation_m": dict(zip(_SHARES, rounded(quantiles[:, SIDES]))),
        "same_as": [
            str(other.defects)
            for other in results
            if other is not result and result.does_the_same_as(other)
        ],
    }


def rounded(values: Sequence[float], digits: int = 5) -> List[float]:
    """Return values for a table."""
    return [round(float(value), digits) for value in values]


def combination_rows(results: Sequence[Result]) -> List[List[Any]]:
    """Return combinations.csv: a header, and a row for each combination, ranked; m and %."""
    header = ["rank", *DEFECTS, "log10_likelihood_to_best", "p_value"]
    for place in PLACES:
        header += [f"{place}_{share}_m" for share in _SHARES] + [f"{place}_percentile"]
    rows: List[List[Any]] = [header]
    for rank, (result, ratio) in enumerate(zip(results, log10_to_best(results)), start=1):
        switches = map(int, astuple(result.defects))
        row = [rank, *switches, round(ratio, 3), round(result.likeness.p_value, 4)]
        for quantiles, percentile in zip(result.quantiles().T, result.likeness.percentiles):
            row += rounded(quantiles) + [round(100.0 * float(percentile), 1)]
        rows.append(row)
    return rows


def deviation_rows(results: Sequence[Result], first_seed: int) -> List[List[Any]]:
    """Return deviations.csv: a header, and a row for each combination and seed; m."""
    header = ["seed", *DEFECTS, *(f"{place}_m" for place in PLACES)]
    rows: List[List[Any]] = [header]
    for result in results:
        switches = list(map(int, astuple(result.defects)))
        for seed, deviations in enumerate(result.deviations, start=first_seed):
            rows.append([seed, *switches, *rounded(deviations, 6)])
    return rows


def verdict_lines(summary: Mapping[str, Any]) -> List[str]:
    """Return what a summary comes down to, for the terminal."""
    figure, best = summary["figure_1b"], summary["combinations"][0]
    lines = [
        f"figure 1b strays {_millimetres(figure['side_deviation_m'])} mm on sides 1 to 4; "
        f"its third side has {figure['third_side_steps']} steps: {figure['sampling_rate_hz']} Hz",
        f"best of 32: {best['name']}: median {_millimetres(best['side_deviation_m']['q50'])} mm, "
        f"p = {best['p_value']:.3g}",
    ]
    if not summary["explained"]:
        return [*lines, "no combination explains figure 1b"]
    for name in DEFECTS:
        finding = summary["defects"][name]
        ratio = _ratio_text(finding["log10_likelihood_with_over_without"])
        lines.append(f"  {name + ':':15}{finding['verdict']} (likelihood with / without: {ratio})")
    return lines


def _ratio_text(log10_ratio: float) -> str:
    # Beyond, no path is like the figure, and the number says only that it is far off.
    if abs(log10_ratio) > 4.0:
        return "> 10000" if log10_ratio > 0.0 else "< 0.0001"
    return f"{10.0**log10_ratio:.3g}"


def _millimetres(metres: Sequence[float]) -> str:
    return ", ".join(f"{1e3 * value:.1f}" for value in metres)
