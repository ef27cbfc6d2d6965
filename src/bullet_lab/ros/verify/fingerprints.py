"""What a result is, in a hash and a few numbers that are small enough for a repository."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Sequence, Tuple

import numpy as np
from PIL import Image

from bullet_lab.errors import LabError

OF_THE_CLOCK = ("wall_time_s", "real_time_factor")
"""Keys of JSON files whose values tell how fast it went: those are left out."""

MOST_COLUMNS = 100
"""Of a table with more, such as a laser's, all of them are one."""

_DIGITS = 9
_HASH_DIGITS = 16
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.])")


class FingerprintError(LabError):
    """A result cannot be read."""


@dataclass(frozen=True)
class Fingerprint:
    """What is known of a result.

    Attributes:
        hash: of all its bytes; of JSON, of all but the keys that are left out.
        numbers: of it by their names, to nine digits. Of tables, the rows, and the mean and the
            standard deviation of each column; of JSON, each number, those of lists as a column;
            of pictures, width, height, and mean and standard deviation of each channel; of other
            files, all that look like numbers in them as a column.
    """

    hash: str
    numbers: Mapping[str, float]

    @staticmethod
    def of(path: Path, left_out: Sequence[str] = OF_THE_CLOCK) -> Fingerprint:
        """Read a file.

        Raises:
            FingerprintError: it is not what its name says, or cannot be read.
        """
        reader = _READERS.get(path.suffix, _text)
        try:
            content, numbers = reader(path, left_out)
        except (OSError, ValueError, csv.Error) as error:
            raise FingerprintError(f"cannot read {path}: {error}") from error
        rounded = {name: float(f"{value:.{_DIGITS}g}") for name, value in numbers.items()}
        return Fingerprint(hashlib.sha256(content).hexdigest()[:_HASH_DIGITS], rounded)

    def difference(self, reference: Fingerprint) -> Tuple[float, str]:
        """How far these numbers are from those of a reference, and the one that is farthest.

        Differences are relative for numbers beyond 1, absolute below; infinite where one of the
        two does not have a number.

        >>> a, b = Fingerprint("", {"x": 2.5, "y": 0.1}), Fingerprint("", {"x": 2.0, "y": 0.0})
        >>> a.difference(b)
        (0.25, 'x')
        >>> a.difference(Fingerprint("", {"x": 2.5}))
        (inf, 'y')
        """
        apart = [(0.0, "")]
        for name in {*self.numbers, *reference.numbers}:
            mine, theirs = self.numbers.get(name, math.inf), reference.numbers.get(name, 0.0)
            known = name in reference.numbers
            apart.append((abs(mine - theirs) / max(1.0, abs(theirs)) if known else math.inf, name))
        return max(apart)


_Content = Tuple[bytes, Dict[str, float]]


def _text(path: Path, _left_out: Sequence[str]) -> _Content:
    content = path.read_bytes()
    return content, _columns({"numbers": _NUMBER.findall(content.decode(errors="replace"))})


def _csv(path: Path, _left_out: Sequence[str]) -> _Content:
    header, *rows = csv.reader(path.read_text().splitlines())
    return path.read_bytes(), _columns({n: [row[i] for row in rows] for i, n in enumerate(header)})


def _tum(path: Path, _left_out: Sequence[str]) -> _Content:
    columns = zip(*(line.split() for line in path.read_text().splitlines()))
    names = ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw")
    return path.read_bytes(), _columns(dict(zip(names, columns)))


def _json(path: Path, left_out: Sequence[str]) -> _Content:
    return _of_values([json.loads(path.read_text())], left_out)


def _json_lines(path: Path, left_out: Sequence[str]) -> _Content:
    return _of_values(list(map(json.loads, path.read_text().splitlines())), left_out)


def _of_values(values: List[Any], left_out: Sequence[str]) -> _Content:
    values = [_without(value, left_out) for value in values]
    columns: Dict[str, List[Any]] = {}
    for name, leaf in _leaves(values, ""):
        columns.setdefault(name, []).append(leaf)
    return json.dumps(values).encode(), _columns(columns)


def _without(value: Any, left_out: Sequence[str]) -> Any:
    if isinstance(value, dict):
        return {k: _without(v, left_out) for k, v in value.items() if k not in left_out}
    return [_without(v, left_out) for v in value] if isinstance(value, list) else value


def _leaves(value: Any, name: str) -> Iterator[Tuple[str, Any]]:
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from _leaves(entry, f"{name}.{key}" if name else key)
    elif isinstance(value, list):
        for entry in value:
            yield from _leaves(entry, name)
    elif isinstance(value, (int, float)):
        yield name, float(value)


def _picture(path: Path, _left_out: Sequence[str]) -> _Content:
    with Image.open(path) as image:
        pixels = np.asarray(image.convert("RGB"), dtype=float).reshape(-1, 3)
        numbers = {"width": image.width, "height": image.height}
    return path.read_bytes(), {**numbers, **_columns(dict(zip(("red", "green", "blue"), pixels.T)))}


def _columns(columns: Mapping[str, Iterable[Any]]) -> Dict[str, float]:
    """Summaries of columns by their names; entries that are no finite numbers are left out."""
    if len(columns) > MOST_COLUMNS:
        columns = {"all columns": [entry for column in columns.values() for entry in column]}
    numbers: Dict[str, float] = {}
    for name, column in columns.items():
        entries = [number for number in map(_number, column) if math.isfinite(number)]
        if len(entries) == 1:
            numbers[name] = entries[0]
        elif entries:
            numbers[f"{name} count"] = len(entries)
            numbers[f"{name} mean"] = float(np.mean(entries))
            numbers[f"{name} std"] = float(np.std(entries))
    return numbers


def _number(entry: Any) -> float:
    try:
        return float(entry)
    except ValueError:
        return math.nan


_READERS = {
    ".csv": _csv,
    ".json": _json,
    ".jsonl": _json_lines,
    ".png": _picture,
    ".tum": _tum,
}
