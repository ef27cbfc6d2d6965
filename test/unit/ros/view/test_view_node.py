"""How often the view reads the list of topics."""

from unittest import mock

from shared import cases

from bullet_lab.ros.view import node

TICK = 1.0 / 30.0


@cases("seconds_of_an_update: [0.1, 2.0]")
def test_topics_are_updated_each_second_however_long_an_update_takes(
    monkeypatch, clock, seconds_of_an_update
):
    begins, ends = [], []

    def update(_show):
        begins.append(clock.now)
        clock.sleep(seconds_of_an_update)
        ends.append(clock.now)

    monkeypatch.setattr(node, "time", clock)
    monkeypatch.setattr(node, "Subscription", mock.MagicMock())
    monkeypatch.setattr(node, "FramesDisplay", mock.MagicMock())
    monkeypatch.setattr(node.Show, "_update", update)
    shown = node.Show(mock.MagicMock(), mock.MagicMock(), list, node.ViewParameters())
    while len(begins) < 8:
        shown.tick()
        clock.sleep(TICK)
    # A topic that is advertised just after an update is seen at the end of the next one.
    waits = [end - begin for begin, end in zip(begins, ends[1:])]
    assert max(waits) < 2 * seconds_of_an_update + 1.0 + 2 * TICK
