"""Deviations of a path around a square from each of its sides, and those in figure 1b."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bullet_lab.errors import LabError

SIDES = 4
# At the end of figure 1b no blue shows beside the orange, and at the corners no more than a
# pixel; so the corners of its noisy path are those of its perfect path as well.
SEEN_AT_END = 0.0
_CORNER_REACH = 0.1  # m; the corners of figure 1b are within 0.06 m of the simulated ones
_LEAST_STEP = 0.1  # m; shorter steps of the drawn path are at the corners


class SideError(LabError):
    """The sides of a path cannot be told, or the digitised figure cannot be read."""


def side_deviations(points, sides, corners) -> np.ndarray:
    """Return the largest distance of m paths from the line that each side lies on.

    Only distances across count: a path may be ahead of itself, or behind, without straying.

    Args:
        points: x and y (m), shape (n, m, 2).
        sides: 0 to 3, or another number for no side, for each point, shape (n, m) or (n, 1).
        corners: where the perfect sides start, and where the last one ends (m), shape (5, 2).

    Returns:
        m, shape (m, 4).

    Raises:
        SideError: a path has no point on some side, or two corners in a row are one.
    """
    points, corners = np.asarray(points, dtype=float), np.asarray(corners, dtype=float)
    along = np.diff(corners, axis=0)
    lengths = np.hypot(along[:, 0], along[:, 1])
    if corners.shape != (SIDES + 1, 2) or not (lengths > 0.0).all():
        raise SideError("five corners, each at another place than the one before, are needed")
    deviations = np.empty((points.shape[1], SIDES))
    for side in range(SIDES):
        (corner_x, corner_y), (ahead_x, ahead_y) = corners[side], along[side] / lengths[side]
        is_on = np.asarray(sides) == side
        if not is_on.any(axis=0).all():
            raise SideError(f"there is no point on side {side + 1}")
        x, y = points[..., 0] - corner_x, points[..., 1] - corner_y
        across = np.abs(y * ahead_x - x * ahead_y)
        deviations[:, side] = np.where(is_on, across, 0.0).max(axis=0)
    return deviations


def corner_points(points, near, reach: float) -> np.ndarray:
    """Find the corners of a drawn path, whose times nobody knows.

    A corner is the last point before the path leaves it.

    Args:
        points: x and y (m) in the order driven, shape (n, 2).
        near: where about the start and the four corners are (m), shape (5, 2).
        reach: m, how far off that may be.

    Returns:
        Indices of the points, shape (5,); the first is 0.

    Raises:
        SideError: the path passes them by, or not in this order.
    """
    points = np.asarray(points, dtype=float)
    found = [0]
    for number, corner in enumerate(np.asarray(near, dtype=float)[1:], start=1):
        is_near = np.hypot(*(points - corner).T) <= reach
        is_near[: found[-1] + 1] = False
        first = int(np.argmax(is_near))
        if not is_near[first]:
            raise SideError(f"the path does not pass corner {number}")
        gone = np.flatnonzero(~is_near[first:])
        found.append(first + int(gone[0]) - 1 if gone.size else len(points) - 1)
    return np.array(found)


def sides_between(corners, count: int) -> np.ndarray:
    """Return the side, 0 to 3, of each of the points of a drawn path, from its `corner_points`.

    As in a run, the corner and all that happens there belong to the side that ends there.
    """
    return np.clip(np.searchsorted(corners, np.arange(count)) - 1, 0, SIDES - 1)


@dataclass(frozen=True, eq=False)
class PublishedFigure:
    """What figure 1b shows.

    Attributes:
        points: of the noisy path (m), shape (n, 2).
        corners: five of them (m), shape (5, 2); the perfect path joins them.
        deviations: m, of the noisy path from the perfect one: the largest on each side, and the
            distance at the end, which is 0 as far as can be seen; shape (5,).
        third_side_steps: how many steps the third side is drawn in.
    """

    points: np.ndarray
    corners: np.ndarray
    deviations: np.ndarray
    third_side_steps: int


def read_published_figure(path: Path, corners) -> PublishedFigure:
    """Read figure 1b from a file as in the folder data.

    Args:
        path: of the file.
        corners: of the simulated square (m), shape (5, 2), near which its own are looked for.

    Raises:
        LabError: the file cannot be read or does not hold a path around that square.
    """
    points = _read_series(path, "fig1b_noisy")
    indices = corner_points(points, corners, _CORNER_REACH)
    sides = sides_between(indices, len(points))
    deviations = side_deviations(points[:, np.newaxis], sides[:, np.newaxis], points[indices])
    third = points[indices[2] : indices[3] + 1]
    steps = np.hypot(*np.diff(third, axis=0).T)
    return PublishedFigure(
        points,
        points[indices],
        np.append(deviations[0], SEEN_AT_END),
        int(np.count_nonzero(steps > _LEAST_STEP)),
    )


def _read_series(path: Path, name: str) -> np.ndarray:
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [row for row in csv.DictReader(file) if row["series"] == name]
        points = np.array([(float(row["x_m"]), float(row["y_m"])) for row in rows])
    except OSError as error:
        raise SideError(f"cannot read {path}: {error.strerror}") from error
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise SideError(f"{path} is not a table of series,x_m,y_m") from error
    if not points.size or not np.isfinite(points).all():
        raise SideError(f"{path} has no path {name}, or one that is not finite")
    return points
