import math

import pytest

from bullet_lab.ros.bridge.stepper import Pace


@pytest.mark.parametrize("factor", [0.005, 0.5, 3.0])
def test_simulated_time_follows_the_wall_clock(clock, factor):
    pace, begin = Pace(factor, clock), clock.now
    assert not pace.free
    step = 0
    for _ in range(500):
        clock.now += 0.02
        step = max(step, pace.due(step))
        assert step == pytest.approx((clock.now - begin) * 1000 * factor, abs=1.0)


def test_as_fast_as_it_goes(clock):
    pace = Pace(0.0, clock)
    assert pace.free
    assert pace.due(12) == math.inf
    assert pace.seconds_until(12) == 0.0


def test_how_long_to_wait(clock):
    pace = Pace(2.0, clock)
    assert pace.seconds_until(100) == pytest.approx(0.05)
    clock.now += 0.04
    assert pace.seconds_until(100) == pytest.approx(0.01)
    clock.now += 1.0
    assert pace.seconds_until(100) == 0.0


def test_a_restart_forgets_a_pause(clock):
    pace = Pace(1.0, clock)
    clock.now += 10.0
    pace.restart(500)
    assert pace.due(500) == 500
    clock.now += 0.0205
    assert pace.due(500) == 520


def test_a_stall_is_not_chased(clock):
    pace = Pace(1.0, clock)
    clock.now += 5.0
    assert pace.due(0) == 1
    clock.now += 0.0105
    assert pace.due(1) == 10


def test_a_small_delay_is_made_up_for(clock):
    pace = Pace(1.0, clock)
    clock.now += 0.0995
    assert pace.due(0) == 99
