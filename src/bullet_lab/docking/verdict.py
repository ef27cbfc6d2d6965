"""Verdict on a docking by the truth: docked means within the dock's own tolerance."""

from __future__ import annotations

import math
from typing import Dict, Mapping, Sequence

import numpy as np

from bullet_lab.core import se2
from bullet_lab.docking.database import DockTolerance
from bullet_lab.docking.types import DockingError

ERRORS = ("distance_error_m", "lateral_error_m", "yaw_error_deg")

DOCKED, WALL_CONTACT, INACCURATE = "docked", "wall_contact", "inaccurate"
"""Verdicts, besides the names of docking's errors in small letters."""


def docking_errors(
    robot: Sequence[float], dock: Sequence[float], camera_ahead: float, docked_distance: float
) -> Dict[str, float]:
    """Return how far a robot (m, m, rad) is from where it should stand in a dock.

    Args:
        robot: its true pose.
        dock: true pose (m, m, rad) of the floor below the marker's face.
        camera_ahead: m, of the camera from the robot's middle.
        docked_distance: m, from the camera to the marker's face in a docked robot.

    Returns:
        By `ERRORS`: positive for too far away, for a robot to the left of the axis, and for one
        turned to the left.
    """
    x, y, yaw = se2.between(np.asarray(dock, dtype=float), np.asarray(robot, dtype=float))
    camera = x + camera_ahead * math.cos(yaw)
    return dict(zip(ERRORS, (float(-camera - docked_distance), float(y), math.degrees(yaw))))


def largest_errors(tolerance: DockTolerance) -> Dict[str, float]:
    """Return a tolerance by `ERRORS`, in their units."""
    return dict(zip(ERRORS, (tolerance.distance, tolerance.lateral, math.degrees(tolerance.yaw))))


def judge(
    reported: DockingError, errors: Mapping[str, float], tolerance: DockTolerance, contacts: int
) -> str:
    """Return DOCKED, or what went wrong in one word.

    A docking is a success if the robot reports it (NONE), is right, and has touched nothing.

    >>> tolerance = DockTolerance(0.005, 0.003, 0.007)
    >>> judge(DockingError.NONE, dict(zip(ERRORS, (0.0, -0.0031, 0.0))), tolerance, 0)
    'inaccurate'
    """
    if contacts:
        return WALL_CONTACT
    if reported != DockingError.NONE:
        return reported.name.lower()
    most = largest_errors(tolerance)
    return DOCKED if all(abs(errors[name]) <= most[name] for name in ERRORS) else INACCURATE
