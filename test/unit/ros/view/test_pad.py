"""How long a command of the pad is valid, and which tab drives; on a clock of the test."""

import math

import pytest

from bullet_lab.ros.view.pad import HOLD, PERIOD, STILL, TAKE_OVER, DriverSeat, Pad, read_command


@pytest.fixture
def driven():
    return []


@pytest.fixture
def wheel(driven):
    return DriverSeat(lambda tab, shares: driven.append((tab, shares)))


@pytest.fixture
def pad(wheel):
    return Pad("a", wheel)


@pytest.mark.parametrize(
    "text", ["1 nan 0", "inf 1 0", "1 1e999 0", "1 0", "1 0 0 0", "", b"1 1 0", None, "1 " * 10**6]
)
def test_an_invalid_command_is_late_and_a_stop(text):
    assert read_command(text) == (-math.inf, STILL)


def test_a_command_is_valid_from_the_time_that_it_carries(pad, driven):
    pad.take("10 1 0", 10.3)
    assert driven == [("a", (1.0, 0.0))]
    assert pad.patience(10.3) == pytest.approx(HOLD - 0.3)
    pad.stop()
    assert driven[-1] == ("a", STILL)
    assert pad.patience(10.4) is None


@pytest.mark.parametrize("age", [HOLD, 2.0, 6.0, -1.0])
def test_a_late_command_is_a_stop(pad, driven, age):
    pad.take(f"{10.0 - age} 1 0", 10.0)
    assert not driven
    assert pad.state(10.0)["late"]
    pad.take("10 1 0", 10.0)
    pad.take(f"{10.0 - age} 1 0", 10.1)
    assert driven == [("a", (1.0, 0.0)), ("a", STILL)]


def test_a_burst_of_old_words_drives_nothing(pad, driven):
    for number in range(60):
        pad.take(f"{10.0 + number * PERIOD} 1 0", 17.0)
    assert not driven


def test_one_tab_drives_and_another_takes_over_by_asking(wheel, driven):
    first, second = Pad("a", wheel), Pad("b", wheel)
    first.take("10 1 0", 10.0)
    second.take("10 -1 0", 10.0)
    assert driven == [("a", (1.0, 0.0))]
    assert second.state(10.0)["other"]
    assert not first.state(10.0)["other"]
    second.take(TAKE_OVER, 10.0)
    assert driven[1:] == [("a", STILL)]
    first.take("10 1 0", 10.0)
    second.take("10 -1 0", 10.0)
    assert driven[2:] == [("b", (-1.0, 0.0))]


def test_who_leaves_is_stopped_and_others_may_drive(wheel, driven):
    Pad("a", wheel).take("10 1 0", 10.0)
    wheel.leave("b")
    assert driven == [("a", (1.0, 0.0))]
    wheel.leave("a")
    assert driven[-1] == ("a", STILL)
    assert wheel.claim("b")


def test_a_stop_is_passed_on_once(pad, driven):
    for text in ("10 0 0", "10 1 0", "10 0 0", "10 0 0"):
        pad.take(text, 10.0)
    assert driven == [("a", (1.0, 0.0)), ("a", STILL)]
