"""Figures of two simulators side by side, and what may lie between them."""

from __future__ import annotations

import csv
import json
import math
import re
from dataclasses import asdict, dataclass
from io import StringIO
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np
from beside_scenarios import ROLLS, SLIDES, SLIPS, Drive, Figure, Played, motions, name_of

WIDEST = 36
"""Characters of a figure in the table."""

OK, FAILED, TOLD, UNKNOWN = "ok", "FAIL", "told", "not known"
"""Verdicts: the last two are of figures that have no limit, or that Gazebo's data lacks."""


@dataclass(frozen=True)
class Allowed:
    """How far a figure may be from Gazebo's: a share of it, or an amount if that is more."""

    share: float = 0.0
    within: float = 0.0

    def __str__(self) -> str:
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
_CASTERS = Allowed(share=0.1)


def allowed_in_drive(drive: Drive) -> Dict[str, Allowed]:
    """Return the limits of a drive's figures by their names."""
    found: Dict[str, Allowed] = dict(allowed_by_name(drive.name))
    for number, (first, end) in enumerate(motions(drive.legs)[: drive.judged]):
        leg, name = drive.legs[first], name_of(first, end)
        if leg.wz:
            # How long wheels go on when the robot stops is no measure of how it turns.
            found[f"leg {first} turned deg"] = _TURN[drive.moves]
        elif leg.vx or leg.vy:
            way = _MILLIMETRE if drive.moves == SLIDES and number == 0 else _WAY
            found[f"{name} {'ahead' if leg.vx else 'left'} m"] = way
    return found


def _each(limit: Allowed, *names: str) -> Dict[str, Allowed]:
    return dict.fromkeys(names, limit)


_PUSHED = ("x m", "y m", "vx m/s", "vy m/s", "wz rad/s", "yaw rad")
_SLID = [f"{axis} at {when} s m" for axis in "xy" for when in ("0.1", "0.5")]
_TURNED = [f"at {when} s {unit}" for when in (1, 2) for unit in ("rad", "rad/s")]
_SWUNG = [f"at {when} s rad" for when in range(1, 7)]
_SET = [
    f"{when} {what}"
    for when in ("now", "after 1 ms", "after 100 ms")
    for what in ("x m", "y m", "z m", "roll rad", "pitch rad", "yaw rad", "vz m/s", "wz rad/s")
]
_SLOPE = ("way m", "speed m/s")

# By the beginning of the scenario's name; the longest counts.
TRIALS: Dict[str, Mapping[str, Allowed]] = {
    "slide": _each(_MILLIMETRE, *_SLID),
    "push_1N_mu0": _each(DIGITS, *_PUSHED),
    # It stands there, and creeps in Gazebo.
    "push_1N_mu0.5": _each(Allowed(within=2e-3), "x m", "y m"),
    "push_6N": _each(_PERCENT, "x m"),
    "push_1N_aside": _each(DIGITS, "x m", "y m", "vx m/s", "vy m/s", "wz rad/s"),
    "torque_z": _each(DIGITS, *_PUSHED),
    "push_in": _each(DIGITS, *_PUSHED),
    "slope35": _each(DIGITS, *_SLOPE),
    "slope20_mu0": _each(DIGITS, *_SLOPE),
    # Gazebo's box creeps by 5.6 mm.
    "slope20_mu0.5": {},
    "drop": _each(_MILLIMETRE, "rebound m", "end m"),
    "roll": _each(DIGITS, "x m", "vx m/s", "wy rad/s"),
    "turn": _each(DIGITS, *_TURNED),
    "pendulum": _each(DIGITS, *_SWUNG),
    "push_block": _each(_PERCENT, "robot x m", "crate x m"),
    "set_model_state": _each(DIGITS, *_SET),
    "fall": _each(DIGITS, "z m", "vz m/s"),
    "two_casters": _each(_CASTERS, "leg 0 ahead m"),
    "rear_caster": {},
}


def allowed_by_name(scenario: str) -> Mapping[str, Allowed]:
    """Return the limits of a scenario's figures, from its name."""
    found = [start for start in TRIALS if scenario.startswith(start)]
    return TRIALS[max(found, key=len)] if found else {}


# By patterns in the names of the figures; the first one counts, and None means no limit.
SENSORS: Sequence[Tuple[str, Optional[Allowed]]] = (
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


def allowed_of_sensor(name: str) -> Optional[Allowed]:
    """Return the limit of a figure of the scenario with sensors."""
    return next(limit for pattern, limit in SENSORS if re.search(pattern, name))


def compare(
    scenario: str,
    gazebo: Mapping[str, Figure],
    here: Mapping[str, Figure],
    allowed: Callable[[str], Optional[Allowed]],
) -> List[Row]:
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


def distance(limit: Allowed, gazebo: Figure, here: Optional[Figure]) -> float:
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


def table(rows: Sequence[Row], with_told: bool) -> str:
    """Return the rows as text, those without a limit only if asked for."""
    shown = [row for row in rows if with_told or row.verdict in (OK, FAILED)]
    cells = [("scenario", "quantity", "Gazebo", "here", "allowed", "verdict")]
    cells += [(r.scenario, r.quantity, *both(r), r.allowed, r.verdict) for r in shown]
    widths = [max(map(len, column)) for column in zip(*cells)]
    sides = "<<>>><"
    return "\n".join(
        "  ".join(f"{c:{s}{w}}" for c, s, w in zip(line, sides, widths)).rstrip() for line in cells
    )


def both(row: Row) -> Tuple[str, str]:
    """Return both figures as text; of words, those that only one has, unless they are the same."""
    one, other = row.gazebo, row.here
    if isinstance(one, str) and isinstance(other, str) and one != other:
        there, here = one.split(), other.split()
        one = " ".join(word for word in there if word not in here)
        other = " ".join(word for word in here if word not in there)
    return text_of(one), text_of(other)


def summary(rows: Sequence[Row]) -> str:
    """Return how many rows there are of each verdict."""
    counts = dict.fromkeys((OK, FAILED, TOLD, UNKNOWN), 0)
    for row in rows:
        counts[row.verdict] += 1
    return ", ".join(f"{count} {verdict}" for verdict, count in counts.items())


def text_of(value: Optional[Figure]) -> str:
    """Return a figure as text of at most some characters."""
    if value is None:
        return ""
    if isinstance(value, str):
        return value if len(value) <= WIDEST else f"…{value[1 - WIDEST :]}"
    if isinstance(value, list):
        return text_of(" ".join(f"{round(number, 5) + 0.0:.5g}" for number in value))
    return f"{round(value, 5) + 0.0:.5f}"


def as_csv(rows: Sequence[Row]) -> str:
    """Return all rows as CSV, with a header."""
    stream = StringIO()
    writer = csv.DictWriter(stream, list(Row.__dataclass_fields__), lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in rows)
    return stream.getvalue()


# ---- Figures in files ----


def read_figures(path: Path) -> Dict[str, Played]:
    """Return the figures of a file by scenario."""
    text = json.loads(path.read_text(encoding="utf-8"))
    return {
        name: Played(entry["figures"], [tuple(row) for row in entry.get("path", ())])
        for name, entry in text["scenarios"].items()
    }


def write_figures(path: Path, origin: str, played: Mapping[str, Played]) -> None:
    """Write figures to a file, a line for each scenario."""
    lines = [
        f"{json.dumps(name)}: {json.dumps(_entry(entry))}" for name, entry in played.items()
    ]
    body = ",\n".join(lines)
    path.write_text(
        f'{{"origin": {json.dumps(origin)}, "scenarios": {{\n{body}\n}}}}\n', encoding="utf-8"
    )


def _entry(played: Played) -> Dict[str, Any]:
    figures = {name: _short(value) for name, value in played.figures.items()}
    path = [[_short(value, 5) for value in row] for row in played.path]
    return {"figures": figures, **({"path": path} if path else {})}


def _short(value: Figure, digits: int = 6) -> Figure:
    if isinstance(value, str):
        return value
    if isinstance(value, list):
        return [round(number, digits) + 0.0 for number in value]
    return round(value, digits) + 0.0
