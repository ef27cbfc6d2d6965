from unittest import mock

from bullet_lab.ros.view.displays import Displays, Kind


def test_a_display_that_stays_outlives_its_publisher_until_switched_off():
    path, scan = mock.Mock(stays=True), mock.Mock(stays=False)
    kind = Kind("Things", {"a/Path": lambda *_: path, "a/Scan": lambda *_: scan})
    displays = Displays(kind, context=None)
    displays.follow({"/path": "a/Path", "/scan": "a/Scan", "/other": "b/Other"})
    displays.follow({"/other": "b/Other"})
    assert list(displays.shown) == ["/path"]
    assert (path.close.called, scan.close.called) == (False, True)
    displays.follow({"/path": "a/Path"})
    displays.follow({})
    assert path.close.called
    assert not displays.shown
