"""Figures of two simulators side by side, and what may lie between them."""

from __future__ import annotations

import csv
import json
import math
import re
from collections import Counter
from dataclasses import asdict, dataclass
from io import StringIO
from typing import Optional

import numpy as np
from beside_scenarios import ROLLS, SLIDES, SLIPS, Figure, Played, motions, name_of
from beside_trials import SET

WIDEST = 36
"""Characters of a figure in the table."""

OK, FAILED, TOLD, UNKNOWN = "ok", "FAIL", "told", "not known"
"""Verdicts: the last two are of figures that have no limit, or that Gazebo's data lacks."""


@dataclass(frozen=True)
class Allowed:
    """How far a figure may be from Gazebo's: a share of it, or an amount if that is more."""

    share: float = 0.0
    within: float = 0.0

    def __str__(self):
        return f"{100 * self.share:g} %" if self.share else f"{self.within:g}"


@dataclass(frozen=True)
class Row:
    """A figure of a scenario: in Gazebo and here, and what may lie between.

    `apart` is how far they are from each other, in what is allowed: 1 at the limit.
    """

    scenario: str
    quantity: str
    gazebo: Optional[Figure]
    here: Optional[Figure]
    allowed: str
    apart: Optional[float]
    verdict: str


DIGITS = Allowed(within=1e-4)
"""Agrees to four digits."""

_PERCENT = Allowed(share=0.01)
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


_PUSHED = (DIGITS, "x m", "y m", "vx m/s", "vy m/s", "wz rad/s", "yaw rad")
_SLOPE = (DIGITS, "way m", "speed m/s")
# By the beginning of the scenario's name; the longest counts.
TRIALS = {
    "slide": (_MILLIMETRE, *(f"{axis} at {when} s m" for axis in "xy" for when in (0.1, 0.5))),
    "push_1N_mu0": _PUSHED,
    # It stands there, and creeps in Gazebo.
    "push_1N_mu0.5": (Allowed(within=2e-3), "x m", "y m"),
    "push_6N": (_PERCENT, "x m"),
    "push_1N_aside": _PUSHED[:-1],
    "torque_z": _PUSHED,
    "push_in": _PUSHED,
    "slope35": _SLOPE,
    "slope20_mu0": _SLOPE,
    # Gazebo's box creeps by 5.6 mm.
    "slope20_mu0.5": (DIGITS,),
    "drop": (_MILLIMETRE, "rebound m", "end m"),
    "roll": (DIGITS, "x m", "vx m/s", "wy rad/s"),
    "turn": (DIGITS, *(f"at {when} s {unit}" for when in (1, 2) for unit in ("rad", "rad/s"))),
    "pendulum": (DIGITS, *(f"at {when} s rad" for when in range(1, 7))),
    "push_block": (_PERCENT, "robot x m", "crate x m"),
    "set_model_state": (
        DIGITS,
        *(f"{when} {what}" for when in ("now", "after 1 ms", "after 100 ms") for what in SET),
    ),
    "fall": (DIGITS, "z m", "vz m/s"),
    "two_casters": (Allowed(share=0.1), "leg 0 ahead m"),
}
"""A limit, and the figures that it is for."""


def allowed_by_name(scenario):
    """Return the limits of a scenario's figures, from its name."""
    found = [start for start in TRIALS if scenario.startswith(start)]
    limit, *names = TRIALS[max(found, key=len)] if found else [None]
    return dict.fromkeys(names, limit)


# By patterns in the names of the figures; the first one counts, and None means no limit.
SENSORS = (
    (r"^(cam|rgb) .* (red|green|blue)$", Allowed(within=3.0)),
    # Software GL was too slow for them; under load, range sensors were late, too.
    (r"(image_raw|camera_info|points|sonar) gap ms$", None),
    (r"bumper gap ms$", None),
    (r"gap ms$", Allowed(within=0.5)),
    # Of these, the contract lists what differs and why.
    (r"camera_info (K|P)$", None),
    (r"joint_states", None),
    (r"focal length px$", Allowed(within=0.01)),
    (r"scan ranges (min|mean|max)$", Allowed(within=3e-3)),
    (r"share of whole mm$", Allowed(within=0.2)),
    # A step is 1 ms here, whatever is set; the other settings are those of ODE.
    (r"^physics (pause|max_update_rate|ode_config)", None),
    (r"bumper share", Allowed(within=0.05)),
    (r"bumper states", None),
    (r"moments kg m2$|centre m$|mass kg$", Allowed(within=2e-6)),
    (r"covariance$", Allowed(within=1e-9)),
    # The camera robot creeps by 0.35 mm/s in Gazebo.
    (r"rest cam/odom pose pose position$", Allowed(within=5e-3)),
    (r"rest cam/odom", Allowed(within=5e-3)),
    (r"turn robot/(imu_old angular|truth twist twist angular)", Allowed(within=1e-3)),
    (r"push robot/truth twist twist linear$", Allowed(within=1e-3)),
    (r"turn robot turned deg$", Allowed(within=3.0)),
    (r"push (robot|crate) x m$", _PERCENT),
    (r"(turn|push) .*(orientation|position|linear|angular|linear_acceleration)$", None),
    (r"(turn|push) (robot|crate) (x|y|turned)", None),
    (r"", DIGITS),
)


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
    writer = csv.DictWriter(stream, list(Row.__dataclass_fields__), lineterminator="\n")
    writer.writeheader()
    writer.writerows(map(asdict, rows))
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
