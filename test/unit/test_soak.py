"""scripts/soak.sh tells growth from what comes and goes."""

import math

import numpy as np
import pytest
from conftest import module_of

slope = module_of("soak/slope.py").slope


def sawtooth(random, hours, rise, segments=1):
    """Models that come and go: an autoregression of two minutes, on top of a steady rise."""
    each = round(hours * 360 / segments)
    found = []
    for segment in range(segments):
        noise = random.normal(0.0, 1.0, each)
        for k in range(1, each):
            noise[k] += 0.9 * noise[k - 1]
        at = (segment * each + np.arange(each)) / 360
        # Each segment begins anew, with a warm-up of its own.
        level = 100.0 + 50.0 * (1.0 - np.exp(-np.arange(each) / (0.02 * each)))
        found.append((at, level + noise + rise * (at - at[0]), np.full(each, segment)))
    return map(np.concatenate, zip(*found))


@pytest.mark.parametrize("segments", [1, 2])
@pytest.mark.parametrize("rise", [0.0, 3.0])
def test_the_interval_holds_the_rise(rise, segments):
    random = np.random.default_rng(3)
    found = [slope(*sawtooth(random, 4.0, rise, segments)) for _ in range(300)]
    held = sum(one.low <= rise <= one.high for one in found)
    # 95 % of 300 are 285, with a standard deviation of 3.8; some correlation is left.
    assert 268 <= held <= 297
    assert np.mean([one.value for one in found]) == pytest.approx(rise, abs=0.2)


@pytest.mark.parametrize("hours", [np.arange(10.0), np.linspace(0.0, 0.2, 1000)])
def test_too_few_samples_tell_nothing(hours):
    assert math.isnan(slope(hours, hours, np.zeros(len(hours))).value)
