"""scripts/soak.sh tells growth from what comes and goes."""

import math
import mmap
import os
import time

import numpy as np
import psutil
import pytest
from shared import cases, module_of

slope = module_of("soak/slope.py").slope
memory_of = module_of("soak/lab.py").memory_of


def sawtooth(random, rise, segments):
    """Four hours of models that come and go: an autoregression of two minutes, on a rise."""
    each = 1440 // segments
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


@cases("segments, rise: [[1, 0.0], [2, 3.0]]")
def test_the_interval_holds_the_rise(rise, segments):
    random = np.random.default_rng(3)
    found = [slope(*sawtooth(random, rise, segments)) for _ in range(300)]
    held = sum(one.low <= rise <= one.high for one in found)
    # 95 % of 300 are 285, with a standard deviation of 3.8; some correlation is left.
    assert 268 <= held <= 297
    assert np.mean([one.value for one in found]) == pytest.approx(rise, abs=0.2)


def test_samples_of_a_node_at_work_widen_no_interval():
    hours = np.linspace(0.0, 4.0, 60)
    values = 60.0 + 0.3 * hours + np.random.default_rng(4).normal(0.0, 0.02, 60)
    alone = slope(hours, values, np.zeros(60))
    values[[21, 34, 58]] += (6.0, 28.0, 2.0)
    found = slope(hours, values, np.zeros(60))
    assert found.value == pytest.approx(alone.value, abs=0.03)
    assert found.high - found.low < 0.1


@pytest.mark.parametrize("hours", [np.arange(10.0), np.linspace(0.0, 0.2, 1000)])
def test_too_few_samples_tell_nothing(hours):
    assert math.isnan(slope(hours, hours, np.zeros(len(hours))).value)


def test_memory_is_what_a_process_has_of_its_own_and_no_files(tmp_path):
    """Such pages count as its own until another process has them, too."""
    path, size, process = tmp_path / "library", 32 * 2**20, psutil.Process()
    path.touch()
    os.truncate(path, size)
    before = memory_of(process)
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ) as pages:
        assert not any(pages[k] for k in range(0, size, mmap.PAGESIZE))
        assert abs(memory_of(process) - before) < 8.0
    # From the system itself: the heap may have as much left of what was there before.
    with mmap.mmap(-1, size, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS) as kept:
        for place in range(0, size, mmap.PAGESIZE):
            kept[place] = 1
        assert memory_of(process) - before == pytest.approx(size / 2**20, abs=8.0)


def test_what_has_ended_has_no_memory():
    child = psutil.Popen(["true"])
    while child.status() != psutil.STATUS_ZOMBIE:
        time.sleep(0.01)
    assert memory_of(child) == 0.0
    child.wait()
