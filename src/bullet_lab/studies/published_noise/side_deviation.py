"""How far a path around a square strays from each of the four sides."""

from __future__ import annotations

import numpy as np

from bullet_lab.errors import LabError

SIDES = 4
NO_SIDE = -1
"""The label of points that belong to no side, such as those before the start."""


class SideError(LabError):
    """The sides of a path cannot be told."""


def side_deviations(points, sides, corners) -> np.ndarray:
    """Return the largest distance of m paths from the line that each side lies on.

    Only distances across count: a path may be ahead of itself, or behind, without straying.

    Args:
        points: x and y (m), shape (n, m, 2).
        sides: 0 to 3, or `NO_SIDE`, for each point, shape (n, m) or (n, 1).
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
    for side, (corner, (ahead_x, ahead_y)) in enumerate(
        zip(corners, along / lengths[:, np.newaxis])
    ):
        is_on = np.asarray(sides) == side
        if not is_on.any(axis=0).all():
            raise SideError(f"there is no point on side {side + 1}")
        x, y = points[..., 0] - corner[0], points[..., 1] - corner[1]
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
    """Return the side that each point of a drawn path belongs to.

    As in a run, the corner and all that happens there belong to the side that ends there.

    Args:
        corners: of `corner_points`.
        count: of the points of the path.

    Returns:
        0 to 3, shape (count,).
    """
    return np.clip(np.searchsorted(corners, np.arange(count)) - 1, 0, SIDES - 1)
