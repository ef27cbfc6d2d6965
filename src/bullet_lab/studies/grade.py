"""Exercises, what they measure of a run, and the mark as JSON, JUnit's XML and a picture."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Callable, NamedTuple, Sequence
from xml.etree import ElementTree

import numpy as np
import yaml

from bullet_lab.core.files import Summary, replace_file, write_json
from bullet_lab.core.parameters import (
    checked,
    choice,
    declarations,
    integer,
    number,
    number_list,
    text,
)
from bullet_lab.errors import LabError
from bullet_lab.simulation.world.resources import ResourceFinder, package_share
from bullet_lab.simulation.world.xml import read_text

EXERCISES = "config/exercises"
GRADE = "grade.json"
AGAIN = "grade it again"
"""Part of a note on a run whose result is not kept."""

# m; a robot that has driven less did not move.
MOVED = 0.05
LEAST_MESSAGES = 10
NUMBER = re.compile(r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?")
# m; radius of a place that is drawn, if its criterion has no largest distance.
SMALLEST_CIRCLE = 0.02


@dataclass
class Record:
    """What was seen of one run.

    Attributes:
        path: rows t (s), x, y (m) of the true pose.
        boxes: x, y of the lower and the upper corner (m) of each other model, by name.
        touched: names of the models that the robot has touched.
        messages: rows of stamp (s) and value, by topic and field.
        files: beginnings of the files that the submission has left, by name.
        status: exit status; None if the submission did not end by itself.
        notes: why the run was not as it should be, a line each.
    """

    path: list[Sequence[float]] = field(default_factory=list)
    boxes: dict[str, Sequence[float]] = field(default_factory=dict)
    touched: list[str] = field(default_factory=list)
    messages: dict[str, list[Sequence[float]]] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)
    status: int | None = None
    notes: list[str] = field(default_factory=list)

    def track(self) -> np.ndarray:
        """Return x, y (m) of the path, shape (n, 2)."""
        return np.array(self.path, dtype=float).reshape(-1, 3)[:, 1:]


def _places(value: Any) -> tuple[tuple[float, float], ...]:
    return tuple((float(x), float(y)) for x, y in value)


@dataclass(frozen=True)
class Criterion:
    """A measure, its arguments, and the limits within which it gives its points."""

    measure: str = text("", "what is measured")
    name: str = text("", "what is judged, in words")
    points: float = number(1.0, "points", above=0.0)
    at_least: float = number(-math.inf, "least value")
    at_most: float = number(math.inf, "largest value")
    places: tuple[tuple[float, float], ...] = checked(
        ((0.0, 0.0),), "places in m", "a list of places [x, y]", _places
    )
    topic: str = text("", "its name")
    type: str = text("std_msgs/Float64", "type of its messages")
    field: str = text("data", "field of a message, with points between the names")
    truth: str = choice("zero", "what the field should be", ("zero", "x", "y", "distance"))
    file: str = text("", "name of a file that the submission leaves")
    number: float = number(0.0, "the number that its last one should be")

    @property
    def path(self) -> str:
        """The field of a message that is measured; empty for the message as a whole."""
        return "" if self.measure == "rate" else self.field

    @property
    def key(self) -> str:
        """The topic and the field, with a space between them."""
        return f"{self.topic} {self.path}"

    def wanted(self) -> str:
        """Return the limits in words."""
        if self.at_least == self.at_most:
            return f"{self.at_most:g}"
        limits = [f">= {self.at_least:g}"] * math.isfinite(self.at_least)
        limits += [f"<= {self.at_most:g}"] * math.isfinite(self.at_most)
        return f"{' and '.join(limits)} {MEASURES[self.measure].unit}".strip()

    def value(self, record: Record) -> float | None:
        """Return the measured value; None if the run has none."""
        measure = MEASURES[self.measure]
        track = record.track()
        if not len(track) or (measure.of_drive and np.ptp(track, axis=0).max() < MOVED):
            return None
        value = measure.of(self, record)
        return float(value) if value is not None and math.isfinite(value) else None

    def holds(self, value: float | None) -> bool:
        """Return whether a value is within the limits."""
        return value is not None and self.at_least <= value <= self.at_most


def _end_error(criterion: Criterion, record: Record) -> float:
    return np.hypot(*(record.track()[-1] - criterion.places[-1]))


def _path_error(criterion: Criterion, record: Record) -> float:
    """Return the largest distance (m) by which the path misses places, in their order."""
    worst = np.zeros(len(record.path))
    for place in criterion.places:
        distances = np.hypot(*(record.track() - place).T)
        # Of all points until here, the best that a path through the places can reach.
        worst = np.minimum.accumulate(np.maximum(worst, distances))
    return worst[-1]


def _clearance(_: Criterion, record: Record) -> float:
    """Return the least distance (m) of the robot's origin from the boxes around models."""
    boxes = np.array(list(record.boxes.values())).reshape(-1, 1, 4)
    outside = np.maximum(boxes[..., :2] - record.track(), record.track() - boxes[..., 2:])
    return np.hypot(*np.maximum(outside, 0.0).T).min(initial=math.inf)


def _file_error(criterion: Criterion, record: Record) -> float | None:
    found = NUMBER.findall(record.files.get(criterion.file, ""))
    return abs(float(found[-1]) - criterion.number) if found else None


def _rate(criterion: Criterion, record: Record) -> float | None:
    stamps = [row[0] for row in record.messages.get(criterion.key, [])]
    seconds = stamps[-1] - stamps[0] if stamps else 0.0
    return (len(stamps) - 1) / seconds if seconds > 0.0 else None


def _errors(summary: Callable[[np.ndarray], float]) -> Callable[[Criterion, Record], Any]:
    """Return a measure that summarizes how a topic's values differ from the truth."""

    def measure(criterion: Criterion, record: Record) -> float | None:
        rows = np.array(record.messages.get(criterion.key, []), dtype=float)
        if len(rows) < LEAST_MESSAGES:
            return None
        away = np.hypot(*(record.track() - criterion.places[0]).T)
        x, y = record.track().T
        truth = {"zero": 0.0 * x, "x": x, "y": y, "distance": away}[criterion.truth]
        stamps = [row[0] for row in record.path]
        return summary(rows[:, 1] - np.interp(rows[:, 0], stamps, truth))

    return measure


class Measure(NamedTuple):
    """A number that a run is judged by; `of_drive`: there is none if the robot did not move."""

    of: Callable[[Criterion, Record], Any]
    unit: str
    keys: str
    of_drive: bool = True


ERRORS = "topic type field truth places"
MEASURES = {
    "end_error": Measure(_end_error, "m", "places"),
    "path_error": Measure(_path_error, "m", "places"),
    "clearance": Measure(_clearance, "m", ""),
    "contacts": Measure(lambda _, record: len(record.touched), "models", ""),
    "exit_status": Measure(lambda _, record: record.status, "", "", False),
    "file_error": Measure(_file_error, "", "file number", False),
    "rate": Measure(_rate, "Hz", "topic type", False),
    "topic_error": Measure(_errors(lambda all_: np.quantile(abs(all_), 0.95)), "", ERRORS, False),
    "topic_mean": Measure(_errors(lambda all_: abs(np.mean(all_))), "", ERRORS, False),
    "topic_std": Measure(_errors(np.std), "", ERRORS, False),
}
"""The measures by their names in exercises, with the keys of their arguments."""


@dataclass(frozen=True)
class Exercise:
    """The settings of an exercise."""

    title: str = text("", "what is to be done")
    world: str = text("package://bullet_lab/worlds/empty.world", "SDF world")
    robot: str = text("package://bullet_lab/urdf/block_robot.urdf", "URDF of the robot")
    start: tuple[float, ...] = number_list((0.0, 0.0, 0.0), "x y in m and yaw in degrees")
    rtf: float = number(4.0, "simulated seconds per second", above=0.0, maximum=100.0)
    simulated_limit: float = number(60.0, "simulated s for the submission", above=0.0)
    wall_limit: float = number(60.0, "wall s for the submission", above=0.0)
    processor_limit: int = integer(30, "s of processor time of each process", 1)
    output_limit: int = integer(1000, "kB that may be printed", 1)
    seed: int = integer(1, "of the first run", 0)
    runs: int = integer(1, "runs, each with its own seed; a criterion must hold in all", 1, 100)
    criteria: tuple[Criterion, ...] = ()


def find_exercise(name: str, base: Path) -> Path:
    """Return the file of an exercise, a name or a path relative to `base`; raise LabError."""
    folder = package_share() / EXERCISES
    path = base / name if name.endswith(".yaml") else folder / f"{name}.yaml"
    if not path.is_file():
        known = ", ".join(sorted(one.stem for one in folder.glob("*.yaml")))
        raise LabError(f"exercise is '{name}': it must be one of {known}, or a path of a .yaml")
    return path


def read_exercise(path: Path) -> Exercise:
    """Read a file; raise LabError with a line that names key, value and what is allowed."""
    try:
        content = yaml.safe_load(read_text(path))
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise LabError(f"{path.name} is no YAML: {' '.join(str(error).split())}") from error
    given = content.pop("criteria", None) if isinstance(content, dict) else None
    exercise = Exercise(**_read(Exercise, content, path.name, list(declarations(Exercise))))
    for key in ("world", "robot"):
        try:
            ResourceFinder.anywhere().find(getattr(exercise, key))
        except LabError as error:
            raise LabError(f"{path.name}: {key} is {error}") from error
    if not isinstance(given, list) or not given:
        raise LabError(f"{path.name}: criteria is {given}: it must be a list of criteria")
    criteria = [_criterion(one, f"{path.name}: criterion {n}") for n, one in enumerate(given, 1)]
    return replace(exercise, criteria=tuple(criteria))


def _criterion(entry: Any, where: str) -> Criterion:
    name = entry.get("measure") if isinstance(entry, dict) else ""
    if name not in list(MEASURES):
        raise LabError(f"{where}: measure is {name}: it must be one of {', '.join(MEASURES)}")
    keys = ["measure", "name", "points", "at_least", "at_most", *MEASURES[name].keys.split()]
    found = _read(Criterion, entry, where, keys)
    if not {"at_least", "at_most"} & set(found):
        raise LabError(f"{where}: at_least or at_most is missing")
    return Criterion(**{"name": name, **found})


def _read(kind: type, given: Any, where: str, allowed: list[str]) -> dict[str, Any]:
    """Return the checked values of a dataclass from the entries of a file."""
    if not isinstance(given, dict):
        raise LabError(f"{where} is {str(given)[:80]}: it must be keys with values")
    for key in given:
        if key not in allowed:
            raise LabError(f"{where}: there is no key '{key}'; allowed are {', '.join(allowed)}")
    known = declarations(kind)
    return {key: known[key].read(value, f"{where}: {key}") for key, value in given.items()}


def grade(name: str, exercise: Exercise, records: Sequence[Record]) -> Summary:
    """Return the mark of a submission for its runs, as in grade.json."""
    rows = []
    for criterion in exercise.criteria:
        values = [criterion.value(record) for record in records]
        # Of several runs, the first bad one counts.
        measured = next((one for one in values if not criterion.holds(one)), values[0])
        row = {"criterion": criterion.name, "passed": criterion.holds(measured)}
        row.update(points=criterion.points * row["passed"], of=criterion.points)
        rows.append({**row, "measured": measured, "wanted": criterion.wanted()})
    return {
        "submission": _plain(name),
        "exercise": exercise.title,
        "points": sum(row["points"] for row in rows),
        "of": sum(row["of"] for row in rows),
        "why": list(dict.fromkeys(_plain(note) for one in records for note in one.notes)),
        "criteria": rows,
    }


def _plain(line: str) -> str:
    """Return a line with ? for the characters that XML or UTF-8 do not have."""
    return "".join(one if one.isprintable() else "?" for one in line)


def write_grade(folder: Path, mark: Summary, exercise: Exercise, records: Sequence[Record]) -> None:
    """Write grade.png, grade.xml and grade.json; raises FileError."""
    # The process of each run imports this module, and draws nothing.
    from matplotlib.patches import Circle, Rectangle

    from bullet_lab.core.figures import BLUE, GREEN, GREY, VERMILION, new_figure, plan_axes, save

    figure = new_figure(9.0, 5.0)
    axes = figure.add_axes([0.08, 0.11, 0.5, 0.78])
    plan_axes(axes)
    axes.set_title(f"{mark['submission']}: {mark['points']:g} of {mark['of']:g}", parse_math=False)
    for record in records:
        for left, bottom, right, top in record.boxes.values():
            box = (left, bottom), right - left, top - bottom
            axes.add_patch(Rectangle(*box, facecolor="#d5d5d5", edgecolor=GREY))
        axes.plot(*record.track().T, color=BLUE)
        axes.plot(*record.track()[-1:].T, "o", color=BLUE)
    suite = ElementTree.Element("testsuite", name=mark["submission"])
    for line, (row, criterion) in enumerate(zip(mark["criteria"], exercise.criteria)):
        colour = GREEN if row["passed"] else VERMILION
        measured = "nothing" if row["measured"] is None else f"{row['measured']:.3g}"
        words = f"measured {measured}, wanted {row['wanted']}"
        said = f"{row['criterion']}: {row['points']:g} of {row['of']:g}\n   {words}"
        figure.text(0.62, 0.85 - 0.1 * line, said, color=colour, va="top", parse_math=False)
        names = {"name": row["criterion"], "classname": mark["exercise"]}
        case = ElementTree.SubElement(suite, "testcase", names)
        if not row["passed"]:
            ElementTree.SubElement(case, "failure", message=words)
        radius = criterion.at_most if math.isfinite(criterion.at_most) else SMALLEST_CIRCLE
        for place in criterion.places if "places" in MEASURES[criterion.measure].keys else ():
            axes.add_patch(Circle(place, radius, fill=False, color=colour))
            axes.plot(*place, "+", color=colour)
    ElementTree.SubElement(suite, "system-out").text = "\n".join(mark["why"])
    save(figure, folder / "grade.png")
    xml = ElementTree.tostring(suite, encoding="unicode")
    replace_file(folder / "grade.xml", lambda part: part.write_text(xml))
    write_json(folder / GRADE, mark)
