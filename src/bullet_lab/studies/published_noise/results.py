"""How usual figure 1b would be under each combination of defects, and the verdict on each defect.

Each length read from figure 1b has a rank among those of the replays, and from that a two-sided
p-value: twice the share of replays, the figure among them, that are at least as far out on the
figure's side. Of several lengths the smallest counts, times their number (Bonferroni), so that
nothing is assumed of how they hang together. No shape of any distribution is assumed either.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Any, Dict, List, Mapping, Sequence, Tuple

import numpy as np
from scipy.stats import beta

from bullet_lab.errors import LabError
from bullet_lab.studies.published_noise.defects import DEFECTS, Defects
from bullet_lab.studies.published_noise.drawn_paths import LENGTHS, SIDES

SIGNIFICANCE = 0.05
"""A combination with a smaller p-value does not explain the figure."""

CONFIDENCE = 0.95
"""That the p-value of infinitely many replays is below `PValue.high`."""

EVIDENCE = {
    "sides": slice(0, SIDES),
    "start": slice(SIDES, SIDES + 1),
    "corners": slice(SIDES + 1, SIDES + 2),
    "all": slice(0, SIDES + 2),
}
"""Which of the lengths are looked at: some alone, and all together."""

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_SHARES = ("q05", "q25", "q50", "q75", "q95")

NEEDED, RULED_OUT, UNKNOWN = "needed", "ruled out", "cannot be told"

_NOTHING = 1e-3  # m; lengths well below are alike
_SAME = 1e-12  # m


class LengthsError(LabError):
    """The lengths cannot be compared."""


@dataclass(frozen=True)
class PValue:
    """A p-value from replays.

    Attributes:
        value: with the figure counted among the replays, 0 to 1. For a figure that is a replay
            itself, it is below any share with at most that probability.
        high: that of infinitely many replays is below it with `CONFIDENCE`: Clopper and
            Pearson's bounds, all tails of all lengths at once.
    """

    value: float
    high: float

    @property
    def explains(self) -> bool:
        """Whether the figure would not be too unusual."""
        return self.value >= SIGNIFICANCE

    @property
    def excludes(self) -> bool:
        """Whether it would be, and there are replays enough to say so."""
        return self.high < SIGNIFICANCE


def p_value(measured, runs) -> PValue:
    """Say how usual a measurement would be among runs; see this module.

    Args:
        measured: k lengths (m), shape (k,).
        runs: the same of m runs, shape (m, k), m at least 2.

    Raises:
        LengthsError: the shapes do not go together or a length is not finite and >= 0.

    >>> p_value([0.2], [[0.1 * k] for k in range(1, 100)]).value
    0.06
    """
    measured, runs = _checked(measured, runs)
    count, tails = len(runs), 2 * len(measured)
    further_out = min((runs <= measured).sum(axis=0).min(), (runs >= measured).sum(axis=0).min())
    bound = beta.isf((1.0 - CONFIDENCE) / tails, further_out + 1, count - further_out)
    return PValue(
        min(1.0, tails * float(further_out + 1) / (count + 1)), min(1.0, tails * float(bound))
    )


def _checked(measured, runs) -> tuple[np.ndarray, np.ndarray]:
    measured, runs = np.asarray(measured, dtype=float), np.asarray(runs, dtype=float)
    if runs.ndim != 2 or measured.shape != runs.shape[1:] or len(runs) < 2:
        raise LengthsError(f"lengths of shape {measured.shape} and {runs.shape}")
    for lengths in (measured, runs):
        if not (np.isfinite(lengths).all() and (lengths >= 0.0).all()):
            raise LengthsError("a length is not finite and >= 0")
    return measured, runs


@dataclass(frozen=True, eq=False)
class Result:
    """What came of one combination of defects.

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
        """Judge the lengths measured in figure 1b by those of noisy paths (m)."""
        p_values = {
            name: p_value(measured[part], lengths[:, part]) for name, part in EVIDENCE.items()
        }
        return Result(defects, lengths, p_values, (lengths < measured).mean(axis=0))

    @property
    def quantiles(self) -> np.ndarray:
        """The `QUANTILES` of the lengths (m), a row for each, columns as `LENGTHS`."""
        return np.quantile(self.lengths, QUANTILES, axis=0)

    def does_the_same_as(self, other: Result) -> bool:
        """Return whether each path is the same with these defects as with the others."""
        return bool(np.abs(self.lengths - other.lengths).max() <= _SAME)


def nearest(measured: np.ndarray, lengths: np.ndarray) -> int:
    """Return which of some paths is most like the figure, by the sizes of all lengths."""
    ratios = np.log((lengths + _NOTHING) / (measured + _NOTHING))
    return int(np.abs(ratios).sum(axis=1).argmin())


def ranked(results: Sequence[Result]) -> List[Result]:
    """Return the results, those under which figure 1b would be most usual first."""

    def unusual(result: Result) -> Tuple[float, float]:
        values = [p.value for p in result.p_values.values()]
        return -result.p_values["all"].value, -sum(values)

    return sorted(results, key=unusual)


def groups_of_same(results: Sequence[Result]) -> List[List[Result]]:
    """Put results together that are the same, in the order given."""
    groups: List[List[Result]] = []
    for result in results:
        home = next((group for group in groups if group[0].does_the_same_as(result)), None)
        if home is None:
            groups.append([result])
        else:
            home.append(result)
    return groups


def verdict(name: str, results: Sequence[Result], evidence: str) -> str:
    """Say what the figure tells of one defect: `NEEDED`, `RULED_OUT` or `UNKNOWN`.

    It is needed if all combinations without it are excluded, while one with it explains the
    figure, and ruled out if it is the other way round.
    """
    with_it, without = (
        [r.p_values[evidence] for r in results if getattr(r.defects, name) == is_in]
        for is_in in (True, False)
    )
    for yes, no, word in ((with_it, without, NEEDED), (without, with_it, RULED_OUT)):
        if any(p.explains for p in yes) and all(p.excludes for p in no):
            return word
    return UNKNOWN


def published_summary(
    about: Mapping[str, Any], figure: Mapping[str, Any], results: Sequence[Result]
) -> Dict[str, Any]:
    """Return what summary.json says.

    Args:
        about: the settings.
        figure: what is to be said of the published figure.
        results: of all combinations, ranked.
    """
    verdicts = {
        evidence: {name: verdict(name, results, evidence) for name in DEFECTS}
        for evidence in EVIDENCE
    }
    told = verdicts["all"]
    return {
        "job": "published_noise",
        **about,
        "figure_1b": dict(figure),
        "explained_by": [str(r.defects) for r in results if r.p_values["all"].explains],
        "needed": [name for name in DEFECTS if told[name] == NEEDED],
        "cannot_be_told": [name for name in DEFECTS if told[name] == UNKNOWN],
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
    """Return values for a table."""
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
    """Return what a summary comes down to, for the terminal."""
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
