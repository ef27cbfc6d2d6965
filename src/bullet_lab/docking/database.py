"""Database of docks: a YAML file, read and checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Tuple, Union

import yaml

from bullet_lab.core.se2 import PlanarPose
from bullet_lab.errors import LabError

_FILE_LIMIT = 1_000_000


class DatabaseError(LabError):
    """The dock database makes no sense."""


class UnknownDockError(DatabaseError):
    """There is no dock of that name."""


@dataclass(frozen=True)
class DockMarker:
    """The marker: dictionary as in OpenCV, edge of its black square, height of its middle (m)."""

    dictionary: str
    id: int
    size: float
    height: float


@dataclass(frozen=True)
class DockWalls:
    """Walls that form a U: inner width, inner depth before the marker, thickness, in m."""

    opening: float
    depth: float
    thickness: float


@dataclass(frozen=True)
class DockTolerance:
    """Limits within which a robot is docked: m along the axis, m across it, rad."""

    distance: float
    lateral: float
    yaw: float


@dataclass(frozen=True)
class DockUncertainty:
    """How wrong the pose may be: m in each of x and y, rad."""

    position: float
    yaw: float


@dataclass(frozen=True)
class Dock:
    """A dock; `staging_distance` (robot to marker) and `docked_distance` (camera to marker) in m.

    `pose` is rough, in the frame named `frame`. `walls` is None for a marker on a wall or panel.
    """

    name: str
    frame: str
    pose: PlanarPose
    marker: DockMarker
    walls: Optional[DockWalls]
    staging_distance: float
    docked_distance: float
    tolerance: DockTolerance
    uncertainty: DockUncertainty


def read_docks(path: Union[str, Path]) -> Dict[str, Dock]:
    """Read a dock database; raises DatabaseError naming file, dock and key."""
    try:
        with open(path, encoding="utf-8") as stream:
            text = stream.read(_FILE_LIMIT + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise DatabaseError(f"dock database {path}: {error}") from None
    return parse_docks(text, f"dock database {path}")


def parse_docks(text: str, where: str = "dock database") -> Dict[str, Dock]:
    """Make docks of YAML text; raises DatabaseError."""
    if len(text) > _FILE_LIMIT:
        raise DatabaseError(f"{where}: larger than {_FILE_LIMIT} characters")
    try:
        content = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise DatabaseError(f"{where}: no YAML: {error}") from None
    root = _Section(content, where)
    docks = root.section("docks")
    root.finish()
    if not docks.names():
        raise DatabaseError(f"{where}: no docks")
    return {name: _dock(name, docks.section(name)) for name in docks.names()}


def find_dock(docks: Mapping[str, Dock], name: str) -> Dock:
    """Return a dock by its name; raises UnknownDockError."""
    if name not in docks:
        raise UnknownDockError(f"no dock '{name}'; known are {', '.join(sorted(docks))}")
    return docks[name]


class _Section:
    """A mapping of the file that knows where it is and which keys were asked for."""

    def __init__(self, content: Any, where: str):
        if not isinstance(content, dict):
            raise DatabaseError(f"{where}: not a mapping")
        bad = [key for key in content if not isinstance(key, str)]
        if bad:
            raise DatabaseError(f"{where}: the key {bad[0]!r} is no text")
        self._content, self._where = dict(content), where
        self._asked = set()

    def names(self) -> Tuple[str, ...]:
        return tuple(self._content)

    def take(self, key: str) -> Any:
        self._asked.add(key)
        if key not in self._content:
            raise DatabaseError(f"{self._where}: {key} is missing")
        return self._content[key]

    def section(self, key: str) -> _Section:
        return _Section(self.take(key), f"{self._where}: {key}")

    def optional(self, key: str) -> Optional[_Section]:
        self._asked.add(key)
        return None if self._content.get(key) is None else self.section(key)

    def text(self, key: str) -> str:
        value = self.take(key)
        if not isinstance(value, str) or not value.strip():
            self.refuse(key, value, "some text")
        return value

    def whole(self, key: str) -> int:
        value = self.take(key)
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            self.refuse(key, value, "a whole number from 0 on")
        return value

    def number(self, key: str, low: float, high: float) -> float:
        value = self.take(key)
        if not _is_number(value) or not low <= value <= high:
            self.refuse(key, value, f"a number from {low:g} to {high:g}")
        return float(value)

    def pose(self, key: str) -> PlanarPose:
        value = self.take(key)
        if not isinstance(value, list) or len(value) != 3 or not all(map(_is_number, value)):
            self.refuse(key, value, "a list of x and y in m and yaw in degrees")
        return float(value[0]), float(value[1]), math.radians(value[2])

    def refuse(self, key: str, value: Any, required: str) -> None:
        raise DatabaseError(f"{self._where}: {key} is {value!r}, not {required}")

    def numbers(self, **limits: Tuple[float, float]) -> List[float]:
        """Return the numbers that are left to read, each within its limits."""
        values = [self.number(key, low, high) for key, (low, high) in limits.items()]
        self.finish()
        return values

    def finish(self) -> None:
        """Raise DatabaseError for a key that nobody asked for."""
        unknown = [key for key in self._content if key not in self._asked]
        if unknown:
            raise DatabaseError(f"{self._where}: unknown key {unknown[0]}")


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def _dock(name: str, entry: _Section) -> Dock:
    dock = Dock(
        name,
        entry.text("frame"),
        entry.pose("pose"),
        _marker(entry.section("marker")),
        _walls(entry.optional("walls")),
        entry.number("staging_distance", 0.5, 20.0),
        entry.number("docked_distance", 0.1, 5.0),
        _tolerance(entry.section("tolerance")),
        _uncertainty(entry.section("uncertainty")),
    )
    entry.finish()
    if dock.staging_distance <= dock.docked_distance:
        entry.refuse("staging_distance", dock.staging_distance, "beyond docked_distance")
    if dock.walls is not None and dock.staging_distance <= dock.walls.depth:
        entry.refuse("staging_distance", dock.staging_distance, "outside the walls")
    return dock


def _marker(entry: _Section) -> DockMarker:
    dictionary, marker = entry.text("dictionary"), entry.whole("id")
    return DockMarker(dictionary, marker, *entry.numbers(size=(0.01, 5.0), height=(0.0, 5.0)))


def _walls(entry: Optional[_Section]) -> Optional[DockWalls]:
    if entry is None:
        return None
    limits = {"opening": (0.1, 20.0), "depth": (0.01, 20.0), "thickness": (0.01, 5.0)}
    return DockWalls(*entry.numbers(**limits))


def _tolerance(entry: _Section) -> DockTolerance:
    limits = {"distance": (1e-4, 1.0), "lateral": (1e-4, 1.0), "yaw_deg": (0.01, 45.0)}
    distance, lateral, degrees = entry.numbers(**limits)
    return DockTolerance(distance, lateral, math.radians(degrees))


def _uncertainty(entry: _Section) -> DockUncertainty:
    position, degrees = entry.numbers(position=(0.0, 5.0), yaw_deg=(0.0, 180.0))
    return DockUncertainty(position, math.radians(degrees))
