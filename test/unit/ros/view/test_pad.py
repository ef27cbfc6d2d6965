"""How long a command of the pad is valid, and which tab drives; on a clock of the test."""

import math

import pytest
import yaml

from bullet_lab.ros.view.pad import HOLD, PERIOD, STILL, TAKE_OVER, DriverSeat, Pad, read_command


class Wheel(DriverSeat):
    """A seat that notes by whom it drives how, and the pads of two tabs."""

    def __init__(self):
        self.driven = []
        super().__init__(lambda tab, shares: self.driven.append([tab, *shares]))
        self.pads = {tab: Pad(tab, self) for tab in "ab"}


@pytest.fixture
def wheel():
    return Wheel()


@pytest.mark.parametrize(
    "text", ["1 nan 0", "inf 1 0", "1 1e999 0", "1 0", "1 0 0 0", "", b"1 1 0", None, "1 " * 10**6]
)
def test_an_invalid_command_is_late_and_a_stop(text):
    assert read_command(text) == (-math.inf, STILL)


def test_a_command_is_valid_from_the_time_that_it_carries(wheel):
    pad = wheel.pads["a"]
    pad.take("10 1 0", 10.3)
    assert wheel.driven == [["a", 1.0, 0.0]]
    assert pad.patience(10.3) == pytest.approx(HOLD - 0.3)
    pad.stop()
    assert wheel.driven[-1] == ["a", *STILL]
    assert pad.patience(10.4) is None


@pytest.mark.parametrize("age", [HOLD, 2.0, 6.0, -1.0])
def test_a_late_command_is_a_stop(wheel, age):
    pad = wheel.pads["a"]
    pad.take(f"{10.0 - age} 1 0", 10.0)
    assert not wheel.driven
    assert pad.state(10.0)["late"]
    pad.take("10 1 0", 10.0)
    pad.take(f"{10.0 - age} 1 0", 10.1)
    assert wheel.driven == [["a", 1.0, 0.0], ["a", *STILL]]


def test_a_burst_of_old_words_drives_nothing(wheel):
    for number in range(60):
        wheel.pads["a"].take(f"{10.0 + number * PERIOD} 1 0", 17.0)
    assert not wheel.driven


# What the tabs send or do at 10 s, and how the robot is driven then.
STORIES = f"""
# One tab drives, and another takes over by asking.
- - [a, 10 1 0, [[a, 1, 0]]]
  - [b, 10 -1 0, []]
  - [b, {TAKE_OVER}, [[a, 0, 0]]]
  - [a, 10 1 0, []]
  - [b, 10 -1 0, [[b, -1, 0]]]
# Who leaves is stopped, and others may drive.
- - [a, 10 1 0, [[a, 1, 0]]]
  - [b, leaves, []]
  - [a, leaves, [[a, 0, 0]]]
  - [b, 10 1 0, [[b, 1, 0]]]
# A stop is passed on once.
- [[a, 10 0 0, []], [a, 10 1 0, [[a, 1, 0]]], [a, 10 0 0, [[a, 0, 0]]], [a, 10 0 0, []]]
"""


@pytest.mark.parametrize("story", yaml.safe_load(STORIES))
def test_who_drives(wheel, story):
    for tab, word, driven in story:
        wheel.driven.clear()
        if word == "leaves":
            wheel.leave(tab)
        else:
            wheel.pads[tab].take(word, 10.0)
        assert wheel.driven == driven


def test_a_page_says_that_another_tab_drives(wheel):
    wheel.pads["a"].take("10 1 0", 10.0)
    assert [wheel.pads[tab].state(10.0)["other"] for tab in "ab"] == [False, True]
