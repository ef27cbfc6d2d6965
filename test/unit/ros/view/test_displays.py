import pytest

pytest.importorskip("rospy")

from bullet_lab.ros.view.displays import Displays, Kind


class Shown:
    """A display that only notes whether it is closed."""

    def __init__(self, stays):
        self.stays, self.closed = stays, False

    def close(self):
        self.closed = True


def test_what_stays_goes_when_it_is_switched_off_and_not_with_its_publisher():
    made = {}

    def display(stays):
        return lambda stage, topic: made.setdefault(topic, Shown(stays))

    kind = Kind("Things", {"a/Path": display(True), "a/Scan": display(False)})
    displays = Displays(kind, stage=None)
    displays.follow({"/path": "a/Path", "/scan": "a/Scan", "/other": "b/Other"})
    displays.follow({"/other": "b/Other"})
    assert displays.topics == ["/path"]
    assert made["/scan"].closed
    displays.follow({"/path": "a/Path"})
    displays.close()
    assert made["/path"].closed
    assert not displays.topics
