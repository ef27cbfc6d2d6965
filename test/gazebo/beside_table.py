"""Figures of two simulators side by side, and what may lie between them."""

import csv
import json
import math
import re
from collections import Counter
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from beside_scenarios import ROLLS, SLIDES, SLIPS, Played, motions, name_of

WIDEST = 36
"""Characters of a figure in the table."""

OK, FAILED, TOLD, UNKNOWN = "ok", "FAIL", "told", "not known"
"""Verdicts: the last two are of figures that have no limit, or that Gazebo's data lacks."""


class Allowed(NamedTuple):
    """How far a figure may be from Gazebo's: a share of it, or an amount if that is more."""

    share: float = 0.0
    within: float = 0.0

    def __str__(self):
        return f"{100 * self.share:g} %" if self.share else f"{self.within:g}"


class Row(NamedTuple):
    """A figure of a scenario: in Gazebo and here, and what may lie between.

    `apart` is how far they are from each other, in what is allowed: 1 at the limit.
    """

    scenario: str
    quantity: str
    gazebo: object
    here: object
    allowed: str
    apart: float
    verdict: str


_MILLIMETRE = Allowed(within=1e-3)
_WAY = Allowed(share=0.02)
_TURN = {SLIDES: Allowed(within=3.0), ROLLS: Allowed(within=3.0), SLIPS: Allowed(share=0.08)}


def allowed_in_drive(drive):
    """Return the limits of a drive's figures by their names."""
    found = dict(allowed_by_name(drive.name))
    for number, (first, end) in enumerate(motions(drive.legs)[: drive.judged]):
        leg = drive.legs[first]
        if leg.wz:
            # How long wheels go on when the robot stops is no measure of how it turns.
            found[f"leg {first} turned deg"] = _TURN[drive.moves]
        elif not leg.stands:
            way = _MILLIMETRE if drive.moves == SLIDES and number == 0 else _WAY
            found[f"{name_of(first, end)} {'ahead' if leg.vx else 'left'} m"] = way
    return found


_TABLE = yaml.safe_load(Path(__file__).with_name("limits.yaml").read_text())
TRIALS = {
    start: (Allowed(**limit), *figures) for start, (limit, *figures) in _TABLE["trials"].items()
}
SENSORS = [(pattern, Allowed(**limit) if limit else None) for pattern, limit in _TABLE["sensors"]]


def allowed_by_name(scenario):
    """Return the limits of a scenario's figures, from its name."""
    found = [start for start in TRIALS if scenario.startswith(start)]
    limit, *names = TRIALS[max(found, key=len)] if found else [None]
    return dict.fromkeys(names, limit)


def allowed_of_sensor(name):
    """Return the limit of a figure of the scenario with sensors."""
    return next(limit for pattern, limit in SENSORS if re.search(pattern, name))


def compare(scenario, gazebo, here, allowed):
    """Return a row for each figure that one of the two has; `allowed` has the limits by name."""
    rows = []
    for name in dict.fromkeys((*here, *gazebo)):
        limit = allowed(name)
        one, other = gazebo.get(name), here.get(name)
        word = "the same" if limit and isinstance(one, str) else str(limit or "")
        apart = None if limit is None or one is None else distance(limit, one, other)
        verdict = TOLD if one is not None else UNKNOWN
        if apart is not None:
            verdict = OK if apart <= 1.0 else FAILED
        rows.append(Row(scenario, name, one, other, word, apart, verdict))
    return rows


def distance(limit, gazebo, here):
    """Return how far a figure is from Gazebo's, 1 at its limit.

    Text has to be the same; of an array, as many numbers count as are known.
    """
    if isinstance(gazebo, str) or isinstance(here, str) or here is None:
        return 0.0 if gazebo == here else math.inf
    known, found = np.atleast_1d(gazebo), np.atleast_1d(here)
    if len(found) < len(known):
        return math.inf
    allowed = np.maximum(limit.share * np.abs(known), limit.within)
    apart = np.abs(found[: len(known)] - known)
    with np.errstate(divide="ignore", invalid="ignore"):
        worst = np.max(np.where(apart == 0.0, 0.0, apart / allowed), initial=0.0)
    return math.inf if math.isnan(worst) else float(worst)


def table(rows, with_told):
    """Return the rows as text, those without a limit only if asked for."""
    shown = [row for row in rows if with_told or row.verdict in (OK, FAILED)]
    cells = [("scenario", "quantity", "Gazebo", "here", "allowed", "verdict")]
    cells += [(r.scenario, r.quantity, *both(r), r.allowed, r.verdict) for r in shown]
    widths = [max(map(len, column)) for column in zip(*cells)]
    sides = "<<>>><"
    return "\n".join(
        "  ".join(f"{c:{s}{w}}" for c, s, w in zip(line, sides, widths)).rstrip() for line in cells
    )


def both(row):
    """Return both figures as text; of words, those that only one has, unless they are the same."""
    one, other = row.gazebo, row.here
    if isinstance(one, str) and isinstance(other, str) and one != other:
        there, here = one.split(), other.split()
        one = " ".join(word for word in there if word not in here)
        other = " ".join(word for word in here if word not in there)
    return text_of(one), text_of(other)


def summary(rows):
    """Return how many rows there are of each verdict."""
    counts = Counter(row.verdict for row in rows)
    return ", ".join(f"{counts[verdict]} {verdict}" for verdict in (OK, FAILED, TOLD, UNKNOWN))


def text_of(value):
    """Return a figure as text of at most some characters."""
    if isinstance(value, list):
        value = " ".join(f"{round(number, 5) + 0.0:.5g}" for number in value)
    elif isinstance(value, (int, float)):
        return f"{round(value, 5) + 0.0:.5f}"
    value = value or ""
    return value if len(value) <= WIDEST else f"…{value[1 - WIDEST :]}"


def as_csv(rows):
    """Return all rows as CSV, with a header."""
    stream = StringIO()
    csv.writer(stream, lineterminator="\n").writerows([Row._fields, *rows])
    return stream.getvalue()


# ---- Figures in files ----


def read_figures(path):
    """Return the figures of a file by scenario."""
    text = json.loads(path.read_text(encoding="utf-8"))
    return {
        name: Played(entry["figures"], [tuple(row) for row in entry.get("path", ())])
        for name, entry in text["scenarios"].items()
    }


def write_figures(path, origin, played):
    """Write figures to a file, a line for each scenario."""
    lines = []
    for name, here in played.items():
        entry = {"figures": {key: _short(value) for key, value in here.figures.items()}}
        if here.path:
            entry["path"] = [_short(list(row), 5) for row in here.path]
        lines.append(f"{json.dumps(name)}: {json.dumps(entry)}")
    scenarios = "{\n" + ",\n".join(lines) + "\n}"
    text = f'{{"origin": {json.dumps(origin)}, "scenarios": {scenarios}}}\n'
    path.write_text(text, encoding="utf-8")


def _short(value, digits=6):
    if isinstance(value, list):
        return [_short(number, digits) for number in value]
    return value if isinstance(value, str) else round(value, digits) + 0.0
