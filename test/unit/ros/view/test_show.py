"""How often the view asks which topics there are."""

from types import SimpleNamespace
from unittest import mock

import pytest

from bullet_lab.ros.view import show

TICK = 1.0 / 30.0


@pytest.mark.parametrize("seconds_of_a_look", [0.01, 1.0, 2.0])
def test_new_topics_are_looked_for_each_second_however_long_a_look_takes(
    monkeypatch, seconds_of_a_look
):
    clock = SimpleNamespace(now=0.0, monotonic=lambda: clock.now)
    begins, ends = [], []

    def look(_show):
        begins.append(clock.now)
        clock.now += seconds_of_a_look
        ends.append(clock.now)

    monkeypatch.setattr(show, "time", clock)
    monkeypatch.setattr(show, "Feed", mock.MagicMock())
    monkeypatch.setattr(show.Show, "_look", look)
    shown = show.Show(mock.MagicMock(), mock.MagicMock(), list, "world", 10.0)
    while clock.now < 60.0:
        shown.tick()
        clock.now += TICK
    # A topic that comes just after a look is seen at the end of the next one.
    waits = [end - begin for begin, end in zip(begins, ends[1:])]
    assert len(waits) > 10
    assert max(waits) < 2 * seconds_of_a_look + 1.0 + 2 * TICK
