"""A comparison of two controllers by their campaigns of the same dockings."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from bullet_lab.core.figures import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    THIN,
    VERMILION,
    gridded,
    panels,
)
from bullet_lab.docking.database import DOCKED, ERRORS
from bullet_lab.errors import LabError
from bullet_lab.studies.dock_campaign.results import LOG, QUANTITIES, read_log, reported_docked
from bullet_lab.studies.dock_campaign.trial import TOLERANCES
from bullet_lab.studies.study import Record, Summary, clopper_pearson, text_table, write_results

CONFIDENCE = 0.95
ENDS = ("value", "low", "high")
"""Names of a figure and of the ends of its interval."""

NAV2_THRESHOLD = 0.05
"""nav2's `docking_threshold`, m: within it a robot counts as docked, with any heading."""


def compare(folder: Path, beside: Path, dockings: int) -> list[str]:
    """Compare the dockings of a folder's campaign with those in the log of another one.

    Write table, figure and numbers into the folder; return lines for the user.

    Raises:
        LabError: the other campaign has other dockings, or lacks some of them.
    """
    drawn_from, first_records = read_log(beside)
    own_drawn_from, second_records = read_log(folder / LOG)
    first, second = (one.pop("controller") for one in (drawn_from, own_drawn_from))
    if drawn_from != own_drawn_from:
        raise LabError(f"{beside} has other dockings than {folder}")
    indices = range(dockings)
    missing = [index for index in indices if index not in first_records]
    if missing:
        raise LabError(f"{beside} lacks {len(missing)} of {dockings} dockings")
    names = [first, second]
    if first == second:
        names = [f"{first} ({beside.parent.name})", f"{second} ({folder.name})"]
    pairs = [[records[index] for index in indices] for records in (first_records, second_records)]
    columns = [figures_of(records) for records in pairs]
    paired = paired_figures(*pairs)
    numbers = {
        "dockings": dockings,
        **drawn_from,
        "controllers": dict(zip(names, columns)),
        "paired": paired,
    }
    tables = {"comparison.csv": comparison_records(names, columns)}
    figures = {"comparison.png": comparison_figure(names, pairs, columns)}
    write_results(folder, numbers, tables, figures, {}, "comparison.json")
    return describe(names, columns, paired)


def share(hits: int, trials: int) -> Summary:
    """Return a share in per cent with Clopper and Pearson's interval.

    >>> {end: round(value, 2) for end, value in share(199, 200).items()}
    {'value': 99.5, 'low': 97.25, 'high': 99.99}
    """
    low, high = clopper_pearson(hits, trials, 0.5 * (1.0 - CONFIDENCE))
    return {"value": 100.0 * hits / trials, "low": 100.0 * low, "high": 100.0 * high}


def quantile(values: Sequence[float], part: float) -> Summary:
    """Return a quantile with an interval from two order statistics, for any distribution.

    An end for which there are too few values is None; without values, all are None.
    (H. A. David and H. N. Nagaraja, Order Statistics, 2003, section 7.1.)

    >>> quantile(range(1, 101), 0.5)
    {'value': 50.5, 'low': 40.0, 'high': 61.0}
    """
    if not len(values):
        return dict.fromkeys(ENDS)
    ordered, count = np.sort(np.asarray(values, dtype=float)), len(values)
    outside = 0.5 * (1.0 - CONFIDENCE)
    low = int(stats.binom.ppf(outside, count, part))
    high = int(stats.binom.ppf(1.0 - outside, count, part)) + 1
    return {
        "value": float(np.quantile(ordered, part)),
        "low": float(ordered[low - 1]) if low >= 1 else None,
        "high": float(ordered[high - 1]) if high <= count else None,
    }


def figures_of(records: Sequence[Record]) -> Summary:
    """Return the figures of one controller by name, each with its interval."""
    at_dock = reported_docked(records)
    off = [math.hypot(r["distance_error_m"], r["lateral_error_m"]) for r in at_dock]
    hits = {
        "docked within the dock's tolerance (%)": [r["result"] == DOCKED for r in records],
        "docked within nav2's 50 mm (%)": [away <= NAV2_THRESHOLD for away in off],
        "said to be docked (%)": [True for _ in at_dock],
        "with a contact (%)": [bool(r["wall_contacts"]) for r in records],
        "with a retry (%)": [bool(r["retries"]) for r in records],
    }
    figures = {name: share(sum(of), len(records)) for name, of in hits.items()}
    for column, (name, unit, factor) in QUANTITIES.items():
        values = [factor * abs(record[column]) for record in at_dock]
        for label, part in (("median", 0.5), ("99 %", 0.99)):
            figures[f"{name}, {label} ({unit})"] = quantile(values, part)
    figures["failures"] = dict(sorted(Counter(r["result"] for r in records).items()))
    return figures


def paired_figures(first: Sequence[Record], second: Sequence[Record]) -> Summary:
    """Return who docked in the same scenarios, and the differences where both did.

    The p-value is that of McNemar's exact test; differences are the second minus the first.
    """
    docked = Counter((a["result"] == DOCKED, b["result"] == DOCKED) for a, b in zip(first, second))
    alone = docked[True, False], docked[False, True]
    p_value = stats.binomtest(alone[0], sum(alone)).pvalue if sum(alone) else 1.0
    both = [pair for pair in zip(first, second) if len(reported_docked(pair)) == 2]
    return {
        "both_docked": docked[True, True],
        "only_first_docked": alone[0],
        "only_second_docked": alone[1],
        "neither_docked": docked[False, False],
        "mcnemar_p": float(p_value),
        **{
            f"{name}, median difference ({unit})": quantile(
                [factor * (abs(b[column]) - abs(a[column])) for a, b in both], 0.5
            )
            for column, (name, unit, factor) in QUANTITIES.items()
        },
    }


def comparison_records(names: Sequence[str], columns: Sequence[Summary]) -> list[Record]:
    """Return a record for each figure: value, low and high of each controller."""
    heads = [f"{name} {end}" for name in names for end in ENDS]
    return [
        {
            "figure": figure,
            **dict(zip(heads, (column[figure][end] for column in columns for end in ENDS))),
        }
        for figure in columns[0]
        if figure != "failures"
    ]


def _shown(figure: Summary) -> str:
    value, low, high = ("?" if figure[end] is None else f"{figure[end]:.3g}" for end in ENDS)
    return f"{value} [{low}, {high}]"


def describe(names: Sequence[str], columns: Sequence[Summary], paired: Summary) -> list[str]:
    """Return the comparison as lines for the user, with intervals of 95 %."""
    figures = [figure for figure in columns[0] if figure != "failures"]
    rows = [(figure, *(_shown(column[figure]) for column in columns)) for figure in figures]
    lines = text_table([("", *names), *rows])
    lines += [
        f"{name}: " + ", ".join(f"{result} {count}" for result, count in column["failures"].items())
        for name, column in zip(names, columns)
    ]
    lines.append(
        f"both docked {paired['both_docked']}, only {names[0]} {paired['only_first_docked']}, "
        f"only {names[1]} {paired['only_second_docked']}, neither {paired['neither_docked']} "
        f"(McNemar's p = {paired['mcnemar_p']:.2g})"
    )
    differences = (f"{n} {_shown(figure)}" for n, figure in paired.items() if "difference" in n)
    lines.append(f"{names[1]} minus {names[0]}, where both docked: " + "; ".join(differences))
    return lines


COLOURS = (BLUE, ORANGE)


def comparison_figure(
    names: Sequence[str], pairs: Sequence[Sequence[Record]], columns: Sequence[Summary]
) -> Figure:
    """Draw shares with their intervals, times pair by pair, and the distributions of the errors."""
    title = f"{len(pairs[0])} dockings, the same for both (95 %; dashed: tolerances)"
    figure, (above, below) = panels((2, 3), (11.0, 7.0), title, grid=False)
    figure.subplots_adjust(0.07, 0.08, 0.98, 0.92, wspace=0.28, hspace=0.38)
    _draw_shares(above[0], names, columns)
    _draw_results(above[1], columns)
    _draw_times(above[2], names, pairs)
    for axes, column in zip(below, ERRORS):
        name, unit, factor = QUANTITIES[column]
        gridded(axes, xlabel=f"{name} ({unit})", xscale="log", ylim=(0, 1))
        axes.set_ylabel("share of those said to be docked")
        for most in sorted({factor * record[TOLERANCES[column]] for record in pairs[0]}):
            axes.axvline(most, color=GREY, linestyle="--")
        for label, records, colour in zip(names, pairs, COLOURS):
            values = np.sort([factor * abs(r[column]) for r in reported_docked(records)])
            # Smaller values are drawn at the end of the scale.
            steps = np.arange(1, len(values) + 1) / max(len(values), 1)
            axes.step(np.maximum(values, 1e-3), steps, where="post", color=colour, label=label)
        axes.legend(fontsize="small", loc="upper left")
    return figure


def _draw_shares(axes: Axes, names: Sequence[str], columns: Sequence[Summary]) -> None:
    shares = [figure for figure in columns[0] if figure.endswith("(%)")]
    rows = np.arange(len(shares))[::-1]
    for number, (name, column, colour) in enumerate(zip(names, columns, COLOURS)):
        values, low, high = (np.array([column[figure][end] for figure in shares]) for end in ENDS)
        axes.barh(
            rows + 0.15 - 0.3 * number, values, 0.28, color=colour, label=name,
            xerr=(values - low, high - values), error_kw={"ecolor": BLACK, "capsize": 2},
        )  # fmt: skip
    # The names are above the bars, as these begin at the left edge.
    for row, figure in zip(rows, shares):
        axes.text(1.0, row + 0.42, figure[:-4], fontsize="small", va="center")
    axes.set(xlim=(0, 100), ylim=(-0.5, len(shares) - 0.3), xlabel="% of all", yticks=[])
    axes.legend(fontsize="small", loc="lower right")


def _draw_results(axes: Axes, columns: Sequence[Summary]) -> None:
    axes.set(yticks=[], xlabel="dockings that failed")
    results = sorted({r for column in columns for r in column["failures"]} - {DOCKED})
    rows = np.arange(len(results))[::-1]
    for number, (column, colour) in enumerate(zip(columns, COLOURS)):
        counts = [column["failures"].get(result, 0) for result in results]
        axes.barh(rows + 0.15 - 0.3 * number, counts, 0.28, color=colour)
    for row, result in zip(rows, results):
        axes.text(0.0, row + 0.42, f" {result.replace('_', ' ')}", fontsize="small", va="center")
    axes.set_ylim(-0.5, max(len(results) - 0.3, 0.7))
    axes.grid(alpha=0.3, axis="x")


def _draw_times(axes: Axes, names: Sequence[str], pairs: Sequence[Sequence[Record]]) -> None:
    labels = {"xlabel": f"s, {names[0]}", "ylabel": f"s, {names[1]}"}
    gridded(axes, **labels, title="time until docked")
    both = [pair for pair in zip(*pairs) if len(reported_docked(pair)) == 2]
    times = np.array([(a["sim_time_s"], b["sim_time_s"]) for a, b in both]).reshape(-1, 2)
    if len(times):
        most = float(times.max())
        axes.plot([0.0, most], [0.0, most], **THIN)
        axes.plot(*times.T, ".", color=VERMILION, markersize=5.0)
