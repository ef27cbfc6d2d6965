"""Docks: a database that is read from a YAML file, and whether a robot stands in its dock."""

from __future__ import annotations

import math
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, Collection, Mapping, Sequence

import numpy as np
import yaml

from bullet_lab.core import parameters, se2
from bullet_lab.core.parameters import ParameterError, declarations
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.docking.types import DockingError, Sighting
from bullet_lab.errors import LabError
from bullet_lab.vision.dictionaries import simple_name

_FILE_LIMIT = 1_000_000
# Index of the stream, of those that a seed spawns, that draws the error of a pose.
_ERROR_STREAM = 1

ERRORS = ("distance_error_m", "lateral_error_m", "yaw_error_deg")

DOCKED, WALL_CONTACT, INACCURATE = "docked", "wall_contact", "inaccurate"
"""Verdicts on a docking, besides the names of docking's errors in small letters."""


def _text(doc: str) -> Any:
    def accept(value: Any) -> str:
        if not isinstance(value, str) or not value.strip():
            raise ValueError
        return value

    return parameters.checked(MISSING, doc, "some text", accept)


def _number(doc: str, low: float, high: float) -> Any:
    return parameters.number(MISSING, doc, low, maximum=high)


def _accept_pose(value: Any) -> PlanarPose:
    if not isinstance(value, list) or any(isinstance(one, (bool, str)) for one in value):
        raise ValueError
    x, y, yaw = map(float, value)
    if not math.isfinite(x + y + yaw):
        raise ValueError
    return x, y, math.radians(yaw)


@dataclass(frozen=True)
class DockMarker:
    """The marker of a dock."""

    dictionary: str = _text("as in OpenCV")
    id: int = parameters.integer(MISSING, "of the marker in it", 0)
    size: float = _number("edge of its black square, m", 0.01, 5.0)
    height: float = _number("of its middle, m", 0.0, 5.0)

    def is_shown_by(self, sighting: Sighting) -> bool:
        """Return whether a sighting has this marker's id and dictionary."""
        same = simple_name(sighting.dictionary) == simple_name(self.dictionary)
        return same and sighting.id == self.id


@dataclass(frozen=True)
class DockWalls:
    """Walls that form a U."""

    opening: float = _number("inner width, m", 0.1, 20.0)
    depth: float = _number("inner depth before the marker, m", 0.01, 20.0)
    thickness: float = _number("m", 0.01, 5.0)


@dataclass(frozen=True)
class DockTolerance:
    """Limits within which a robot is docked."""

    distance: float = _number("along the axis, m", 1e-4, 1.0)
    lateral: float = _number("across it, m", 1e-4, 1.0)
    yaw: float = _number("rad; degrees in the file", 0.01, 45.0)


@dataclass(frozen=True)
class DockUncertainty:
    """Largest error of the pose."""

    position: float = _number("in each of x and y, m", 0.0, 5.0)
    yaw: float = _number("rad; degrees in the file", 0.0, 180.0)


@dataclass(frozen=True)
class Dock:
    """A dock; `pose` is rough, and `walls` is None for a marker on a wall or panel."""

    name: str
    frame: str = _text("that the pose is given in")
    pose: PlanarPose = parameters.checked(
        MISSING, "m, m, rad", "a list of x and y in m and yaw in degrees", _accept_pose
    )
    marker: DockMarker
    walls: DockWalls | None
    staging_distance: float = _number("from the robot to the marker, m", 0.5, 20.0)
    docked_distance: float = _number("from the camera to the marker, m", 0.1, 5.0)
    tolerance: DockTolerance
    uncertainty: DockUncertainty


def drawn_error(uncertainty: DockUncertainty, share: float, seed: int) -> PlanarPose:
    """Draw an error (m, m, rad), uniform within a share of an uncertainty, from a seed.

    Its random stream is independent of default_rng(seed).
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_ERROR_STREAM,)))
    most = share * np.array([uncertainty.position, uncertainty.position, uncertainty.yaw])
    return tuple((rng.uniform(-1.0, 1.0, 3) * most).tolist())


# Sections of a dock.
_SECTIONS = {
    "marker": DockMarker,
    "walls": DockWalls,
    "tolerance": DockTolerance,
    "uncertainty": DockUncertainty,
}


def read_docks(path: str | Path) -> dict[str, Dock]:
    """Read a dock database; raises LabError naming file, dock and key."""
    try:
        with open(path, encoding="utf-8") as stream:
            text = stream.read(_FILE_LIMIT + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise LabError(f"dock database {path}: {error}") from None
    return parse_docks(text, f"dock database {path}")


def parse_docks(text: str, where: str = "dock database") -> dict[str, Dock]:
    """Make docks of YAML text; raises LabError."""
    if len(text) > _FILE_LIMIT:
        raise LabError(f"{where}: larger than {_FILE_LIMIT} characters")
    try:
        content = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise LabError(f"{where}: no YAML: {error}") from None
    _check_keys(content, where, ["docks"])
    docks = content["docks"]
    if not isinstance(docks, dict) or not docks or not all(isinstance(key, str) for key in docks):
        raise LabError(f"{where}: docks is no mapping from names to docks")
    return {name: _dock(name, docks[name], f"{where}: docks: {name}") for name in docks}


def find_dock(docks: Mapping[str, Dock], name: str) -> Dock:
    """Return a dock by its name; raises LabError."""
    if name not in docks:
        raise LabError(f"no dock '{name}'; known are {', '.join(sorted(docks))}")
    return docks[name]


def _check_keys(content: Any, where: str, keys: Collection[str]) -> None:
    """Check that a mapping has these keys and no others; `walls` may be missing."""
    if not isinstance(content, dict):
        raise LabError(f"{where}: not a mapping")
    for key in keys:
        if key not in content and key != "walls":
            raise LabError(f"{where}: {key} is missing")
    for key in content:
        if key not in keys:
            raise LabError(f"{where}: unknown key {key}")


def _read(kind: type, content: Any, where: str, **values: Any) -> Any:
    """Make a dataclass of a mapping and of the values of its fields that are known already."""
    names = [entry.name for entry in fields(kind) if entry.name not in values]
    keys = {"yaw_deg" if name == "yaw" else name: name for name in names}
    _check_keys(content, where, keys)
    declared = declarations(kind)
    for key, name in keys.items():
        value = content.get(key)
        if name in _SECTIONS:
            is_read = name != "walls" or value is not None
            values[name] = _read(_SECTIONS[name], value, f"{where}: {name}") if is_read else None
            continue
        try:
            values[name] = declared[name].read(value, key)
        except ParameterError as error:
            raise LabError(f"{where}: {error}") from None
        if key == "yaw_deg":
            values[name] = math.radians(values[name])
    return kind(**values)


def _dock(name: str, content: Any, where: str) -> Dock:
    dock = _read(Dock, content, where, name=name)
    staging = f"{where}: staging_distance is {dock.staging_distance!r}, not"
    if dock.staging_distance <= dock.docked_distance:
        raise LabError(f"{staging} beyond docked_distance")
    if dock.walls is not None and dock.staging_distance <= dock.walls.depth:
        raise LabError(f"{staging} outside the walls")
    return dock


def docking_errors(
    robot: Sequence[float], dock: Sequence[float], camera_ahead: float, docked_distance: float
) -> dict[str, float]:
    """Return how far a robot (m, m, rad) is from where it should stand in a dock.

    Args:
        robot: its true pose.
        dock: true pose (m, m, rad) of the floor below the marker's face.
        camera_ahead: m, of the camera from the robot's middle.
        docked_distance: m, from the camera to the marker's face in a docked robot.

    Returns:
        By `ERRORS`: positive for too far away, for a robot to the left of the axis, and for one
        turned to the left.
    """
    x, y, yaw = se2.between(np.asarray(dock, dtype=float), np.asarray(robot, dtype=float))
    camera = x + camera_ahead * math.cos(yaw)
    return dict(zip(ERRORS, (float(-camera - docked_distance), float(y), math.degrees(yaw))))


def largest_errors(tolerance: DockTolerance) -> dict[str, float]:
    """Return a tolerance by `ERRORS`, in their units."""
    return dict(zip(ERRORS, (tolerance.distance, tolerance.lateral, math.degrees(tolerance.yaw))))


def judge(
    reported: DockingError, errors: Mapping[str, float], tolerance: DockTolerance, contacts: int
) -> str:
    """Return DOCKED, or what went wrong in one word.

    A docking is a success if the robot reports it (NONE), is right, and has touched nothing.

    >>> tolerance = DockTolerance(0.005, 0.003, 0.007)
    >>> judge(DockingError.NONE, dict(zip(ERRORS, (0.0, -0.0031, 0.0))), tolerance, 0)
    'inaccurate'
    """
    if contacts:
        return WALL_CONTACT
    if reported != DockingError.NONE:
        return reported.name.lower()
    most = largest_errors(tolerance)
    return DOCKED if all(abs(errors[name]) <= most[name] for name in ERRORS) else INACCURATE
