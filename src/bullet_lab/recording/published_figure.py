"""Reading the digitised figure 1b of the report."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.numerics.side_deviation import corner_points, side_deviations, sides_between

_CORNER_REACH = 0.1  # m; the corners of figure 1b are within 0.06 m of the simulated ones
# At the end of figure 1b no blue shows beside the orange, and at the corners no more than a
# pixel; so the corners of its noisy path are those of its perfect path as well.
SEEN_AT_END = 0.0
_LEAST_STEP = 0.1  # m; shorter steps of the drawn path are at the corners


class PublishedFigureError(LabError):
    """The digitised figure cannot be read."""


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
    deviations = side_deviations(
        points[:, np.newaxis], sides[:, np.newaxis], points[indices]
    )
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
        raise PublishedFigureError(f"cannot read {path}: {error.strerror}") from error
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise PublishedFigureError(f"{path} is not a table of series,x_m,y_m") from error
    if not points.size or not np.isfinite(points).all():
        raise PublishedFigureError(f"{path} has no path {name}, or one that is not finite")
    return points
