"""P-values of figure 1b under each combination of defects, and the verdict on each defect.

Each length read from figure 1b has a rank among those of the replays. Its two-sided p-value is
twice the share of replays, including the figure, that are at least as extreme on the figure's side.
For several lengths it is the smallest p-value times their number (Bonferroni). This assumes neither
their correlation nor their distributions.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Any, Dict, List, Mapping, Sequence, Tuple

import numpy as np

from bullet_lab.noise.published_noise import DEFECTS, Defects
from bullet_lab.studies.published_noise.drawn_paths import LENGTHS, SIDES
from bullet_lab.studies.shares import clopper_pearson

SIGNIFICANCE = 0.05
"""Smallest p-value of a combination that explains the figure."""

CONFIDENCE = 0.95
"""Confidence of the bound `PValue.high`."""

EVIDENCE = {
    "sides": slice(0, SIDES),
    "start": slice(SIDES, SIDES + 1),
    "corners": slice(SIDES + 1, SIDES + 2),
    "all": slice(0, SIDES + 2),
}
"""Lengths that a p-value uses: some alone, and all together."""

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_SHARES = ("q05", "q25", "q50", "q75", "q95")

NEEDED, RULED_OUT, UNKNOWN = "needed", "ruled out", "cannot be told"

_SMALL = 1e-3  # m; much smaller lengths count as equal
_SAME = 1e-12  # m


@dataclass(frozen=True)
class PValue:
    """A p-value from replays.

    Attributes:
        value: with the figure counted among the replays, 0 to 1. For a figure that is a replay
            itself, the probability that it is below any share is at most that share.
        high: upper bound, with `CONFIDENCE`, of the p-value of infinitely many replays: Clopper
            and Pearson's bounds, for all tails of all lengths at once.
    """

    value: float
    high: float

    @property
    def explains(self) -> bool:
        """Whether the figure is plausible."""
        return self.value >= SIGNIFICANCE

    @property
    def excludes(self) -> bool:
        """Whether the figure is implausible, by enough replays."""
        return self.high < SIGNIFICANCE


def p_value(measured, runs) -> PValue:
    """Return the p-value of a measurement among runs; see this module.

    Args:
        measured: k lengths (m), shape (k,).
        runs: the same of m runs, shape (m, k), m at least 2.

    >>> p_value([0.2], [[0.1 * k] for k in range(1, 100)]).value
    0.06
    """
    runs = np.asarray(runs)
    count, tails = len(runs), 2 * len(measured)
    further_out = min((runs <= measured).sum(axis=0).min(), (runs >= measured).sum(axis=0).min())
    _, bound = clopper_pearson(further_out, count, (1.0 - CONFIDENCE) / tails)
    return PValue(
        min(1.0, tails * float(further_out + 1) / (count + 1)), min(1.0, tails * bound)
    )


@dataclass(frozen=True, eq=False)
class Result:
    """The result of a combination of defects.

    Attributes:
        defects: the combination.
        lengths: m, of each noisy path, shape (seeds, 6): see `LENGTHS`.
        p_values: of figure 1b, for each `EVIDENCE`.
        percentiles: share of the paths below each of the figure's lengths, shape (6,).
    """

    defects: Defects
    lengths: np.ndarray
    p_values: Mapping[str, PValue]
    percentiles: np.ndarray

    @staticmethod
    def of(defects: Defects, lengths: np.ndarray, measured: np.ndarray) -> Result:
        """Return the result of noisy paths with these lengths (m), and those of figure 1b."""
        p_values = {
            name: p_value(measured[part], lengths[:, part]) for name, part in EVIDENCE.items()
        }
        return Result(defects, lengths, p_values, (lengths < measured).mean(axis=0))

    @property
    def quantiles(self) -> np.ndarray:
        """The `QUANTILES` of the lengths (m), a row for each, columns as `LENGTHS`."""
        return np.quantile(self.lengths, QUANTILES, axis=0)

    def does_the_same_as(self, other: Result) -> bool:
        """Return whether each path has the same lengths in both results."""
        return bool(np.abs(self.lengths - other.lengths).max() <= _SAME)


def nearest(measured: np.ndarray, lengths: np.ndarray) -> int:
    """Return the index of the path that is most like the figure, by the ratios of all lengths."""
    ratios = np.log((lengths + _SMALL) / (measured + _SMALL))
    return int(np.abs(ratios).sum(axis=1).argmin())


def ranked(results: Sequence[Result]) -> List[Result]:
    """Return the results, those with the largest p-value first."""

    def key(result: Result) -> Tuple[float, float]:
        values = [p.value for p in result.p_values.values()]
        return -result.p_values["all"].value, -sum(values)

    return sorted(results, key=key)


def groups_of_same(results: Sequence[Result]) -> List[List[Result]]:
    """Return groups of equal results, in the given order."""
    groups: List[List[Result]] = []
    for result in results:
        for group in groups:
            if group[0].does_the_same_as(result):
                group.append(result)
                break
        else:
            groups.append([result])
    return groups


def verdict(name: str, results: Sequence[Result], evidence: str) -> str:
    """Return the verdict on a defect: `NEEDED`, `RULED_OUT` or `UNKNOWN`.

    It is needed if all combinations without it are excluded, while one with it explains the
    figure, and ruled out if all with it are excluded, while one without it explains the figure.
    """
    with_it, without = (
        [r.p_values[evidence] for r in results if getattr(r.defects, name) == enabled]
        for enabled in (True, False)
    )
    for yes, no, word in ((with_it, without, NEEDED), (without, with_it, RULED_OUT)):
        if any(p.explains for p in yes) and all(p.excludes for p in no):
            return word
    return UNKNOWN


def published_summary(
    about: Mapping[str, Any], figure: Mapping[str, Any], results: Sequence[Result]
) -> Dict[str, Any]:
    """Return the content of summary.json.

    Args:
        about: the settings.
        figure: values of the published figure.
        results: of all combinations, ranked.
    """
    verdicts = {
        evidence: {name: verdict(name, results, evidence) for name in DEFECTS}
        for evidence in EVIDENCE
    }
    overall = verdicts["all"]
    return {
        "job": "published_noise",
        **about,
        "figure_1b": dict(figure),
        "explained_by": [str(r.defects) for r in results if r.p_values["all"].explains],
        "needed": [name for name in DEFECTS if overall[name] == NEEDED],
        "cannot_be_told": [name for name in DEFECTS if overall[name] == UNKNOWN],
        "verdicts": verdicts,
        "combinations": [
            {"rank": rank, **_describe(result, results)} for rank, result in enumerate(results, 1)
        ],
    }


def _describe(result: Result, results: Sequence[Result]) -> Dict[str, Any]:
    quantiles = result.quantiles
    return {
        "name": str(result.defects),
        "defects": list(result.defects.names),
        "p_values": {
            name: {"p": round(p.value, 5), "below": round(p.high, 5)}
            for name, p in result.p_values.items()
        },
        "lengths_m": {
            length: dict(zip(_SHARES, rounded(column)))
            for length, column in zip(LENGTHS, quantiles.T)
        },
        "percentiles_of_figure_1b": dict(zip(LENGTHS, rounded(100.0 * result.percentiles, 1))),
        "same_as": [
            str(other.defects)
            for other in results
            if other is not result and result.does_the_same_as(other)
        ],
    }


def rounded(values: Sequence[float], digits: int = 5) -> List[float]:
    """Return rounded values for a table."""
    return [round(float(value), digits) for value in values]


def combination_rows(results: Sequence[Result]) -> List[List[Any]]:
    """Return combinations.csv: a header, and a row for each combination, ranked; m and %."""
    header = ["rank", *DEFECTS]
    for evidence in EVIDENCE:
        header += [f"p_{evidence}", f"p_{evidence}_below"]
    for length in LENGTHS:
        header += [f"{length}_{share}_m" for share in _SHARES] + [f"{length}_percentile"]
    rows: List[List[Any]] = [header]
    for rank, result in enumerate(results, start=1):
        row = [rank, *map(int, astuple(result.defects))]
        for p in result.p_values.values():
            row += rounded((p.value, p.high))
        for quantiles, percentile in zip(result.quantiles.T, result.percentiles):
            row += rounded(quantiles) + rounded([100.0 * percentile], 1)
        rows.append(row)
    return rows


def length_rows(results: Sequence[Result], first_seed: int) -> List[List[Any]]:
    """Return lengths.csv: a header, and a row for each combination and seed; m."""
    rows: List[List[Any]] = [["seed", *DEFECTS, *(f"{length}_m" for length in LENGTHS)]]
    for result in results:
        switches = list(map(int, astuple(result.defects)))
        for seed, lengths in enumerate(result.lengths, start=first_seed):
            rows.append([seed, *switches, *rounded(lengths, 6)])
    return rows


def verdict_lines(summary: Mapping[str, Any]) -> List[str]:
    """Return the main results of a summary as lines for the user."""
    figure, best = summary["figure_1b"], summary["combinations"][0]
    shown = {name: f"{1e3 * length:.1f}" for name, length in figure["lengths_m"].items()}
    lines = [
        f"figure 1b strays {', '.join([shown[name] for name in LENGTHS[:SIDES]])} mm on sides "
        f"1 to 4, {shown['start']} mm on the first half of side 1; its corners are within "
        f"{shown['corners']} mm of the perfect ones",
        f"its third side has {figure['third_side_steps']} steps: {figure['sampling_rate_hz']} Hz",
    ]
    if not summary["explained_by"]:
        return [*lines, "no combination explains figure 1b"]
    lines.append(f"most usual under: {best['name']}, p = {best['p_values']['all']['p']:.2g}")
    width = max(map(len, DEFECTS)) + 1
    if all(row["p_values"]["all"]["below"] >= SIGNIFICANCE for row in summary["combinations"]):
        lines.append("too few seeds to exclude any combination")
    heads = "".join(f"{evidence:16}" for evidence in EVIDENCE)
    lines.append(f"{'judged by':{width + 2}} {heads.rstrip()}")
    for name in DEFECTS:
        words = "".join(f"{summary['verdicts'][evidence][name]:16}" for evidence in EVIDENCE)
        lines.append(f"  {name + ':':{width}} {words.rstrip()}")
    return lines
