"""What is known of the errors of a noisy path without drawing one, and where it can be trusted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional

import numpy as np

from bullet_lab.noise.exact_moments import (
    Moments,
    exact_moments,
    first_order_moments,
    quadratic_covariances,
    quadratic_shares,
)
from bullet_lab.noise.noisy_paths import NoisySteps
from bullet_lab.noise.odometry_noise import NoiseRule, model_named

FIRST_ORDER_SHARE, GAUSSIAN_SHARE = 0.05, 0.1
"""Of the variance that is quadratic in the noise; see `Theory`."""

_SINGULAR = 1e-12


def level_rule(model: str, std: float) -> NoiseRule:
    """Return the rule of a model at a level of noise; raises NoiseError."""
    return model_named(model).at_level(std)


@dataclass(frozen=True, eq=False)
class Theory:
    """What is known of the pose errors without drawing a path.

    Whether an error is Gaussian enough is decided by `quadratic_share`, the largest share of the
    variance in any direction of (x, y, heading) that is quadratic in the noise. It is worked out
    in closed form, before any path is drawn. What it means was measured: up to `GAUSSIAN_SHARE` the
    published 95 % regions, of the position and of all three coordinates, hold 95 ± 1 %, up to
    `FIRST_ORDER_SHARE` those of first order do.

    Attributes:
        exact: the exact moments at each pose.
        first_order: those to first order.
        quadratic: covariance of what is quadratic in the noise, at each pose, (n+1, 3, 3).
    """

    exact: Moments
    first_order: Moments
    quadratic: np.ndarray

    def shift(self) -> float:
        """Return how far first order misses the mean at the end, in its standard deviations.

        This is the Mahalanobis length, in the position, of the exact bias; 0 without noise.
        """
        bias, inverse = self.exact.mean[-1, :2], inverse_of(position_of(self.first_order))
        return 0.0 if inverse is None else math.sqrt(float(bias @ inverse @ bias))

    def area_ratio(self) -> float:
        """Return the area of the first-order ellipse at the end over that of the exact one."""
        first, exact = (np.linalg.det(position_of(m)) for m in (self.first_order, self.exact))
        return math.sqrt(max(first, 0.0) / exact) if exact > 0.0 else 1.0

    def quadratic_share(self, pose: int = -1) -> float:
        """Return which share of the variance at a pose is quadratic in the noise, at most."""
        return float(quadratic_shares(self.quadratic[pose], self.exact.covariance[pose]))

    def gaussian_enough(self, pose: int = -1) -> bool:
        """Return whether a Gaussian in x, y and heading with the exact moments is good enough."""
        return self.quadratic_share(pose) <= GAUSSIAN_SHARE

    def first_order_enough(self, pose: int = -1) -> bool:
        """Return whether one with the covariance to first order, and without bias, is."""
        return self.quadratic_share(pose) <= FIRST_ORDER_SHARE


def theory(steps: NoisySteps) -> Theory:
    """Return what is known of the noisy versions of a path."""
    return Theory(exact_moments(steps), first_order_moments(steps), quadratic_covariances(steps))


def position_of(moments: Moments) -> np.ndarray:
    """Return the covariance (m²) of the last position."""
    return moments.covariance[-1, :2, :2]


def inverse_of(covariance: np.ndarray) -> Optional[np.ndarray]:
    """Return the inverse of a covariance, None where that is lost in rounding."""
    scale = np.sqrt(np.abs(np.diag(covariance)))
    if (scale == 0.0).any():
        return None
    correlation = covariance / np.outer(scale, scale)
    if np.linalg.eigvalsh(correlation)[0] < _SINGULAR:
        return None
    return np.linalg.inv(correlation) / np.outer(scale, scale)
