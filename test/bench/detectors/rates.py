"""Bounds of a rate of false detections, where crops of one photograph belong together."""

from typing import NamedTuple

import numpy as np

from bullet_lab.studies.study import clopper_pearson

CONFIDENCE = 0.95
_DRAWS = 4000


class Rate(NamedTuple):
    """A rate for each crop, and its bounds at 95 %.

    Attributes:
        rate: false detections' share of the crops.
        low: of the bootstrap that draws whole photographs.
        high: likewise; where there is no false detection at all, it cannot say.
        independent: upper bound as if each crop were a photograph of its own.
        photographs_high: upper bound of the share of photographs that have a false detection.
    """

    rate: float
    low: float
    high: float
    independent: float
    photographs_high: float


def rate_of(false, crops):
    """Return the rate and its bounds from false crops and crops of each photograph.

    >>> rate_of([0] * 30, [1000] * 30).independent < 1.3e-4
    True
    >>> round(rate_of([0] * 30, [1000] * 30).photographs_high, 3)
    0.116
    >>> rate_of([30, 0, 0], [100, 100, 100]).high
    0.3
    """
    wrong, of = np.asarray(false, dtype=float), np.asarray(crops, dtype=float)
    drawn = np.random.default_rng(0).integers(len(of), size=(_DRAWS, len(of)))
    rates = wrong[drawn].sum(axis=1) / of[drawn].sum(axis=1)
    low, high = np.quantile(rates, (0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE))
    total, bad = int(wrong.sum()), int((wrong > 0).sum())
    every = int(of.sum())
    of_crops, of_photographs = (
        clopper_pearson(hits, trials, 1.0 - CONFIDENCE)[1]
        for hits, trials in ((total, every), (bad, len(of)))
    )
    return Rate(total / every, float(low), float(high), of_crops, of_photographs)
