
from bullet_lab.ros.view.displays import Displays, Kind


class Shown:
    """A display that only notes whether it is closed."""

    def __init__(self, stays):
        self.stays, self.closed = stays, False

    def close(self):
        self.closed = True


def test_a_display_that_stays_outlives_its_publisher_until_switched_off():
    made = {}

    def display(stays):
        return lambda context, topic: made.setdefault(topic, Shown(stays))

    kind = Kind("Things", {"a/Path": display(True), "a/Scan": display(False)})
    displays = Displays(kind, context=None)
    displays.follow({"/path": "a/Path", "/scan": "a/Scan", "/other": "b/Other"})
    displays.follow({"/other": "b/Other"})
    assert list(displays.shown) == ["/path"]
    assert made["/scan"].closed
    displays.follow({"/path": "a/Path"})
    displays.follow({})
    assert made["/path"].closed
    assert not displays.shown
