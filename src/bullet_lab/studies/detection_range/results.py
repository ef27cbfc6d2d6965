"""The results of a detection range: a table of cells, and what they come down to."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

from bullet_lab.core.files import replace_file

Row = Mapping[str, Any]

LEAST_RATE = 0.95
"""A marker that is found in fewer of the pictures is not counted as found."""

TARGETS = ((0.0, 4.0, 1.0), (15.0, 4.0, 1.0), (30.0, 4.0, 1.0), (45.0, 3.0, 1.0), (60.0, 2.0, 1.0))
"""Of the free-standing panel in its own light: bearing (deg), up to which distance (m), rate."""

FRONTAL_TARGET = (5.0, 0.95)
CLOSEST_TARGET = 0.35
NEAREST_ASIDE = 0.5
"""m; nearer, a marker that is seen from aside is not wholly in the picture."""
PANEL, OWN_LIGHT = "marker_panel", "default"
SIGNIFICANT = 6
COUNTS = ("other_detections", "double_detections", "false_detections")


def write_cells(path: Path, rows: Sequence[Row]) -> None:
    """Write one line for each cell; raises FileError."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(rows[0])
    for row in rows:
        writer.writerow(map(_entry, row.values()))
    replace_file(path, lambda part: part.write_text(text.getvalue()))


def _entry(value: Any) -> Any:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.{SIGNIFICANT}g}" if isinstance(value, float) else value


def detection_summary(rows: Sequence[Row]) -> Dict[str, Any]:
    """Return the ranges of each world and light, and how the panel's targets are met.

    Args:
        rows: of all cells, as in the table.
    """
    lights = _distinct((row["world"], row["light"]) for row in rows)
    worlds: Dict[str, Any] = {}
    for world, light in lights:
        figures = _ranges([r for r in rows if (r["world"], r["light"]) == (world, light)])
        entry = worlds.setdefault(world, {})
        if light == OWN_LIGHT:
            entry.update(figures)
        else:
            entry.setdefault("lights", {})[light] = figures
    return {"least_rate": LEAST_RATE, "worlds": worlds, "targets": _targets(rows)}


def _distinct(values: Iterable[Tuple[str, str]]) -> List[Tuple[str, str]]:
    return list(dict.fromkeys(values))


def _ranges(rows: Sequence[Row]) -> Dict[str, Any]:
    frontal, aside = (found_range(rows, bearing) for bearing in (0.0, 30.0))
    return {
        "closest_m": frontal[0],
        "farthest_frontal_m": frontal[1],
        "farthest_30deg_m": aside[1],
        **{name: sum(row[name] for row in rows) for name in COUNTS},
    }


def found_range(rows: Sequence[Row], bearing: float) -> Tuple[Optional[float], Optional[float]]:
    """Return the closest and the farthest distance of the longest range without a gap.

    Everywhere in it the marker is found in at least `LEAST_RATE` of the pictures. None, None
    where there is no such distance.
    """
    aligned = [row for row in rows if row["bearing_deg"] == bearing]
    best: List[float] = []
    current: List[float] = []
    for distance, rate in sorted((row["distance_m"], row["rate"]) for row in aligned):
        current = [*current, distance] if rate >= LEAST_RATE else []
        best = max(best, current, key=_length)
    return (best[0], best[-1]) if best else (None, None)


def _length(distances: Sequence[float]) -> float:
    return distances[-1] - distances[0] if distances else -1.0


def _targets(rows: Sequence[Row]) -> List[Dict[str, Any]]:
    """Return, for each target, in how many pictures the marker should have been found and was."""
    panel = [row for row in rows if (row["world"], row["light"]) == (PANEL, OWN_LIGHT)]
    found = [
        _target(panel, bearing, (NEAREST_ASIDE, distance), rate)
        for bearing, distance, rate in TARGETS
    ]
    far, rate = FRONTAL_TARGET
    found.append(_target(panel, 0.0, (far, far), rate))
    if any(row["bearing_deg"] == 0.0 and row["distance_m"] <= CLOSEST_TARGET for row in panel):
        closest = found_range(panel, 0.0)[0]
        met = closest is not None and closest <= CLOSEST_TARGET
        found.append({"target": f"closest {CLOSEST_TARGET:g} m", "closest_m": closest, "met": met})
    return [target for target in found if target]


def _target(
    panel: Sequence[Row], bearing: float, distances: Tuple[float, float], rate: float
) -> Dict[str, Any]:
    least, most = distances
    chosen = [r for r in panel if r["bearing_deg"] == bearing and least <= r["distance_m"] <= most]
    frames, found = (sum(row[name] for row in chosen) for name in ("frames", "found"))
    if not frames:
        return {}
    where = f"at {most:g} m" if least == most else f"up to {most:g} m"
    return {
        "target": f"{100 * rate:g} % {where}, {bearing:g} deg",
        "frames": frames,
        "found": found,
        "met": found >= rate * frames,
    }


def describe(summary: Mapping[str, Any]) -> List[str]:
    """Return the main figures as lines for people."""
    lines = []
    for world, figures in summary["worlds"].items():
        entries = {OWN_LIGHT: figures, **figures.get("lights", {})}
        for light, entry in entries.items():
            if "closest_m" in entry:
                lines.append(f"{world}, {light} light: {_sentence(entry)}")
    for target in summary["targets"]:
        count = (
            f"{target['found']} of {target['frames']} frames"
            if "frames" in target
            else f"{_metres(target['closest_m'])}"
        )
        lines.append(f"target {target['target']}: {count}, {'met' if target['met'] else 'MISSED'}")
    dots = summary["dots"]
    if dots["frames"]:
        lines.append(
            f"false detections in {dots['frames']} frames of the dots: {dots['false_detections']}"
        )
    return lines


def _sentence(entry: Mapping[str, Any]) -> str:
    text = (
        f"found from {_metres(entry['closest_m'])} to {_metres(entry['farthest_frontal_m'])} "
        f"frontal, to {_metres(entry['farthest_30deg_m'])} at 30 deg; "
        f"{entry['false_detections']} false detections"
    )
    others = entry["other_detections"]
    return f"{text}, {others} of the marker that is not meant" if others else text


def _metres(value: Optional[float]) -> str:
    return "nowhere" if value is None else f"{value:g} m"
