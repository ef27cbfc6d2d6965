"""Exact second moments of a noisy path's error, pose by pose.

The module `exact_moments` derives them; here they are updated with each step.
"""

from __future__ import annotations

import math

import numpy as np


class RunningMoments:
    """Accumulates the second moments of the error, for independent Gaussian noise.

    >>> moments = RunningMoments()
    >>> moments.add(0.0, 1.0, (0.0, 0.25, 0.5))
    >>> moments.second_moments().diagonal()
    array([0.25, 0.  , 0.5 ])
    """

    def __init__(self) -> None:
        # Variance of the heading, and its value at the latest translation.
        self._turned = 0.0
        self._acted = 0.0
        self._mean = 0j
        self._spread = 0.0
        self._pseudo = 0j
        self._with_heading = 0j
        # Correlation of the translations so far with the next one, and with its conjugate.
        self._shared = 0j
        self._mirrored = 0j

    def add(self, direction: float, trans: float, variances: tuple[float, float, float]) -> None:
        """Add the next step of the perfect path.

        Args:
            direction: rad, of travel, in the frame of the path.
            trans: m, signed.
            variances: of the rotation before it (rad²), of trans (m²) and of that after it (rad²).
        """
        variance1, variance_trans, variance2 = variances
        v = self._turned + variance1
        unit = complex(math.cos(direction), math.sin(direction))
        step, square = trans * unit, trans * trans
        faded, lost = math.exp(-0.5 * v), math.expm1(-v)

        self._shared *= math.exp(-0.5 * (v - self._acted))
        self._spread += variance_trans - square * lost + 2.0 * (step * self._shared).real
        own = variance_trans * faded**4 + square * faded**2 * lost
        self._pseudo += unit * unit * own + 2.0 * step * faded * self._mirrored
        self._with_heading += 1j * v * faded * step
        self._mean += step * math.expm1(-0.5 * v)
        self._shared -= step.conjugate() * lost
        self._mirrored += step * faded * lost
        self._acted, self._turned = v, v + variance2

    def second_moments(self) -> np.ndarray:
        """Return E(e e') of the error e = noisy - perfect, (x, y, yaw), shape (3, 3), read-only.

        It is about the perfect pose, not about the mean of the noisy ones: covariance plus the
        square of the bias. Units are m and rad, the frame is that of the directions.
        """
        size = self._spread + abs(self._mean) ** 2
        pseudo = self._pseudo + self._mean * self._mean
        xx, yy, xy = 0.5 * (size + pseudo.real), 0.5 * (size - pseudo.real), 0.5 * pseudo.imag
        xt, yt = self._with_heading.real, self._with_heading.imag
        matrix = np.array(((xx, xy, xt), (xy, yy, yt), (xt, yt, self._turned)))
        matrix.setflags(write=False)
        return matrix
