"""Lengths read from paths around a square, and what they say of each combination of defects.

Figure 1b and the replays are treated alike: the plot draws a path, its vertices are read, its
corners are found among them, and lengths are measured from the drawing only.

Each length read from figure 1b has a rank among those of the replays. Its two-sided p-value is
twice the share of replays, including the figure, that are at least as extreme on the figure's side.
For several lengths it is the smallest p-value times their number (Bonferroni). This assumes neither
their correlation nor their distributions.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Iterator, Mapping, Sequence

import numpy as np
from matplotlib import path as drawing
from numpy import ndarray

from bullet_lab.core.trajectory import finite_numbers
from bullet_lab.errors import LabError
from bullet_lab.noise.published_noise import DEFECTS, Defects
from bullet_lab.studies.paths import read_table
from bullet_lab.studies.study import Record, Summary, clopper_pearson, text_table

SIDES = 4

LENGTHS = (*(f"side{side}" for side in range(1, SIDES + 1)), "start", "corners")
"""Names of the lengths that `measure` returns, in this order."""

# Points of 1/72 inch per metre along x and y of figure 1b, by its axes. matplotlib leaves out
# vertices that are less than 1/9 of a point beside the line: 0.7 mm in x, 0.9 mm in y.
_POINTS_PER_METRE = (170.6, 122.9)
_STRAIGHT = 1.0 / 9.0

_MOST_CANDIDATES = 100
# m; shorter steps of the drawn path are at the corners.
_LEAST_STEP = 0.1
_COLUMNS = ("series", "x_m", "y_m")


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

NEEDED, RULED_OUT, UNKNOWN = "needed", "ruled out", "cannot be told"

# m; much smaller lengths count as equal.
_SMALL = 1e-3
# m; equal except for rounding.
_SAME = 1e-12


def drawn(points) -> ndarray:
    """Return the vertices that matplotlib draws of a path (m, (n, 2)) on the axes of figure 1b.

    They are without those that lie on a line with their neighbours, as in the vector graphic of the
    report; some are duplicates.

    >>> drawn([(0, 0), (0.5, 0.0002), (1, 0), (1, 0.5), (1, 1)]).round(3).tolist()
    [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 1.0]]
    """
    path = drawing.Path(np.asarray(points, dtype=float) * _POINTS_PER_METRE)
    path.simplify_threshold = _STRAIGHT
    # The last vertex only marks the end of the path.
    return path.cleaned(simplify=True).vertices[:-1] / _POINTS_PER_METRE


def find_corners(vertices) -> ndarray:
    """Find the corners of a drawn path around a square.

    The first and the last vertex and three others make four sides. The three are those with the
    smallest sum of distances of all vertices from the lines of their sides. (With a sum of squares,
    a zigzag on one side would move the corners of its neighbours.) Of a path of more than 100
    vertices, whose sides are not straight anyway, 100 are candidates.

    The vertices are x and y (m) in the order driven, (n, 2); the result has the indices of five of
    them, from the first to the last. Raises LabError if the path has no four sides.

    >>> find_corners([(0, 0), (1, 0.1), (2, 0), (2, -2), (1, -2), (0, -2), (0, 0)]).tolist()
    [0, 2, 3, 5, 6]
    """
    vertices = np.asarray(vertices, dtype=float)
    count = min(len(vertices), _MOST_CANDIDATES)
    candidates = np.linspace(0, len(vertices) - 1, count).astype(int)
    distances = _distances_beside_lines(vertices[candidates])
    least, choices = distances[0], []
    for _ in range(SIDES - 1):
        sums = least[:, np.newaxis] + distances
        choices.append(sums.argmin(axis=0))
        least = sums.min(axis=0)
    if not np.isfinite(least[-1]):
        raise LabError("the path has no four sides")
    corners = [len(distances) - 1]
    for choice in reversed(choices):
        corners.append(int(choice[corners[-1]]))
    return candidates[[0, *reversed(corners)]]


def _distances_beside_lines(vertices: ndarray) -> ndarray:
    """Return the sum of distances (m) of the vertices i to j from the line through i and j."""
    count = len(vertices)
    sums = np.full((count, count), np.inf)
    is_up_to_j = np.tri(count)
    for i, vertex in enumerate(vertices[:-1]):
        x, y = (vertices[i + 1 :] - vertex).T
        areas = np.abs(np.outer(x, y) - np.outer(y, x))
        lengths, is_line = np.hypot(x, y), (x != 0.0) | (y != 0.0)
        summed = (areas * is_up_to_j[: len(x), : len(x)]).sum(axis=1)
        sums[i, i + 1 :][is_line] = summed[is_line] / lengths[is_line]
    return sums


def measure(vertices, perfect_corners) -> ndarray:
    """Return the `LENGTHS` (m) of a noisy path, from its own corners; shape (6,).

    - `side1` to `side4`: the largest distance from the line of each side.
    - `start`: the same within the first half of the first side.
    - `corners`: the largest distance of the corners 1 to 3 from those of the perfect path in the
      same figure.

    The vertices are those of the noisy path (m), (n, 2). Raises LabError if it has no four sides.
    """
    vertices = np.asarray(vertices, dtype=float)
    indices = find_corners(vertices)
    corners = vertices[indices]
    across = []
    for first, last in zip(indices, indices[1:]):
        x, y = (vertices[first : last + 1] - vertices[first]).T
        across.append(np.abs(x * y[-1] - y * x[-1]) / math.hypot(x[-1], y[-1]))
    from_start = np.hypot(*(vertices[: indices[1] + 1] - vertices[0]).T)
    start = across[0][from_start < 0.5 * from_start[-1]].max()
    apart = np.hypot(*(corners - perfect_corners)[1:SIDES].T).max()
    return np.array([*(side.max() for side in across), start, apart])


@dataclass(frozen=True, eq=False)
class PublishedFigure:
    """Digitised figure 1b.

    Attributes:
        points: vertices of the noisy path (m), shape (n, 2).
        corners: of the noisy path, indices of its points, shape (5,).
        perfect_corners: of the perfect path (m), shape (5, 2).
        lengths: see `measure`.
    """

    points: ndarray
    corners: ndarray
    perfect_corners: ndarray
    lengths: ndarray

    @property
    def third_side_steps(self) -> int:
        """Number of steps of the third side."""
        third = self.points[self.corners[2] : self.corners[3] + 1]
        return int(np.count_nonzero(np.hypot(*np.diff(third, axis=0).T) > _LEAST_STEP))


def read_published_figure(path: Path) -> PublishedFigure:
    """Read figure 1b from a CSV file; raises LabError unless it holds two paths around a square."""
    noisy, perfect = (_read_series(path, f"fig1b_{name}") for name in ("noisy", "perfect"))
    corners = perfect[find_corners(perfect)]
    return PublishedFigure(noisy, find_corners(noisy), corners, measure(noisy, corners))


def _read_series(path: Path, name: str) -> ndarray:
    _, rows = read_table(path, _COLUMNS)
    points = [
        finite_numbers([row["x_m"], row["y_m"]], where)
        for where, row in rows
        if row["series"] == name
    ]
    if not points:
        raise LabError(f"{path} has no path {name}")
    return np.array(points)


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
    """Return the p-value of a measurement (m, (k,)) among runs, (m, k), m >= 2; see the module.

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
    lengths: ndarray
    p_values: Mapping[str, PValue]
    percentiles: ndarray

    @staticmethod
    def of(defects: Defects, lengths: ndarray, measured: ndarray) -> Result:
        """Return the result of noisy paths with these lengths (m), and those of figure 1b."""
        p_values = {
            name: p_value(measured[part], lengths[:, part]) for name, part in EVIDENCE.items()
        }
        return Result(defects, lengths, p_values, (lengths < measured).mean(axis=0))

    @property
    def quantiles(self) -> ndarray:
        """The `QUANTILES` of the lengths (m), a row for each, columns as `LENGTHS`."""
        return np.quantile(self.lengths, QUANTILES, axis=0)

    def does_the_same_as(self, other: Result) -> bool:
        """Return whether each path has the same lengths in both results."""
        return bool(np.abs(self.lengths - other.lengths).max() <= _SAME)


def nearest(measured: ndarray, lengths: ndarray) -> int:
    """Return the index of the path that is most like the figure, by the ratios of all lengths."""
    ratios = np.log((lengths + _SMALL) / (measured + _SMALL))
    return int(np.abs(ratios).sum(axis=1).argmin())


def ranked(results: Sequence[Result]) -> list[Result]:
    """Return the results, those with the largest p-value first."""

    def key(result: Result) -> tuple[float, float]:
        return result.p_values["all"].value, sum(p.value for p in result.p_values.values())

    # Of equal ones the first stays first.
    return sorted(results, key=key, reverse=True)


def groups_of_same(results: Sequence[Result]) -> list[list[Result]]:
    """Return groups of equal results, in the given order."""
    groups: list[list[Result]] = []
    for result in results:
        same = next((group for group in groups if group[0].does_the_same_as(result)), None)
        if same is None:
            groups.append([result])
        else:
            same.append(result)
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
    about: Summary,
    figure: Summary,
    results: Sequence[Result],
    records: Sequence[Record],
) -> Summary:
    """Return the content of summary.json, with values of the published figure."""
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
        "combinations": records,
    }


def combination_records(results: Sequence[Result]) -> list[Record]:
    """Return a record for each combination, as in combinations.csv; m and %."""
    records: list[Record] = []
    for rank, result in enumerate(results, 1):
        switches = map(int, astuple(result.defects))
        record = {"rank": rank, **dict(zip(DEFECTS, switches))}
        for evidence, p in result.p_values.items():
            record[f"p_{evidence}"], record[f"p_{evidence}_below"] = rounded((p.value, p.high))
        percentiles = rounded(100.0 * result.percentiles, 1)
        for length, quantiles, percentile in zip(LENGTHS, result.quantiles.T, percentiles):
            names = (f"{length}_q{100.0 * share:02.0f}_m" for share in QUANTILES)
            record.update(zip(names, rounded(quantiles)))
            record[f"{length}_percentile"] = percentile
        records.append(record)
    return records


def rounded(values: Sequence[float], digits: int = 5) -> list[float]:
    """Return rounded values for a table."""
    return [round(float(value), digits) for value in values]


def length_records(results: Sequence[Result], first_seed: int) -> Iterator[Record]:
    """Yield the records of lengths.csv: of each combination and seed; m."""
    names = ("seed", *DEFECTS, *(f"{length}_m" for length in LENGTHS))
    for result in results:
        switches = list(map(int, astuple(result.defects)))
        for seed, lengths in enumerate(result.lengths, start=first_seed):
            yield dict(zip(names, (seed, *switches, *rounded(lengths, 6))))


def verdict_lines(summary: Summary) -> list[str]:
    """Return the main results of a summary as lines for the user."""
    figure, rows = summary["figure_1b"], summary["combinations"]
    shown = {name: f"{1e3 * length:.1f}" for name, length in figure["lengths_m"].items()}
    lines = [
        f"figure 1b strays {', '.join([shown[name] for name in LENGTHS[:SIDES]])} mm on sides "
        f"1 to 4, {shown['start']} mm on the first half of side 1; its corners are within "
        f"{shown['corners']} mm of the perfect ones",
        f"its third side has {figure['third_side_steps']} steps: {figure['sampling_rate_hz']} Hz",
    ]
    if not summary["explained_by"]:
        return [*lines, "no combination explains figure 1b"]
    lines.append(f"most usual under: {summary['explained_by'][0]}, p = {rows[0]['p_all']:.2g}")
    if all(row["p_all_below"] >= SIGNIFICANCE for row in rows):
        lines.append("too few seeds to exclude any combination")
    verdicts = summary["verdicts"]
    table = [(f"  {name}:", *(verdicts[one][name] for one in EVIDENCE)) for name in DEFECTS]
    return [*lines, *text_table([("judged by", *EVIDENCE), *table])]
