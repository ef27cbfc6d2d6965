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


class Clock:
    """Wall time of the tests' own, in place of a function or of the module `time`."""

    now = 50.0

    def __call__(self):
        return self.now

    monotonic = __call__

    def sleep(self, seconds):
        self.now += seconds


@pytest.fixture
def clock():
    return Clock()
