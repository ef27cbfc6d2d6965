"""Occupancy grids, and their files in the format of map_server: an image and a YAML file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Tuple

import cv2
import numpy as np
import yaml

from bullet_lab.core.se2 import PlanarPose
from bullet_lab.errors import LabError

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
"""Values of cells."""

# Grey levels of the three in an image, as map_saver writes them.
_FREE_LEVEL, _OCCUPIED_LEVEL, _UNKNOWN_LEVEL = 254, 0, 205
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196

# What a file raises that is no map.
_UNREADABLE = (
    TypeError,
    ValueError,
    ArithmeticError,
    AttributeError,
    RecursionError,
    yaml.YAMLError,
)


class MapError(LabError):
    """A map cannot be read or used."""


@dataclass(frozen=True)
class OccupancyMap:
    """A grid of the floor.

    Attributes:
        cells: (rows along y, columns along x) int8: 0 free to 100 occupied, -1 unknown.
        resolution: edge of a cell, m.
        origin: pose of the lower left corner of the first cell: m, m, rad.
    """

    cells: np.ndarray
    resolution: float
    origin: PlanarPose = (0.0, 0.0, 0.0)

    def extent(self) -> Tuple[float, float, float, float]:
        """Return left, right, bottom and top in m, as of matplotlib's `imshow`."""
        (rows, columns), (x, y, _) = self.cells.shape, self.origin
        return x, x + columns * self.resolution, y, y + rows * self.resolution

    def levels(self) -> np.ndarray:
        """Return the grey levels of an image, (rows from above, columns) uint8."""
        known = np.where(self.cells >= 65, _OCCUPIED_LEVEL, _UNKNOWN_LEVEL)
        is_free = (self.cells >= 0) & (self.cells <= 19)
        return np.where(is_free, _FREE_LEVEL, known)[::-1].astype(np.uint8)

    def pgm(self) -> bytes:
        """Return the content of the image file."""
        rows, columns = self.cells.shape
        return f"P5\n{columns} {rows}\n255\n".encode() + self.levels().tobytes()

    def yaml(self, image: str) -> str:
        """Return the content of the YAML file beside an image of that name."""
        x, y, yaw = self.origin
        return (
            f"image: {image}\nresolution: {self.resolution:.6f}\n"
            f"origin: [{x:.6f}, {y:.6f}, {yaw:.6f}]\nnegate: 0\n"
            f"occupied_thresh: {OCCUPIED_THRESHOLD}\nfree_thresh: {FREE_THRESHOLD}\n"
        )


def read_map(path: Path) -> OccupancyMap:
    """Read the YAML file of a map and its image; raises MapError."""
    if path.suffix not in (".yaml", ".yml"):
        raise MapError(f"the map is '{path}'; it must be a YAML file, such as that of the job map")
    try:
        content = yaml.safe_load(path.read_text())
        image = path.parent / str(content["image"])
        resolution, origin = float(content["resolution"]), tuple(map(float, content["origin"]))
        negate = bool(int(content.get("negate", 0)))
        occupied = float(content.get("occupied_thresh", OCCUPIED_THRESHOLD))
        free = float(content.get("free_thresh", FREE_THRESHOLD))
        mode = str(content.get("mode", "trinary"))
    except OSError as error:
        raise MapError(f"cannot read {path}: {error.strerror}") from error
    except KeyError as error:
        raise MapError(f"{path}: {error.args[0]} is missing") from error
    except _UNREADABLE as error:
        raise MapError(f"{path} is no map: {error}".split("\n")[0]) from error
    is_finite = all(map(math.isfinite, (resolution, *origin, occupied, free)))
    if len(origin) != 3 or not is_finite or resolution <= 0.0 or mode != "trinary":
        allowed = "a resolution > 0, an origin of 3 finite numbers, the mode trinary"
        raise MapError(f"{path}: needs {allowed}")
    levels = cv2.imread(str(image), cv2.IMREAD_UNCHANGED)
    if levels is None or levels.dtype != np.uint8:
        raise MapError(f"{path}: cannot read the image {image}; it must be one of 8 bits, as PGM")
    # As in map_server, the mean of all channels counts.
    grey = np.atleast_3d(levels).mean(axis=2)
    share = (grey if negate else 255.0 - grey) / 255.0
    values = np.where(share > occupied, OCCUPIED, np.where(share < free, FREE, UNKNOWN))
    return OccupancyMap(values.astype(np.int8)[::-1], resolution, origin)
