"""Nodes in the process of a test, without a master."""

from collections import defaultdict
from types import SimpleNamespace

import pytest
import rospy


@pytest.fixture
def published(request, monkeypatch):
    """What a node of the test's module `NODE` publishes, by topic; each topic has a subscriber."""
    messages = defaultdict(list)

    def publisher(topic, *_, **__):
        return SimpleNamespace(
            publish=messages[topic].append,
            unregister=lambda: messages.pop(topic),
            has_connections=lambda: True,
            get_num_connections=lambda: 1,
        )

    for name in ("publisher", "Publisher", "subscriber"):
        monkeypatch.setattr(request.module.NODE, name, publisher)
    monkeypatch.setattr(rospy, "Service", lambda *_: None)
    return messages
