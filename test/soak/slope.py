"""Does something grow? A slope with its interval, from samples that are alike when near."""

import math
from typing import NamedTuple

import numpy as np
from scipy import stats

WARM_UP = 0.25
"""Part of a segment that is left out at its beginning, while caches fill and libraries load."""

SHORTEST = 0.25
"""Hours of a segment; shorter ones tell nothing of an hour."""

BLOCKS = 12
CONFIDENCE = 0.95


class Slope(NamedTuple):
    """A slope and the ends of its confidence interval; NaN where there are too few samples."""

    value: float
    low: float
    high: float


def slope(hours, values, segments):
    """Return how much values grow in an hour, alike in all segments, each with a level of its own.

    The first quarter of each segment is left out, and so are short segments. Samples near each
    other are alike, for what comes stays a while: so twelve blocks of each segment are taken, and
    least squares and Student's distribution are for those. A block has the median of its samples,
    as there are some in which a node was still at work: of a few MB more, for one sample.

    >>> hours = np.linspace(0.0, 4.0, 1000)
    >>> slope(hours, 50.0 + 3.0 * hours, np.zeros(1000)).value.round(6)
    3.0
    """
    hours, values = np.asarray(hours, dtype=float), np.asarray(values, dtype=float)
    x, y = [], []
    count = 0
    for segment in np.unique(segments):
        of = np.flatnonzero(np.asarray(segments) == segment)
        begin, end = hours[of[0]], hours[of[-1]]
        of = of[hours[of] >= begin + WARM_UP * (end - begin)]
        if end - begin < SHORTEST or len(of) < BLOCKS:
            continue
        count += 1
        blocks = np.array_split(of, BLOCKS)
        for found, of_all in ((hours, x), (values, y)):
            medians = np.array([np.median(found[block]) for block in blocks])
            of_all.extend(medians - medians.mean())
    if not count:
        return Slope(math.nan, math.nan, math.nan)
    t, v = np.array(x), np.array(y)
    value = float(t @ v / (t @ t))
    freedom = len(t) - count - 1
    deviation = math.sqrt(float(np.sum((v - value * t) ** 2)) / freedom / float(t @ t))
    half = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, freedom)) * deviation
    return Slope(value, value - half, value + half)
