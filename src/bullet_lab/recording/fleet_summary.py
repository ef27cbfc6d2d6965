"""What the squares of a fleet come down to, for summary.json."""

from __future__ import annotations

from typing import Any, Dict, Mapping, Sequence

import numpy as np

# Of each robot, and in the mean over all of them.
ERRORS = ("final_error_m", "final_heading_error_deg", "ape_rmse_m")


def fleet_summary(robots: Sequence[Mapping[str, Any]]) -> Dict[str, Any]:
    """Return the figures of a fleet.

    Args:
        robots: of each, its name, its seed and what `squares_summary` says of it.

    Returns:
        They, and root mean squares and the largest of their errors; null where a robot has none.
    """
    values: Dict[str, Any] = {}
    for name in ERRORS:
        errors = [robot[name] for robot in robots]
        complete = bool(errors) and None not in errors
        values[f"{name}_rms"] = float(np.sqrt(np.mean(np.square(errors)))) if complete else None
        values[f"{name}_largest"] = float(np.max(np.abs(errors))) if complete else None
    return {**values, "robots": [dict(robot) for robot in robots]}
