import pytest

from bullet_lab.ros.bridge.timing import OTHERS, WAITING, WINDOW, LoopWatch


@pytest.fixture
def watch(clock):
    return LoopWatch(clock)


@pytest.fixture
def after(clock, watch):
    """A function that returns what is said of a step that is reached after some seconds."""

    def measure(seconds, step, wanted=1.0):
        clock.now += seconds
        return watch.measure(step, wanted)

    return measure


def test_time_that_keeps_its_speed(after):
    for second in range(1, 8):
        assert after(5.0, 5000 * second) is None
    assert after(5.0, 35_000 + 4600) is None
    assert after(5.0, 39_600 + 4400) is not None


def test_time_that_falls_behind(after):
    lag = after(5.0, 2500)
    assert lag == (1.0, 0.5, 5.0, ((OTHERS, 1.0),))
    assert str(lag) == (
        "simulated time falls behind: real-time factor 0.50 instead of 1 in the last 5 s "
        "(of the time: other threads and programs 100 %)"
    )
    # Counted anew.
    assert after(5.0, 7500) is None
    assert after(6.0, 7500 + 9000, wanted=2.0).reached == pytest.approx(1.5)


def test_a_machine_that_stays_too_slow_is_told_of_less_and_less_often(after):
    told = [second for second in range(5, 400, 5) if after(5.0, second)]
    assert told == [5, 10, 20, 40, 80, 160, 240, 320]
    # Once it is fast enough, it begins anew.
    assert after(5.0, 100_000) is None
    assert after(5.0, 100_001) is not None


def test_as_fast_as_it_goes_is_never_too_slow(after):
    assert after(5.0, 1, wanted=0.0) is None


def test_enough_is_due_once_in_a_window(clock, watch):
    assert not watch.due
    clock.now += WINDOW
    assert watch.due
    watch.measure(0, 1.0)
    assert not watch.due


def test_a_pause_does_not_count(after, clock, watch):
    clock.now += 100.0
    watch.restart(7)
    assert after(5.0, 5007) is None


def test_where_the_time_goes(after, clock, watch):
    with watch.doing("services"):
        clock.now += 1.0
        with watch.doing("steps"):
            clock.now += 2.0
        clock.now += 0.5
    with watch.doing("handing messages to subscribers"):
        clock.now += 0.3
    watch.spend("plugin 'camera'", 1.2)
    watch.spend("steps", -1.2)
    lag = after(1.2, 1000)
    assert [what for what, _ in lag.causes] == ["services", OTHERS, "plugin 'camera'", "steps"]
    assert [share for _, share in lag.causes] == pytest.approx([0.3, 0.3, 0.24, 0.16])
    assert str(lag).endswith(
        "(of the time: services 30 %, other threads and programs 30 %, plugin 'camera' 24 %, "
        "steps 16 %)"
    )


def test_waiting_is_no_cause(after, clock, watch):
    with watch.doing(WAITING):
        clock.now += 4.0
    lag = after(1.0, 2000)
    assert lag.causes == ((OTHERS, pytest.approx(0.2)),)
    assert str(lag).endswith("(of the time: other threads and programs 20 %)")


def test_what_was_done_before_a_restart_is_forgotten(after, clock, watch):
    with watch.doing("steps"):
        clock.now += 4.0
    watch.restart(0)
    assert after(5.0, 0).causes == ((OTHERS, 1.0),)


def test_a_stuck_loop_is_reported_once_in_a_window(clock, watch):
    clock.now += 60.0
    assert watch.stuck() is None
    with watch.doing("services"):
        clock.now += WINDOW - 0.1
        assert watch.stuck() is None
        clock.now += 0.2
        what, seconds = watch.stuck()
        assert (what, round(seconds, 1)) == ("services", WINDOW + 0.1)
        clock.now += WINDOW - 0.1
        assert watch.stuck() is None
        clock.now += 0.2
        assert watch.stuck()[1] > 2 * WINDOW
    clock.now += 60.0
    assert watch.stuck() is None


def test_many_short_activities_are_not_stuck(clock, watch):
    clock.now += 60.0
    with watch.doing("services"):
        for _ in range(100):
            with watch.doing("steps"):
                clock.now += 1.0
            assert watch.stuck() is None


def test_an_error_ends_what_was_done(after, clock, watch):
    with pytest.raises(ValueError), watch.doing("services"):
        raise ValueError
    with watch.doing("steps"):
        clock.now += 2.0
    watch.restart(0)
    with watch.doing("steps"):
        clock.now += 2.0
    assert after(3.0, 0).causes == ((OTHERS, 0.6), ("steps", 0.4))
