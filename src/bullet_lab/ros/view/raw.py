"""Messages as they came, of which only what is shown is read.

A page is shown tens of messages a second of each of many robots: genpy's objects for all of them
would cost more than everything else. Layouts are those of ROS's serialisation of the types named;
what is cut short raises RawError.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Callable, Iterator, List, Tuple, TypeVar

import numpy as np

from bullet_lab.core.pose import Pose, Quaternion, Vector
from bullet_lab.errors import LabError

_UINT = struct.Struct("<I")
_STAMP = struct.Struct("<III")
_POSE = struct.Struct("<7d")
_INTS = struct.Struct("<3i")
_SCALE = struct.Struct("<3d")
_COLOUR = struct.Struct("<4f")
_SCAN = struct.Struct("<7f")
_COVARIANCE = struct.Struct("<36d")
_LIFETIME_AND_LOCK = struct.Struct("<2iB")
_BYTE = struct.Struct("<B")

T = TypeVar("T")


class RawError(LabError):
    """A message that is not what its type says."""


class _Reader:
    """Reads one message from its beginning to its end."""

    def __init__(self, data: bytes):
        self._data, self.place = data, 0

    def unpack(self, layout: struct.Struct) -> tuple:
        values = layout.unpack_from(self._data, self.place)
        self.place += layout.size
        return values

    def count(self) -> int:
        return self.unpack(_UINT)[0]

    def text(self) -> str:
        length = self.count()
        found = self._data[self.place : self.place + length]
        if len(found) != length:
            raise RawError("cut short")
        self.place += length
        return found.decode("utf-8", "replace")

    def header(self) -> Tuple[float, str]:
        _, seconds, nanoseconds = self.unpack(_STAMP)
        return seconds + 1e-9 * nanoseconds, self.text()

    def pose(self) -> Pose:
        x, y, z, *turn = values = self.unpack(_POSE)
        if not math.isfinite(sum(values)):
            raise RawError("a pose that is not finite")
        return Pose((x, y, z), _unit(turn))

    def rows(self, count: int, columns: int, kind: str, finite: bool = True) -> np.ndarray:
        found = np.frombuffer(self._data, kind, count * columns, self.place)
        self.place += found.nbytes
        return (_finite(found) if finite else found).reshape(count, columns)


def _finite(values: np.ndarray) -> np.ndarray:
    if not np.isfinite(values).all():
        raise RawError("numbers that are not finite")
    return values


def _unit(turn: List[float]) -> Quaternion:
    """Return a quaternion of length 1; no turn for one without length, as RViz takes it."""
    square = sum(part * part for part in turn)
    if square == 0.0:
        return (0.0, 0.0, 0.0, 1.0)
    if abs(square - 1.0) > 1e-9:
        turn = [part / square**0.5 for part in turn]
    x, y, z, w = turn
    return x, y, z, w


def _checked(read: Callable[[bytes], T]) -> Callable[[bytes], T]:
    def checked(data: bytes) -> T:
        try:
            return read(data)
        except (struct.error, ValueError) as error:
            raise RawError(f"not what its type says: {error}") from error

    checked.__doc__ = read.__doc__
    return checked


@_checked
def read_transforms(data: bytes) -> List[Tuple[str, str, Pose]]:
    """Read tf2_msgs/TFMessage: parent, child, and the child's pose in the parent."""
    reader = _Reader(data)
    found = []
    for _ in range(reader.count()):
        _, parent = reader.header()
        child = reader.text()
        found.append((parent.lstrip("/"), child.lstrip("/"), reader.pose()))
    return found


@dataclass(frozen=True)
class Odometry:
    """Where a robot says it is.

    Attributes:
        frame: that the pose is in.
        child: frame of the robot.
        pose: of it.
        covariance: of x, of x with y, and of y, in m².
    """

    frame: str
    child: str
    pose: Pose
    covariance: Tuple[float, float, float]


@_checked
def read_odometry(data: bytes) -> Odometry:
    """Read nav_msgs/Odometry, without its speeds."""
    reader = _Reader(data)
    _, frame = reader.header()
    child = reader.text()
    pose = reader.pose()
    xx, xy, *_ = row = reader.unpack(_COVARIANCE)
    return Odometry(frame.lstrip("/"), child.lstrip("/"), pose, (xx, xy, row[7]))


@_checked
def read_path(data: bytes) -> Tuple[str, np.ndarray]:
    """Read nav_msgs/Path: its frame, and the places (n, 3) in m."""
    reader = _Reader(data)
    _, frame = reader.header()
    count = reader.count()
    if not count:
        return frame.lstrip("/"), np.zeros((0, 3))
    start = reader.place
    reader.header()
    reader.pose()
    stride = reader.place - start
    if len(data) == start + count * stride:
        rows = np.frombuffer(data, np.uint8, count * stride, start).reshape(count, stride)
        names = rows[:, _STAMP.size : stride - _POSE.size]
        # Where all frames are called the same, all poses have their numbers at the same place.
        if (names == names[0]).all():
            places = rows[:, stride - _POSE.size : stride - _POSE.size + 24].copy().view("<f8")
            return frame.lstrip("/"), _finite(places)
    return frame.lstrip("/"), np.array(list(_places(_Reader(data), count, start)))


def _places(reader: _Reader, count: int, start: int) -> Iterator[Vector]:
    reader.place = start
    for _ in range(count):
        reader.header()
        yield reader.pose().position


@dataclass(frozen=True)
class Scan:
    """What a laser sees: `ranges` (n,) in m, from the angle `start` on, `step` apart, in rad."""

    frame: str
    start: float
    step: float
    least: float
    greatest: float
    ranges: np.ndarray


@_checked
def read_scan(data: bytes) -> Scan:
    """Read sensor_msgs/LaserScan, without its intensities."""
    reader = _Reader(data)
    _, frame = reader.header()
    start, _, step, _, _, least, greatest = reader.unpack(_SCAN)
    # What is seen nowhere is infinite, or not a number.
    ranges = reader.rows(reader.count(), 1, "<f4", finite=False)[:, 0]
    _finite(np.array((start, step, least)))
    return Scan(frame.lstrip("/"), start, step, least, greatest, ranges)


@dataclass(frozen=True)
class Marker:
    """A marker as visualization_msgs has it; `points` (n, 3) in m, `colours` (n, 4).

    One that is `locked` goes with its frame, and others stay where that was as they came.
    """

    frame: str
    space: str
    number: int
    kind: int
    action: int
    pose: Pose
    scale: Vector
    colour: Tuple[float, ...]
    points: np.ndarray
    colours: np.ndarray
    text: str
    mesh: str
    own_looks: bool
    locked: bool


@_checked
def read_marker(data: bytes) -> List[Marker]:
    """Read visualization_msgs/Marker."""
    return [_marker(_Reader(data))]


@_checked
def read_markers(data: bytes) -> List[Marker]:
    """Read visualization_msgs/MarkerArray."""
    reader = _Reader(data)
    return [_marker(reader) for _ in range(reader.count())]


def _marker(reader: _Reader) -> Marker:
    _, frame = reader.header()
    space = reader.text()
    number, kind, action = reader.unpack(_INTS)
    pose, scale, colour = reader.pose(), reader.unpack(_SCALE), reader.unpack(_COLOUR)
    _finite(np.array((*scale, *colour)))
    _, _, locked = reader.unpack(_LIFETIME_AND_LOCK)
    points = reader.rows(reader.count(), 3, "<f8")
    colours = reader.rows(reader.count(), 4, "<f4")
    text, mesh = reader.text(), reader.text()
    own_looks = bool(reader.unpack(_BYTE)[0])
    return Marker(
        frame.lstrip("/"),
        space,
        number,
        kind,
        action,
        pose,
        scale,
        colour,
        points,
        colours,
        text,
        mesh,
        own_looks,
        bool(locked),
    )


@_checked
def read_clock(data: bytes) -> float:
    """Read rosgraph_msgs/Clock, s."""
    seconds, nanoseconds = struct.unpack_from("<II", data)
    return seconds + 1e-9 * nanoseconds
