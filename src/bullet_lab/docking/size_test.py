"""Tells a marker from a copy of another size by how its range changes as the robot moves.

Taken for the real one, a copy twice as large seems half as far away; but then the robot has to go
two metres to come one metre nearer. This compares changes of the seeming range with what was
travelled towards the marker, over ways long enough for the noise of both to matter little.
"""

from __future__ import annotations

import math

import numpy as np

SCALES = np.array([1.0, 0.35, 0.45, 0.6, 0.8, 1.25, 1.6, 2.1, 2.8, 3.7, 5.0, 6.5, 8.5, 11.0])
"""Sizes that are thought possible, as multiples of the marker's; the first is the real one."""

_WINDOW = 0.22
# The sizes stand for all that lie between them; the real one is known well.
_PLAY = np.where(SCALES == 1.0, 0.01, 0.08)
_ODOMETRY_SCALE = 0.02
_BEARING = 0.03


class SizeTest:
    """Log-likelihoods of the sizes.

    Args:
        reach: seeming range at the start, m.
        deviation: standard deviation of it.
    """

    def __init__(self, reach: float, deviation: float):
        self.logs = np.zeros(len(SCALES))
        self._restart(reach, deviation)
        self._unseen = 0.0

    def travel(self, away: float, beside: float, variance: float) -> None:
        """Take note of a step: m away from the marker, m across, and the variance of the first."""
        self._away += away
        self._variance += variance + (_BEARING * beside) ** 2
        self._unseen += math.hypot(away, beside)

    def see(self, reach: float, deviation: float) -> None:
        """Take note of a seeming range (m) and its standard deviation."""
        unseen, self._unseen = self._unseen, 0.0
        if unseen > 0.8:
            self._restart(reach, deviation)
            return
        change = reach - self._reach
        if max(abs(self._away), abs(change)) < max(_WINDOW, 6.0 * (deviation + self._deviation)):
            return
        expected = SCALES * change
        variance = (
            self._variance
            + SCALES**2 * (deviation**2 + self._deviation**2)
            + (_ODOMETRY_SCALE * self._away) ** 2
            + (_PLAY * expected) ** 2
            + 1e-6
        )
        square = (self._away - expected) ** 2 / variance
        # No single comparison decides.
        logs = -0.5 * square - 0.5 * np.log(variance)
        self.logs += np.maximum(logs - np.max(logs), -8.0)
        self._restart(reach, deviation)

    def _restart(self, reach: float, deviation: float) -> None:
        self._reach, self._deviation = reach, deviation
        self._away = self._variance = 0.0
