"""The confidence interval of a share."""

from __future__ import annotations

from typing import Tuple

from scipy.special import betaincinv


def clopper_pearson(hits: int, trials: int, tail: float) -> Tuple[float, float]:
    """Return Clopper and Pearson's interval of the probability of a hit.

    Each end is the probability for which at least so many hits, or at most so many, have the
    probability `tail`: a quantile of the beta distribution. The true probability, whatever its
    value, is beyond an end in at most that share of all experiments.
    (C. J. Clopper and E. S. Pearson, Biometrika 26, 1934.)

    >>> [round(end, 3) for end in clopper_pearson(95, 100, 0.025)]
    [0.887, 0.984]
    """
    low = betaincinv(hits, trials - hits + 1, tail) if hits else 0.0
    high = betaincinv(hits + 1, trials - hits, 1.0 - tail) if hits < trials else 1.0
    return float(low), float(high)
