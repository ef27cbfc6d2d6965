"""How far one trajectory is from another. No alignment: both are given in the same frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.numerics.angles import wrap
from bullet_lab.numerics.trajectory import Trajectory


class MetricsError(LabError):
    """Two trajectories cannot be compared."""


@dataclass(frozen=True, eq=False)
class PathError:
    """The absolute pose error (APE) of an estimate, estimate minus reference at each stamp.

    Attributes:
        ape_rmse_m: root mean square of the distances between the two positions.
        ape_mean_m: their mean.
        ape_median_m: their median.
        ape_std_m: their standard deviation, that of a whole population as in evo.
        ape_min_m: the smallest.
        ape_max_m: the largest.
        heading_rmse_deg: root mean square of the heading errors.
        final_error_m: distance at the last stamp.
        final_heading_error_deg: heading error at the last stamp, signed, in [-180, 180).
        travelled: m, along the reference up to each stamp, shape (n,).
        error: m, distance at each stamp, shape (n,).
        heading_error: rad, signed, in [-pi, pi), at each stamp, shape (n,).
    """

    ape_rmse_m: float
    ape_mean_m: float
    ape_median_m: float
    ape_std_m: float
    ape_min_m: float
    ape_max_m: float
    heading_rmse_deg: float
    final_error_m: float
    final_heading_error_deg: float
    travelled: np.ndarray
    error: np.ndarray
    heading_error: np.ndarray


def path_error(reference: Trajectory, estimate: Trajectory) -> PathError:
    """Compare an estimate with the reference, pose by pose.

    Raises:
        MetricsError: the stamps are not exactly the same.
    """
    if not np.array_equal(reference.stamps, estimate.stamps):
        raise MetricsError("only trajectories with the same stamps can be compared")
    dx, dy, dyaw = (estimate.poses - reference.poses).T
    error, heading_error = np.hypot(dx, dy), wrap(dyaw)
    return PathError(
        ape_rmse_m=_rms(error),
        ape_mean_m=float(np.mean(error)),
        ape_median_m=float(np.median(error)),
        ape_std_m=float(np.std(error)),
        ape_min_m=float(np.min(error)),
        ape_max_m=float(np.max(error)),
        heading_rmse_deg=math.degrees(_rms(heading_error)),
        final_error_m=float(error[-1]),
        final_heading_error_deg=math.degrees(heading_error[-1]),
        travelled=reference.travelled(),
        error=error,
        heading_error=heading_error,
    )


def closure_error(trajectory: Trajectory) -> float:
    """Return the distance (m) from the first to the last position."""
    dx, dy, _ = trajectory.poses[-1] - trajectory.poses[0]
    return math.hypot(dx, dy)


def _rms(values: np.ndarray) -> float:
    return math.sqrt(np.mean(np.square(values)))
