from unittest import mock

import numpy as np
import pytest
from sensor_msgs.msg import PointCloud2, PointField

from bullet_lab.ros.view.context import MessageError
from bullet_lab.ros.view.displays import GREY, Displays, Kind, points_of

PLACES = [[1.0, 2.0, 3.0], [np.nan, 0.0, 0.0], [4.0, 5.0, 6.0], [7.0, 8.0, np.inf]]
COLOURED = np.dtype([("xyz", "f4", 3), ("pad", "f4"), ("rgb", "u4")])


def cloud(places, rgb=0, order="<", fields="xyz rgb"):
    """Return a cloud of places of one colour, of which some fields are declared."""
    rows = np.zeros(len(places), COLOURED.newbyteorder(order))
    rows["xyz"], rows["rgb"] = places, rgb
    message = PointCloud2(height=1, width=len(rows), data=rows.tobytes())
    for name, offset in {"x": 0, "y": 4, "z": 8, "rgb": 16}.items():
        if name in fields:
            message.fields.append(PointField(name, offset, PointField.FLOAT32, 1))
    message.is_bigendian = order == ">"
    message.point_step = rows.itemsize
    message.row_step = len(message.data)
    return message


@pytest.mark.parametrize("order", "<>")
def test_finite_points_are_read(order):
    found, colours = points_of(cloud(PLACES, order=order, fields="xyz"))
    assert found.tolist() == [PLACES[0], PLACES[2]]
    assert (colours == GREY).all()


def test_colours_are_packed_from_blue_upwards():
    _, colours = points_of(cloud(PLACES, 0xFF0A141E))
    assert colours.tolist() == [[0x0A, 0x14, 0x1E]] * 2


def test_a_large_cloud_is_thinned_out():
    found, _ = points_of(cloud([[x, 0.0, 0.0] for x in range(1000)]), most=300)
    assert found[:, 0].tolist() == list(range(0, 1000, 4))


def test_an_invalid_cloud_is_refused():
    short = cloud(PLACES)
    short.data = short.data[:-1]
    for message in (PointCloud2(), cloud(PLACES, fields="xy"), short):
        with pytest.raises(MessageError):
            points_of(message)


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
