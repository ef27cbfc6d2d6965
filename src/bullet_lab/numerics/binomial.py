"""How far a share that was counted can be trusted."""

from __future__ import annotations

import math

import numpy as np

from bullet_lab.errors import LabError

# Each halves the interval; after these a double has no digits left.
_HALVINGS = 1100


class BinomialError(LabError):
    """Counts that cannot be."""


def lower_bound(successes: int, trials: int, confidence: float = 0.95) -> float:
    """Return Clopper and Pearson's one-sided lower bound of a probability of success.

    It is the p for which so many successes or more have the probability 1 - confidence; the
    true probability lies above it in at least that share of all experiments, whatever it is.
    (C. J. Clopper and E. S. Pearson, Biometrika 26, 1934. Without a failure it is
    (1 - confidence)^(1 / trials), some 1 - 3 / trials at 95 %.)

    Raises:
        BinomialError: not 0 <= successes <= trials, no trials, or a confidence beyond (0, 1).
    """
    if not 0 <= successes <= trials or trials < 1:
        raise BinomialError(f"{successes} successes of {trials}")
    if not 0.0 < confidence < 1.0:
        raise BinomialError(f"a confidence of {confidence:g} is not between 0 and 1")
    if successes == 0:
        return 0.0
    low, high = 0.0, successes / trials
    tail = _Tail(successes, trials)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        if tail.probability(middle) < 1.0 - confidence:
            low = middle
        else:
            high = middle
    return low


class _Tail:
    """The probability of so many successes or more."""

    def __init__(self, successes: int, trials: int):
        counts = range(successes, trials + 1)
        self._counts = np.array(counts, dtype=float)
        self._rest = trials - self._counts
        self._ways = np.array(
            [
                math.lgamma(trials + 1) - math.lgamma(k + 1) - math.lgamma(trials - k + 1)
                for k in counts
            ]
        )

    def probability(self, p: float) -> float:
        """Return it for a probability of success 0 < p < 1."""
        logs = self._ways + self._counts * math.log(p) + self._rest * math.log1p(-p)
        return float(np.exp(logs).sum())
