"""The occupancy grid of a world, as a laser of that height or a robot of those heights finds it.

Rays along x, y and z find all surfaces between two heights: the cells with a surface are occupied.
The cells that a way over free cells leads to, from the start, are free. All others are unknown.

Example:
    bullet_lab map world:=worlds/docking.world
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Iterator

import numpy as np
from scipy.ndimage import label

from bullet_lab.core.figures import BLUE, new_figure, plan_axes
from bullet_lab.core.files import replace_file
from bullet_lab.core.parameters import number, text
from bullet_lab.navigation.occupancy import FREE, OCCUPIED, UNKNOWN, MapError, OccupancyMap
from bullet_lab.simulation.physics import pybullet
from bullet_lab.simulation.physics.rays import cast
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.studies.study import Settings, Tell, progress, run_from, write_results

# Simulated seconds in which what is loose comes to rest.
REST = 1.0
# Cells around all that stands, and the most cells of a map.
MARGIN = 5
MOST_CELLS = 4_000_000
# m; a box around something that is larger is that of a ground plane.
ENDLESS = 1e4
# Rays through each cell, along each axis of the floor.
RAYS = 3
# m between two heights, at most, and behind a surface where its ray goes on.
HEIGHT_STEP = 0.02
BEHIND = 1e-3
# A ray gives up behind so many surfaces.
MOST_SURFACES = 2000


@dataclass(frozen=True)
class MapSettings(Settings):
    """What of the world is mapped."""

    world: str = text("house", "SDF world: a path, a URI, or the name of one of the package")
    resolution: float = number(0.05, "edge of a cell in m", minimum=0.005, maximum=1.0)
    low: float = number(0.05, "height in m from which something is in the way")
    high: float = number(0.5, "height in m up to which; that of `low` for a laser")
    x: float = number(0.0, "start in m: what can be reached from there is free")
    y: float = number(0.0, "start in m")


def find_world(name: str) -> str:
    """Return a world by path, URI or, without a suffix, its name in the package."""
    is_name = "/" not in name and not name.endswith(".world")
    return f"package://bullet_lab/worlds/{name}.world" if is_name else name


def map_world(settings: MapSettings, watch: Callable[[list], Any] = list) -> OccupancyMap:
    """Return the map of a world; robots, that is models that take commands, are left out.

    `watch` gets the list of all passes of rays, and returns an iterable of them. Raises LabError if
    the world cannot be read, or the start or the size is impossible.
    """
    if settings.high < settings.low:
        raise MapError(f"high is {settings.high:g}: it must not be below low, {settings.low:g}")
    with Simulation.of(find_world(settings.world)) as simulation:
        for name, model in list(simulation.models.items()):
            if any(plugin.inputs for plugin in model.plugins):
                simulation.remove(name)
        if not all(model.model.static for model in simulation.models.values()):
            simulation.run_for(REST)
        scanner = _Scanner(simulation, settings)
        for rays in watch(list(scanner.passes())):
            scanner.cast(*rays)
    return scanner.finish((settings.x, settings.y))


class _Scanner:
    """Marks the cells with a surface."""

    def __init__(self, simulation: Simulation, settings: MapSettings):
        self._client, size = simulation.client, settings.resolution
        heights = settings.low, settings.high
        boxes = [np.reshape([settings.x, settings.y, heights[0]] * 2, (2, 3))]
        for body in simulation.models.values():
            for one in body.bodies.values():
                for index in range(-1, pybullet.getNumJoints(one.unique_id, self._client)):
                    box = np.array(pybullet.getAABB(one.unique_id, index, self._client))
                    stands = box[1, 2] >= heights[0] and box[0, 2] <= heights[1]
                    if stands and np.ptp(box, axis=0).max() < ENDLESS:
                        boxes.append(box)
        low, high = np.min(boxes, axis=(0, 1))[:2], np.max(boxes, axis=(0, 1))[:2]
        first = np.floor(low / size).astype(int) - MARGIN
        shape = np.floor(high / size).astype(int) + MARGIN + 1 - first
        if shape.prod() > MOST_CELLS:
            wide, deep = (shape * size).tolist()
            raise MapError(
                f"resolution is {size:g}: a map of {wide:.0f} x {deep:.0f} m would have "
                f"{shape.prod()} cells; at most {MOST_CELLS}"
            )
        self._low, self._size = first * size, size
        self._occupied = np.zeros(shape, dtype=bool)
        count = 1 + math.ceil((heights[1] - heights[0]) / HEIGHT_STEP - 1e-9)
        self._heights = np.linspace(*heights, count)

    def passes(self) -> Iterator[tuple[int, np.ndarray, float]]:
        """Yield the rays of each pass: their axis, their starts and their length (m, signed)."""
        spots = [
            low + self._size / RAYS * (0.5 + np.arange(count * RAYS))
            for low, count in zip(self._low, self._occupied.shape)
        ]
        spans = (self._size * np.array(self._occupied.shape)).tolist()
        for height in self._heights:
            for axis in (0, 1):
                starts = np.full((len(spots[1 - axis]), 3), height)
                starts[:, 1 - axis] = spots[1 - axis]
                for end, length in ((0.0, spans[axis]), (spans[axis], -spans[axis])):
                    starts[:, axis] = self._low[axis] + end
                    yield axis, starts.copy(), length
        down = self._heights[0] - self._heights[-1]
        for x in spots[0][RAYS // 2 :: RAYS] if down else ():
            starts = np.full((len(spots[1]) // RAYS, 3), (x, 0.0, self._heights[-1]))
            starts[:, 1] = spots[1][RAYS // 2 :: RAYS]
            yield 2, starts, float(down)

    def cast(self, axis: int, starts: np.ndarray, length: float) -> None:
        """Mark the cells of all surfaces along rays; one ray sees each surface that it enters."""
        ends = starts.copy()
        ends[:, axis] += length
        behind = math.copysign(BEHIND, length)
        for _ in range(MOST_SURFACES):
            hits = cast(self._client, starts.tolist(), ends.tolist())
            found = np.array([hit[0] >= 0 for hit in hits], dtype=bool)
            if not found.any():
                return
            places = np.array([hit[3] for hit in hits])[found]
            starts, ends = starts[found], ends[found]
            places[:, axis] += 0.5 * behind
            cells = np.floor((places[:, :2] - self._low) / self._size).astype(int)
            inside = np.all((cells >= 0) & (cells < self._occupied.shape), axis=1)
            self._occupied[tuple(cells[inside].T)] = True
            starts[:, axis] = places[:, axis] + 0.5 * behind
            left = (ends[:, axis] - starts[:, axis]) * behind > 0.0
            starts, ends = starts[left], ends[left]
            if not len(starts):
                return

    def finish(self, start: tuple[float, float]) -> OccupancyMap:
        """Return the map, with what can be reached from the start; raises MapError."""
        areas, _ = label(~self._occupied)
        here = areas[tuple(np.floor((np.array(start) - self._low) / self._size).astype(int))]
        if not here:
            place = f"({start[0]:g}, {start[1]:g}) m"
            raise MapError(f"the start {place} is occupied; choose x and y on free floor")
        cells = np.where(self._occupied, OCCUPIED, np.where(areas == here, FREE, UNKNOWN))
        origin = (float(self._low[0]), float(self._low[1]), 0.0)
        return OccupancyMap(cells.T.astype(np.int8), self._size, origin)


def _run(folder: Path, settings: MapSettings, tell: Tell) -> list[str]:
    def watch(passes: list) -> Any:
        return progress(passes, "passes of rays", len(passes), tell)

    found = map_world(settings, watch)
    cells, size = found.cells, found.resolution
    free, edge = cells == FREE, np.ones(cells.shape, bool)
    edge[1:-1, 1:-1] = False
    summary = {
        "job": "map",
        "world": ResourceFinder.anywhere().find(find_world(settings.world)).name,
        "resolution_m": size,
        "low_m": settings.low,
        "high_m": settings.high,
        "start_m": [settings.x, settings.y],
        "origin": list(found.origin),
        "columns": cells.shape[1],
        "rows": cells.shape[0],
        "free_m2": round(float(free.sum()) * size**2, 6),
        "occupied_m2": round(float((cells == OCCUPIED).sum()) * size**2, 6),
        "is_closed": not bool((free & edge).any()),
    }
    figure = new_figure(9.0, 8.0)
    axes = figure.add_subplot()
    plan_axes(axes, title=f"{summary['world']}: {summary['free_m2']:.1f} m² free")
    axes.imshow(found.levels(), cmap="gray", vmin=0, vmax=255, extent=found.extent())
    axes.plot(settings.x, settings.y, "o", color=BLUE, label="start")
    axes.legend(loc="upper right")
    replace_file(folder / "map.pgm", lambda part: part.write_bytes(found.pgm()))
    write_results(folder, summary, {}, {"map.png": figure}, {"map.yaml": found.yaml("map.pgm")})
    areas = f"{summary['free_m2']:.2f} m² are free, {summary['occupied_m2']:.2f} m² occupied"
    closed = "" if summary["is_closed"] else "; free floor reaches the edge of the map"
    return [areas + closed]


main = functools.partial(run_from, "map", __doc__, (MapSettings,), _run)
