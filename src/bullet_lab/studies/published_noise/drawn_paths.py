"""What the report's plot shows of a path around a square, and the lengths read from it.

Figure 1b and the replays go the same way: the plot draws a path, its vertices are read, its
corners are found among them, and lengths are measured from what is drawn and nothing else.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import path as drawing

from bullet_lab.errors import LabError

SIDES = 4

LENGTHS = (*(f"side{side}" for side in range(1, SIDES + 1)), "start", "corners")
"""What `measure` measures, in this order."""

# Points of 1/72 inch for each metre along x and y of figure 1b, by its axes. matplotlib leaves
# out vertices that are less than 1/9 of a point beside the line: 0.7 mm in x, 0.9 mm in y.
_POINTS_PER_METRE = (170.6, 122.9)
_STRAIGHT = 1.0 / 9.0

_MOST_LOOKED_AT = 100
_LEAST_STEP = 0.1  # m; shorter steps of the drawn path are at the corners


class DrawnPathError(LabError):
    """There is no square in a path, or the digitised figure cannot be read."""


def drawn(points) -> np.ndarray:
    """Return the vertices that matplotlib draws of a path on the axes of figure 1b.

    Args:
        points: x and y (m), shape (n, 2).

    Returns:
        m, shape (k, 2): those that lie on a line with their neighbours are left out, as in the
        vector graphic that the report has; some are there twice.

    >>> drawn([(0, 0), (0.5, 0.0002), (1, 0), (1, 0.5), (1, 1)]).round(3).tolist()
    [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 1.0]]
    """
    path = drawing.Path(np.asarray(points, dtype=float) * _POINTS_PER_METRE)
    path.simplify_threshold = _STRAIGHT
    # The last vertex of what is returned only says that the path ends.
    return path.cleaned(simplify=True).vertices[:-1] / _POINTS_PER_METRE


def find_corners(vertices) -> np.ndarray:
    """Find the corners of a drawn path around a square.

    They are the three vertices which, joined with the first and the last one to four sides,
    leave the least sum of distances of all vertices from the lines of their sides. (A sum of
    squares would let a zigzag on one side move the corners of its neighbours.) Of a path of more
    than 100 vertices, whose sides are no lines anyway, 100 are looked at.

    Args:
        vertices: x and y (m) in the order driven, shape (n, 2).

    Returns:
        Indices of the vertices, shape (5,), from the first to the last.

    Raises:
        DrawnPathError: there are no four sides.

    >>> find_corners([(0, 0), (1, 0.1), (2, 0), (2, -2), (1, -2), (0, -2), (0, 0)]).tolist()
    [0, 2, 3, 5, 6]
    """
    vertices = np.asarray(vertices, dtype=float)
    looked_at = np.linspace(0, len(vertices) - 1, min(len(vertices), _MOST_LOOKED_AT)).astype(int)
    beside = _distances_beside_lines(vertices[looked_at])
    least, choices = beside[0], []
    for _ in range(SIDES - 1):
        sums = least[:, np.newaxis] + beside
        choices.append(sums.argmin(axis=0))
        least = sums.min(axis=0)
    if not np.isfinite(least[-1]):
        raise DrawnPathError("the path has no four sides")
    corners = [len(beside) - 1]
    for choice in reversed(choices):
        corners.append(int(choice[corners[-1]]))
    return looked_at[[0, *reversed(corners)]]


def _distances_beside_lines(vertices: np.ndarray) -> np.ndarray:
    """Return the sum of distances (m) of the vertices i to j from the line through i and j."""
    count = len(vertices)
    sums = np.full((count, count), np.inf)
    is_up_to_j = np.tri(count)
    for i, vertex in enumerate(vertices[:-1]):
        x, y = (vertices[i + 1 :] - vertex).T
        areas = np.abs(np.outer(x, y) - np.outer(y, x))
        lengths, is_line = np.hypot(x, y), (x != 0.0) | (y != 0.0)
        summed = (areas * is_up_to_j[: len(x), : len(x)]).sum(axis=1)
        sums[i, i + 1 :][is_line] = summed[is_line] / lengths[is_line]
    return sums


def measure(vertices, perfect_corners) -> np.ndarray:
    """Return the `LENGTHS` (m) of a noisy path, from its own corners; shape (6,).

    - `side1` to `side4`: the largest distance from the line of each side, across it.
    - `start`: the same within the first half of the first side.
    - `corners`: how far one of the corners 1 to 3 is from that of the perfect path in the same
      picture; the largest of the three.

    Args:
        vertices: of the noisy path (m), shape (n, 2).
        perfect_corners: m, shape (5, 2).

    Raises:
        DrawnPathError: there are no four sides.
    """
    vertices = np.asarray(vertices, dtype=float)
    indices = find_corners(vertices)
    corners = vertices[indices]
    across = []
    for first, last in zip(indices, indices[1:]):
        x, y = (vertices[first : last + 1] - vertices[first]).T
        across.append(np.abs(x * y[-1] - y * x[-1]) / math.hypot(x[-1], y[-1]))
    from_start = np.hypot(*(vertices[: indices[1] + 1] - vertices[0]).T)
    start = across[0][from_start < 0.5 * from_start[-1]].max()
    apart = np.hypot(*(corners - perfect_corners)[1:SIDES].T).max()
    return np.array([*(side.max() for side in across), start, apart])


@dataclass(frozen=True, eq=False)
class PublishedFigure:
    """What figure 1b shows.

    Attributes:
        points: vertices of the noisy path (m), shape (n, 2).
        corners: of the noisy path, indices of its points, shape (5,).
        perfect_corners: of the perfect path (m), shape (5, 2).
        lengths: see `measure`.
    """

    points: np.ndarray
    corners: np.ndarray
    perfect_corners: np.ndarray
    lengths: np.ndarray

    @property
    def third_side_steps(self) -> int:
        """How many steps the third side is drawn in."""
        third = self.points[self.corners[2] : self.corners[3] + 1]
        return int(np.count_nonzero(np.hypot(*np.diff(third, axis=0).T) > _LEAST_STEP))


def read_published_figure(path: Path) -> PublishedFigure:
    """Read figure 1b from a file as in the folder data.

    Raises:
        LabError: the file cannot be read or does not hold two paths around a square.
    """
    noisy, perfect = (_read_series(path, f"fig1b_{name}") for name in ("noisy", "perfect"))
    corners = perfect[find_corners(perfect)]
    return PublishedFigure(noisy, find_corners(noisy), corners, measure(noisy, corners))


def _read_series(path: Path, name: str) -> np.ndarray:
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [row for row in csv.DictReader(file) if row["series"] == name]
        points = np.array([(float(row["x_m"]), float(row["y_m"])) for row in rows])
    except OSError as error:
        raise DrawnPathError(f"cannot read {path}: {error.strerror}") from error
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise DrawnPathError(f"{path} is not a table of series,x_m,y_m") from error
    if not points.size or not np.isfinite(points).all():
        raise DrawnPathError(f"{path} has no path {name}, or one that is not finite")
    return points
