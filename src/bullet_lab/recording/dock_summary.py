"""What a campaign of dockings comes down to: campaign.csv and summary.json."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence

import numpy as np

from bullet_lab.numerics.binomial import lower_bound
from bullet_lab.recording.files import replace_file

Record = Mapping[str, Any]

DOCKED = "docked"
ERRORS = ("distance_error_m", "lateral_error_m", "yaw_error_deg")
CONFIDENCE = 0.95


def campaign_summary(records: Sequence[Record]) -> Dict[str, Any]:
    """Return the figures of a campaign for summary.json.

    Rates, errors and contacts; the errors are magnitudes, of the dockings that succeeded.

    Args:
        records: of at least one docking each, in the order of their indices.
    """
    docked = [record for record in records if record["result"] == DOCKED]
    failures = Counter(r["result"] for r in records if r["result"] != DOCKED)
    known = [record for record in records if record["sim_time_s"] is not None]
    return {
        "dockings": len(records),
        "docked": len(docked),
        "success_rate": len(docked) / len(records),
        "success_rate_lower_95": lower_bound(len(docked), len(records), CONFIDENCE),
        "failures": dict(sorted(failures.items())),
        "failed_indices": [r["index"] for r in records if r["result"] != DOCKED],
        **{name: error_figures([record[name] for record in docked]) for name in ERRORS},
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


def error_figures(values: Sequence[float]) -> Dict[str, Any]:
    """Return median, 95 % quantile and maximum of the magnitudes; null without any."""
    if not values:
        return {"median": None, "p95": None, "max": None}
    sizes = np.abs(values)
    return {
        "median": float(np.median(sizes)),
        "p95": float(np.quantile(sizes, 0.95)),
        "max": float(sizes.max()),
    }


def _shares(records: Sequence[Record], name: str) -> Dict[str, Any]:
    """Return how many docked of how many, for each value that a column has."""
    total = Counter(record[name] for record in records)
    docked = Counter(record[name] for record in records if record["result"] == DOCKED)
    return {value: f"{docked[value]} of {total[value]}" for value in sorted(total)}


def write_campaign_csv(path: Path, records: Sequence[Record]) -> None:
    """Write a row for each docking, every number with all its digits; raises FileError."""

    def write(part: Path) -> None:
        with part.open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(records[0])
            writer.writerows(_cells(record) for record in records)

    replace_file(path, write)


def _cells(record: Record) -> List[Any]:
    return ["" if value is None else value for value in record.values()]
