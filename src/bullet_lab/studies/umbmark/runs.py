"""A square that was driven by odometry, and where the robot was when the odometry was back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Sequence

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.se2 import PlanarPose, wrap
from bullet_lab.errors import LabError

CLOCKWISE, COUNTER_CLOCKWISE = "cw", "ccw"
DIRECTIONS = (CLOCKWISE, COUNTER_CLOCKWISE)
# m; no robot of wheels drives a square farther away, and sums of squares stay finite.
FARTHEST = 1e6


class RunError(LabError):
    """What is recorded is no square that was driven by odometry."""


@dataclass(frozen=True, eq=False)
class Run:
    """One square, from its start to where the odometry was back.

    Attributes:
        name: of it, for people.
        odometry: what was reported on the way: x (m), y (m) and yaw (rad), shape (n, 3).
        start: where the robot really was at the first of these poses, in any frame.
        end: where it really was at the last.

    Raises:
        RunError: the odometry does not turn once about itself.
    """

    name: str
    odometry: np.ndarray
    start: PlanarPose
    end: PlanarPose

    def __post_init__(self) -> None:
        """Refuse what is no square."""
        if len(self.odometry) < 2 or not np.isfinite(self.odometry).all():
            raise RunError(f"{self.name}: there is no odometry of a square")
        largest = max(np.abs(self.odometry).max(), *map(abs, (*self.start, *self.end)))
        if largest > FARTHEST:
            raise RunError(
                f"{self.name}: {largest:g} is out of range: positions are in m, angles in rad, "
                f"and at most {FARTHEST:g}"
            )
        turned = abs(self.turned())
        if not 0.75 < turned / (2.0 * np.pi) < 1.25:
            raise RunError(
                f"{self.name}: the odometry turns by {np.degrees(turned):.0f}°, not once round, "
                "as on a square with the turn after its last side"
            )

    def turned(self) -> float:
        """Return the heading that the odometry gains, rad, counter-clockwise > 0."""
        return float(self.steps()[:, 2].sum())

    @property
    def direction(self) -> str:
        """One of `DIRECTIONS`."""
        return COUNTER_CLOCKWISE if self.turned() > 0.0 else CLOCKWISE

    def steps(self) -> np.ndarray:
        """Return the reported steps (dx m, dy m, dyaw rad), shape (n - 1, 3)."""
        return se2.steps(self.odometry)

    def side(self) -> float:
        """Return the length (m) of a side as reported: a quarter of the way."""
        return float(np.hypot(*np.diff(self.odometry[:, :2], axis=0).T).sum() / 4.0)

    def moved(self) -> np.ndarray:
        """Return the true end as seen from the true start: (m, m, rad)."""
        return se2.between(self.start, self.end)

    def return_error(self) -> np.ndarray:
        """Return true minus reported end (m, m, rad), x ahead and y to the left at the start."""
        error = self.moved() - se2.between(self.odometry[0], self.odometry[-1])
        error[2] = wrap(float(error[2]))
        return error


def return_errors(runs: Sequence[Run], direction: str) -> np.ndarray:
    """Return the return errors of the runs in a direction, shape (n, 3)."""
    errors: List[np.ndarray] = [run.return_error() for run in runs if run.direction == direction]
    return np.array(errors).reshape(-1, 3)
