"""What there is to try for a detection range, cut into tasks that any process can do."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, Iterator, Optional, Sequence, Tuple

from bullet_lab.errors import LabError
from bullet_lab.studies.detection_range.scenes import LIGHTS, WORLDS, Cell, is_reachable
from bullet_lab.studies.detection_range.trial import TrialSettings, count_false, try_cell
from bullet_lab.studies.workers import in_own_thread

DOTS = "docking_dots"
DOTS_PER_BLOCK = 25
FULLY_LIT = ("marker_panel", "docking")
"""These worlds are tried in all lights, the others in their own: the marker is the same one."""

MOST_FRAMES = 100_000
LARGEST_DISTANCE = 50.0
Result = Any
"""A CellResult, or (false detections, finds) in a block of pictures of the dots."""


class RangeError(LabError):
    """Settings that make no sense, or work that was not done."""


@dataclass(frozen=True)
class RangeSettings:
    """What is tried.

    Attributes:
        worlds: of `WORLDS`.
        lights: of `LIGHTS`.
        distances: from camera to marker, m.
        bearings: angles from the marker's axis, degrees; each is tried on both sides.
        frames: pictures in each cell.
        dots: pictures of the dots, in which nothing may be found but the marker.
        seed: of all that is random.
        every_light: try all worlds in all lights.
    """

    worlds: Tuple[str, ...] = tuple(WORLDS)
    lights: Tuple[str, ...] = tuple(LIGHTS)
    distances: Tuple[float, ...] = (
        *(0.3, 0.32, 0.34, 0.35, 0.36, 0.4, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0),
        *(4.5, 5.0, 5.5, 6.0, 6.5, 7.0, 8.0),
    )
    bearings: Tuple[float, ...] = (0.0, 15.0, 30.0, 45.0, 60.0)
    frames: int = 10
    dots: int = 1000
    seed: int = 1
    every_light: bool = False

    def __post_init__(self) -> None:
        """Raise RangeError where that cannot be tried."""
        for name, known in (("worlds", WORLDS), ("lights", LIGHTS)):
            for value in _several(name, getattr(self, name)):
                if value not in known:
                    raise RangeError(f"{name}: '{value}' is not one of {', '.join(known)}")
        for name, most in (("distances", LARGEST_DISTANCE), ("bearings", 85.0)):
            least = 0.1 if name == "distances" else 0.0
            for value in _several(name, getattr(self, name)):
                if not least <= value <= most:
                    raise RangeError(f"{name} must be from {least:g} to {most:g}, not {value:g}")
        for name, least in (("frames", 1), ("dots", 0)):
            if not least <= getattr(self, name) <= MOST_FRAMES:
                raise RangeError(
                    f"{name} must be from {least} to {MOST_FRAMES}, not {getattr(self, name)}"
                )
        if self.seed < 0:
            raise RangeError(f"seed must be an integer >= 0, not {self.seed}")

    def trial(self, frames: int) -> TrialSettings:
        """Return how pictures are taken."""
        return TrialSettings(frames, self.seed)


def _several(name: str, values: Sequence) -> Sequence:
    if not values or len(set(values)) < len(values):
        raise RangeError(f"{name} must not be empty nor hold a value twice")
    return values


@dataclass(frozen=True)
class Task:
    """Something for a worker to do: a cell, or a block of pictures of the dots."""

    cell: Optional[Cell]
    block: int = 0
    frames: int = 0


@functools.lru_cache(maxsize=4)
def tasks(settings: RangeSettings) -> Tuple[Task, ...]:
    """Return all that there is to do, in the order of the results."""
    found = [Task(cell) for cell in _cells(settings) if is_reachable(cell)]
    for block, first in enumerate(range(0, settings.dots, DOTS_PER_BLOCK)):
        found.append(Task(None, block, min(DOTS_PER_BLOCK, settings.dots - first)))
    return tuple(found)


def _cells(settings: RangeSettings) -> Iterator[Cell]:
    for world in settings.worlds:
        for light in settings.lights:
            if light == "default" or world in FULLY_LIT or settings.every_light:
                for bearing in settings.bearings:
                    for distance in settings.distances:
                        yield Cell(world, light, distance, math.radians(bearing))


def do_task(settings: RangeSettings, number: int) -> Result:
    """Do one of the `tasks`: return a CellResult, or false detections and finds of a block."""
    return in_own_thread(_do_task, settings, tasks(settings)[number])


def _do_task(settings: RangeSettings, task: Task) -> Result:
    if task.cell is None:
        return count_false(settings.trial(task.frames), DOTS, task.block)
    keep = task.cell.light == "default" and task.cell.bearing == 0.0
    return try_cell(settings.trial(settings.frames), task.cell, keep)
