import pytest

from bullet_lab.ros.bridge.stepper import SpeedWatch


@pytest.fixture
def watch(clock):
    return SpeedWatch(clock)


@pytest.fixture
def after(clock, watch):
    """A function that returns what is said of a step that is reached after some seconds."""

    def measure(seconds, step, wanted=1.0):
        clock.now += seconds
        return watch.lag(step, wanted)

    return measure


def test_time_that_keeps_its_speed(after):
    for second in range(1, 8):
        assert not after(5.0, 5000 * second)
    assert not after(5.0, 35_000 + 4600)
    assert after(5.0, 39_600 + 4400)


def test_time_that_falls_behind(after):
    assert not after(4.9, 0)
    assert after(0.1, 2500) == (
        "simulated time falls behind: real-time factor 0.50 instead of 1 in the last 5 s"
    )
    # Counted anew.
    assert not after(5.0, 7500)
    assert "1.50 instead of 2 in the last 6 s" in after(6.0, 7500 + 9000, wanted=2.0)


def test_a_machine_that_stays_too_slow_is_told_of_less_and_less_often(after):
    told = [second for second in range(5, 400, 5) if after(5.0, second)]
    assert told == [5, 10, 20, 40, 80, 160, 240, 320]
    # Once it is fast enough, it begins anew.
    assert not after(5.0, 100_000)
    assert after(5.0, 100_001)


def test_as_fast_as_it_goes_is_never_too_slow(after):
    assert not after(5.0, 1, wanted=0.0)


def test_a_pause_does_not_count(after, clock, watch):
    clock.now += 100.0
    watch.restart(7)
    assert not after(5.0, 5007)
