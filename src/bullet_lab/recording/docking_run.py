"""What one docking leaves behind, while it goes on and at its end."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.numerics import se2
from bullet_lab.numerics.trajectory import Trajectory, tum_row
from bullet_lab.recording.files import RowFile, make_folder

PlanarPose = Tuple[float, float, float]
NANOSECONDS = 1_000_000_000


class DockingRunError(LabError):
    """A pose cannot be recorded."""


class PathRecording:
    """Writes one path as a TUM file while poses come in.

    Args:
        path: of the file; its folder is made if need be.

    Raises:
        FileError: it cannot be written, here and in all that adds to it.
    """

    def __init__(self, path: Path):
        make_folder(path.parent)
        self._file = RowFile(path)
        self._stamps: List[int] = []
        self._poses: List[PlanarPose] = []

    @property
    def last(self) -> Optional[int]:
        """The last stamp in ns, None while there is none."""
        return self._stamps[-1] if self._stamps else None

    def add(self, stamp: int, pose: PlanarPose) -> None:
        """Record a pose (m, m, rad) at a stamp in ns.

        Raises:
            DockingRunError: not later than the one before.
        """
        if self._stamps and stamp <= self._stamps[-1]:
            raise DockingRunError("time goes back")
        self._stamps.append(stamp)
        self._poses.append(pose)
        self._file.write(tum_row(stamp / NANOSECONDS, *pose))

    def until(self, stamp: Optional[int]) -> Optional[Trajectory]:
        """Return the path up to a stamp in ns, all of it for None; None while there is none."""
        count = sum(stamp is None or one <= stamp for one in self._stamps)
        if not count:
            return None
        seconds = [one / NANOSECONDS for one in self._stamps[:count]]
        return Trajectory(seconds, self._poses[:count])

    def finish(self, stamp: Optional[int]) -> None:
        """Close the file; leave out what came after a stamp in ns, if one is given."""
        kept = [
            tum_row(one / NANOSECONDS, *pose)
            for one, pose in zip(self._stamps, self._poses)
            if stamp is None or one <= stamp
        ]
        self._file.rewrite(kept)


def docking_errors(
    robot: Sequence[float], dock: Sequence[float], camera_ahead: float, docked_distance: float
) -> Dict[str, float]:
    """Return how far a robot is from where it should stand in a dock.

    Args:
        robot: its true pose, m and rad.
        dock: true pose of the floor below the marker's face, in the same frame.
        camera_ahead: m, of the camera from the robot's middle.
        docked_distance: m, from the camera to the marker's face in a docked robot.

    Returns:
        distance_error_m, positive for too far away; lateral_error_m of the robot, to the left;
        yaw_error_deg.
    """
    x, y, yaw = se2.between(np.asarray(dock, dtype=float), np.asarray(robot, dtype=float))
    camera = x + camera_ahead * math.cos(yaw)
    return {
        "distance_error_m": float(-camera - docked_distance),
        "lateral_error_m": float(y),
        "yaw_error_deg": math.degrees(yaw),
    }


class Keepsakes:
    """Keeps some of many things, spread evenly over their number, and the last one.

    Args:
        count: how many there shall be at least, once there were so many.
    """

    def __init__(self, count: int):
        self._count = max(2, count)
        self._kept: List[Any] = []
        self._last: Any = None
        self._seen = 0
        self._stride = 1

    def add(self, thing: Any) -> None:
        """Take the next one."""
        if self._seen % self._stride == 0:
            if len(self._kept) >= 4 * self._count:
                self._kept = self._kept[::2]
                self._stride *= 2
            if self._seen % self._stride == 0:
                self._kept.append(thing)
        self._seen += 1
        self._last = thing

    def chosen(self) -> List[Any]:
        """Return as many as wanted, or all if there are fewer; the last is the last one seen."""
        things = list(self._kept)
        if things and things[-1] is not self._last:
            things.append(self._last)
        if len(things) <= self._count:
            return things
        picked = np.linspace(0, len(things) - 1, self._count).round().astype(int)
        return [things[index] for index in picked]
