"""What the bridge logs of plugins that fail."""

from types import SimpleNamespace

import pytest

from bullet_lab.errors import LabError
from bullet_lab.ros.nodes import bridge


@pytest.mark.parametrize(
    ("seconds", "errors", "count", "said", "traced"),
    [
        (0.1, [ZeroDivisionError("by zero")] * 30, 1, "ZeroDivisionError: by zero; the", True),
        (0.1, [KeyError(number) for number in range(30)], 3, "KeyError: 20; the", True),
        (5.0, [LabError("no driver")] * 2, 1, "plugin 'eye' of 'bot': no driver; the", False),
    ],
)
def test_a_new_reason_is_logged_once_a_second_at_most(
    monkeypatch, caplog, seconds, errors, count, said, traced
):
    monkeypatch.setattr(bridge.logging.getLogger("bullet_lab"), "propagate", True)
    node, now = SimpleNamespace(_failures={}), iter(range(100))
    monkeypatch.setattr(bridge.time, "monotonic", lambda: seconds * next(now))
    for error in errors:
        bridge.PyBulletBridge._report_failure(node, "plugin 'eye' of 'bot'", error)
    assert len(caplog.records) == count
    assert said in caplog.records[-1].getMessage()
    assert bool(caplog.records[-1].exc_info) == traced
