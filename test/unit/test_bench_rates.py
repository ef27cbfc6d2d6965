"""The bounds in scripts/bench.sh detectors know that crops of one photograph belong together."""

import pytest
from shared import module_of

rate_of = module_of("bench/detectors/rates.py").rate_of


def test_none_in_many_crops_of_few_photographs_says_little_about_photographs():
    rate = rate_of([0] * 30, [2000] * 30)
    assert (rate.rate, rate.low, rate.high) == (0.0, 0.0, 0.0)
    # The rule of three, and what 30 photographs allow.
    assert rate.independent == pytest.approx(3.0 / 60_000, rel=0.01)
    assert rate.photographs_high == pytest.approx(1.0 - 0.05 ** (1 / 30))


def test_false_crops_of_one_photograph_spread_the_bounds():
    together = rate_of([60] + [0] * 29, [100] * 30)
    apart = rate_of([2] * 30, [100] * 30)
    assert together.rate == apart.rate == 0.02
    assert (apart.low, apart.high) == (0.02, 0.02)
    assert together.low == 0.0 and together.high > 0.05
