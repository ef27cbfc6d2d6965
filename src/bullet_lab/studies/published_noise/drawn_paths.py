"""Paths around a square as the report's plot draws them, and the lengths read from the plot.

Figure 1b and the replays are treated alike: the plot draws a path, its vertices are read, its
corners are found among them, and lengths are measured from the drawing only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import path as drawing

from bullet_lab.core.trajectory import finite_numbers
from bullet_lab.errors import LabError
from bullet_lab.studies.paths import read_table

SIDES = 4

LENGTHS = (*(f"side{side}" for side in range(1, SIDES + 1)), "start", "corners")
"""Names of the lengths that `measure` returns, in this order."""

# Points of 1/72 inch per metre along x and y of figure 1b, by its axes. matplotlib leaves out
# vertices that are less than 1/9 of a point beside the line: 0.7 mm in x, 0.9 mm in y.
_POINTS_PER_METRE = (170.6, 122.9)
_STRAIGHT = 1.0 / 9.0

_MOST_CANDIDATES = 100
_LEAST_STEP = 0.1  # m; shorter steps of the drawn path are at the corners
_COLUMNS = ("series", "x_m", "y_m")


class DrawnPathError(LabError):
    """A path has no square, or the digitised figure lacks a path."""


def drawn(points) -> np.ndarray:
    """Return the vertices that matplotlib draws of a path on the axes of figure 1b.

    Args:
        points: x and y (m), shape (n, 2).

    Returns:
        m, shape (k, 2), without those that lie on a line with their neighbours, as in the vector
        graphic of the report; some are duplicates.

    >>> drawn([(0, 0), (0.5, 0.0002), (1, 0), (1, 0.5), (1, 1)]).round(3).tolist()
    [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 1.0]]
    """
    path = drawing.Path(np.asarray(points, dtype=float) * _POINTS_PER_METRE)
    path.simplify_threshold = _STRAIGHT
    # The last vertex only marks the end of the path.
    return path.cleaned(simplify=True).vertices[:-1] / _POINTS_PER_METRE


def find_corners(vertices) -> np.ndarray:
    """Find the corners of a drawn path around a square.

    The first and the last vertex and three others make four sides. The three are those with the
    smallest sum of distances of all vertices from the lines of their sides. (With a sum of squares,
    a zigzag on one side would move the corners of its neighbours.) Of a path of more than 100
    vertices, whose sides are not straight anyway, 100 are candidates.

    Args:
        vertices: x and y (m) in the order driven, shape (n, 2).

    Returns:
        Indices of the vertices, shape (5,), from the first to the last.

    Raises:
        DrawnPathError: the path has no four sides.

    >>> find_corners([(0, 0), (1, 0.1), (2, 0), (2, -2), (1, -2), (0, -2), (0, 0)]).tolist()
    [0, 2, 3, 5, 6]
    """
    vertices = np.asarray(vertices, dtype=float)
    count = min(len(vertices), _MOST_CANDIDATES)
    candidates = np.linspace(0, len(vertices) - 1, count).astype(int)
    distances = _distances_beside_lines(vertices[candidates])
    least, choices = distances[0], []
    for _ in range(SIDES - 1):
        sums = least[:, np.newaxis] + distances
        choices.append(sums.argmin(axis=0))
        least = sums.min(axis=0)
    if not np.isfinite(least[-1]):
        raise DrawnPathError("the path has no four sides")
    corners = [len(distances) - 1]
    for choice in reversed(choices):
        corners.append(int(choice[corners[-1]]))
    return candidates[[0, *reversed(corners)]]


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

    - `side1` to `side4`: the largest distance from the line of each side.
    - `start`: the same within the first half of the first side.
    - `corners`: the largest distance of the corners 1 to 3 from those of the perfect path in the
      same figure.

    Args:
        vertices: of the noisy path (m), shape (n, 2).
        perfect_corners: m, shape (5, 2).

    Raises:
        DrawnPathError: the path has no four sides.
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
    """Digitised figure 1b.

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
        """Number of steps of the third side."""
        third = self.points[self.corners[2] : self.corners[3] + 1]
        return int(np.count_nonzero(np.hypot(*np.diff(third, axis=0).T) > _LEAST_STEP))


def read_published_figure(path: Path) -> PublishedFigure:
    """Read figure 1b from a CSV file.

    Raises:
        LabError: the file cannot be read or does not hold two paths around a square.
    """
    noisy, perfect = (_read_series(path, f"fig1b_{name}") for name in ("noisy", "perfect"))
    corners = perfect[find_corners(perfect)]
    return PublishedFigure(noisy, find_corners(noisy), corners, measure(noisy, corners))


def _read_series(path: Path, name: str) -> np.ndarray:
    _, rows = read_table(path, _COLUMNS)
    points = [
        finite_numbers([row["x_m"], row["y_m"]], where)
        for where, row in rows
        if row["series"] == name
    ]
    if not points:
        raise DrawnPathError(f"{path} has no path {name}")
    return np.array(points)
