"""Results of a campaign: its log, from which a stopped campaign continues, totals and figure."""

from __future__ import annotations

import contextlib
import json
import math
from collections import Counter
from pathlib import Path
from typing import Any, Iterable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy import ndarray

from bullet_lab.core.figures import (
    BLACK,
    BLUE,
    ORANGE,
    THIN,
    VERMILION,
    draw_plan,
    gridded,
    new_figure,
    plan_axes,
)
from bullet_lab.core.files import file_errors, replace_file
from bullet_lab.docking.database import DOCKED, ERRORS, INACCURATE, WALL_CONTACT
from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import Footprint
from bullet_lab.studies.dock_campaign.trial import CRASHED, MARKER_POSE, TOLERANCES
from bullet_lab.studies.study import Record, Summary, clopper_pearson

LOG = "dockings.jsonl"

QUANTITIES = {
    "sim_time_s": ("time", "s", 1.0),
    "distance_error_m": ("distance error", "mm", 1000.0),
    "lateral_error_m": ("lateral error", "mm", 1000.0),
    "yaw_error_deg": ("yaw error", "°", 1.0),
}
"""Name, unit and factor, for the user, of columns of the table."""


def campaign_summary(records: Sequence[Record]) -> Summary:
    """Return the figures of at least one docking for summary.json: rates, errors and contacts.

    The errors are magnitudes, of all robots that report that they have docked, within the dock's
    tolerances or not.
    """
    failed = [record for record in records if record["result"] != DOCKED]
    docked = len(records) - len(failed)
    known = [record for record in records if record["sim_time_s"] is not None]
    return {
        "dockings": len(records),
        "docked": docked,
        "success_rate": docked / len(records),
        "success_rate_lower_95": clopper_pearson(docked, len(records), 1.0 - 0.95)[0],
        "failures": dict(sorted(Counter(record["result"] for record in failed).items())),
        "failed_indices": [record["index"] for record in failed],
        **{name: error_figures([r[name] for r in reported_docked(records)]) for name in ERRORS},
        "tolerances": {
            record["world"]: {name: record[column] for name, column in TOLERANCES.items()}
            for record in sorted(records, key=lambda r: r["world"])
        },
        "wall_contacts": sum(record["wall_contacts"] for record in known),
        "dockings_with_contact": sum(record["wall_contacts"] > 0 for record in known),
        "retries": sum(record["retries"] for record in known),
        "sim_time_s": sum(record["sim_time_s"] for record in known),
        "longest_sim_time_s": max((record["sim_time_s"] for record in known), default=None),
        "by_world": _shares(records, "world"),
        "by_light": _shares(records, "light"),
        "by_odometry": _shares(records, "odometry"),
        "renderers": dict(sorted(Counter(record["renderer"] for record in known).items())),
    }


def error_figures(values: Sequence[float]) -> dict[str, float | None]:
    """Return median, 95 and 99 % quantiles and maximum of magnitudes; None if there are none."""
    names, sizes = ("median", "p95", "p99", "max"), np.abs(values)
    if not values:
        return dict.fromkeys(names)
    figures = (np.median(sizes), *np.quantile(sizes, (0.95, 0.99)), sizes.max())
    return dict(zip(names, map(float, figures)))


def stress_row(name: str, summary: Summary) -> Summary:
    """Return the row of a stress from the summary of its campaign."""
    counts = Counter(summary["failures"])
    wrong = counts[WALL_CONTACT] + counts[INACCURATE] + counts[CRASHED]
    figures = {
        f"{error}_{part}": summary[error][part] for error in ERRORS for part in ("median", "max")
    }
    return {
        "stress": name,
        "dockings": summary["dockings"],
        "docked": summary["docked"],
        "refused": summary["dockings"] - summary["docked"] - wrong,
        "inaccurate": counts[INACCURATE],
        "with_contact": summary["dockings_with_contact"],
        "crashed": counts[CRASHED],
        "failures": " ".join(f"{kind}:{count}" for kind, count in summary["failures"].items()),
        **figures,
    }


def reported_docked(records: Sequence[Record]) -> list[Record]:
    """Return the dockings after which the robot reports that it has docked."""
    return [record for record in records if record["result"] in (DOCKED, INACCURATE)]


def _shares(records: Sequence[Record], name: str) -> Summary:
    """Return "docked of all" for each value of a column."""
    total = Counter(record[name] for record in records)
    docked = Counter(record[name] for record in records if record["result"] == DOCKED)
    return {value: f"{docked[value]} of {total[value]}" for value in sorted(total)}


def read_log(path: Path) -> tuple[dict[str, Any], dict[int, Record]]:
    """Return the parameters of a campaign, and its records by index, from its log.

    Raises:
        FileError: it cannot be read.
        LabError: it is not the log of a campaign.
    """
    try:
        with file_errors(f"cannot read {path}"):
            text = path.read_text()
        # If the machine or the disk has failed, the last line may be incomplete.
        head, *lines = map(json.loads, text[: text.rfind("\n") + 1].splitlines())
        return dict(head["campaign"]), {line["index"]: line for line in lines}
    except (ValueError, KeyError, TypeError):
        raise LabError(f"{path} is not the log of a campaign") from None


class DockLog:
    """Lines of JSON: the campaign's parameters, then one line per docking, in order of completion.

    Each line is written at once. A docking whose line is incomplete runs again.

    Args:
        path: of the file, which is created if necessary.
        parameters: those that determine the outcome of each docking.

    Attributes:
        records: of the dockings, by index.

    Raises:
        LabError: the file is the log of a campaign with other parameters, or is not a log.
        FileError: it cannot be read or written.
    """

    def __init__(self, path: Path, parameters: Mapping[str, Any]):
        self._path = path
        # As they are read again.
        self._parameters = json.loads(_line(parameters))
        self.records: dict[int, Record] = {}
        with file_errors(f"cannot write {path}"):
            if path.exists() and "\n" in path.read_text(errors="replace"):
                found, self.records = read_log(path)
                self._check(found)
            self.sort()
            self._file = path.open("a", buffering=1)

    def _check(self, found: Mapping[str, Any]) -> None:
        given = self._parameters
        differences = [
            f"{name} {_shown(found.get(name))}, not {_shown(given.get(name))}"
            for name in {**given, **found}
            if found.get(name) != given.get(name)
        ]
        if differences:
            raise LabError(
                f"{self._path} is the log of a campaign with other parameters "
                f"({', '.join(differences)}): choose another folder, or remove it"
            )

    def append(self, record: Record) -> None:
        """Add the record of a docking, with its "index"; raises FileError."""
        with file_errors(f"cannot write {self._path}"):
            self._file.write(_line(record))
        self.records[record["index"]] = record

    def sort(self) -> None:
        """Sort the lines by index; nothing is appended after that. Raises FileError."""
        lines = [{"campaign": self._parameters}, *(r for _, r in sorted(self.records.items()))]
        text = "".join(map(_line, lines))
        replace_file(self._path, lambda part: part.write_text(text))

    def close(self) -> None:
        """Close the file."""
        # A line for which there was no room has been reported.
        with contextlib.suppress(OSError):
            self._file.close()


def _line(values: Mapping[str, Any]) -> str:
    return json.dumps(values, allow_nan=False) + "\n"


def _shown(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


TICK = 0.18
LIMIT = {"color": ORANGE, "linestyle": "--", "linewidth": 1.0}
BINS = 24


def campaign_figure(
    records: Sequence[Record], obstacles: Iterable[Footprint], title: str
) -> Figure:
    """Draw starts and ends over the dock's plan, the ends enlarged, and the errors.

    Docked robots are blue; failed ones are vermilion, and their ends are crosses. The docks' own
    tolerances are dashed.
    """
    figure = new_figure(11.0, 8.8, title)
    left, right = figure.add_gridspec(
        1, 2, width_ratios=(0.75, 1.0), wspace=0.2, left=0.07, right=0.98, top=0.93, bottom=0.07
    )
    plan = figure.add_subplot(left)
    # Each outline once, as the worlds share obstacles.
    draw_plan(plan, {box.corners(): None for box in obstacles}, MARKER_POSE)
    docked = [record for record in records if record["result"] == DOCKED]
    failed = [record for record in records if record["result"] != DOCKED]
    _draw_robots(plan, docked, "docked", (BLUE, 3.0), (ORANGE, 5.0, "s"))
    _draw_robots(plan, failed, "failed", (VERMILION, 5.0), (VERMILION, 7.0, "X"))
    plan.legend(loc="lower right", fontsize="small")
    rows = right.subgridspec(4, 1, height_ratios=(2.1, 1.0, 1.0, 1.0), hspace=0.5)
    at_dock = reported_docked(records)
    _draw_ends(figure.add_subplot(rows[0]), at_dock)
    for row, column in zip(list(rows)[1:], ERRORS):
        name, unit, factor = QUANTITIES[column]
        axes = figure.add_subplot(row)
        _draw_histogram(axes, [factor * record[column] for record in at_dock], f"{name} ({unit})")
        for most in sorted({factor * record[TOLERANCES[column]] for record in records}):
            axes.axvline(-most, **LIMIT)
            axes.axvline(most, **LIMIT)
    return figure


def _draw_robots(
    axes: Axes,
    records: Sequence[Record],
    name: str,
    start_style: tuple[str, float],
    end_style: tuple[str, float, str],
) -> None:
    """Draw the starts and ends of dockings; styles are colour, size and marker."""
    if not records:
        return
    starts = _poses(records, "start")
    ends = _poses([r for r in records if r["end_x_m"] is not None], "end")
    colour, size = start_style
    axes.plot(*_ticks(starts), color=colour, linewidth=0.8)
    label = f"start, {name} ({len(records)})"
    axes.plot(*starts[:, :2].T, "o", label=label, color=colour, markersize=size)
    colour, size, marker = end_style
    style = {"color": colour, "markersize": size, "markeredgecolor": BLACK, "markeredgewidth": 0.5}
    axes.plot(*ends[:, :2].T, marker, label=f"end, {name}", **style)


def _poses(records: Sequence[Record], which: str) -> ndarray:
    """Return x, y (m) and yaw (rad) of starts or ends, shape (n, 3)."""
    columns = [f"{which}_x_m", f"{which}_y_m", f"{which}_yaw_deg"]
    poses = np.array([[record[name] for name in columns] for record in records]).reshape(-1, 3)
    return poses * [1.0, 1.0, math.radians(1.0)]


def _ticks(poses: ndarray) -> tuple[ndarray, ndarray]:
    """Return x and y of a broken line with a short piece in the heading of each pose."""
    x, y, yaw = poses.T
    gap = np.full_like(x, np.nan)
    ahead = np.stack([x, x + TICK * np.cos(yaw), gap], axis=1).ravel()
    return ahead, np.stack([y, y + TICK * np.sin(yaw), gap], axis=1).ravel()


def _draw_ends(axes: Axes, records: Sequence[Record]) -> None:
    plan_axes(axes, xlabel="distance error (mm)", ylabel="lateral error (mm)")
    axes.set_title("where robots stand that say they have docked", fontsize="medium")
    axes.axhline(0.0, **THIN)
    axes.axvline(0.0, **THIN)
    names = ("distance_error_m", "lateral_error_m")
    for result, colour, mark in ((DOCKED, BLUE, "."), (INACCURATE, VERMILION, "X")):
        errors = [[1000.0 * r[name] for name in names] for r in records if r["result"] == result]
        if errors:
            axes.plot(*zip(*errors), mark, color=colour, markersize=5.0)
    for x, y in sorted({tuple(1000.0 * r[TOLERANCES[n]] for n in names) for r in records}):
        axes.plot((-x, x, x, -x, -x), (-y, -y, y, y, -y), **LIMIT)


def _draw_histogram(axes: Axes, values: Sequence[float], label: str) -> None:
    gridded(axes, xlabel=label, ylabel="dockings")
    if not values:
        return
    axes.hist(values, bins=BINS, color=BLUE, edgecolor="white", linewidth=0.4)
    median = float(np.median(np.abs(values)))
    # Half of the dockings are between these two lines.
    axes.axvline(-median, color=BLACK, linestyle="-")
    axes.axvline(median, color=BLACK, linestyle="-", label=f"median of the sizes {median:.2f}")
    largest = values[int(np.argmax(np.abs(values)))]
    axes.axvline(largest, color=BLACK, linestyle=":", label=f"largest {abs(largest):.2f}")
    axes.legend(fontsize="small")
