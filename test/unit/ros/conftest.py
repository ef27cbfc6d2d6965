"""Without ROS, there is nothing to test here."""

import importlib.util

import pytest

collect_ignore_glob = [] if importlib.util.find_spec("rospy") else ["*"]


@pytest.fixture
def logged(monkeypatch):
    """The warnings and errors that rospy logs."""
    lines = []
    for name in ("rospy.logwarn", "rospy.logerr"):
        monkeypatch.setattr(name, lambda line, *values: lines.append(line % values))
    return lines
