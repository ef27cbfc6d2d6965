import numpy as np
import pytest
from sensor_msgs.msg import PointCloud2, PointField

from bullet_lab.ros.view.displays import GREY, points_of
from bullet_lab.ros.view.subscription import MessageError

PLACES = [[1.0, 2.0, 3.0], [np.nan, 0.0, 0.0], [4.0, 5.0, 6.0], [7.0, 8.0, np.inf]]
COLOURED = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("pad", "f4"), ("rgb", "u4")]


def cloud(rows, order="<"):
    """Return a cloud with the columns of structured rows, four bytes each."""
    rows = rows.astype(rows.dtype.newbyteorder(order))
    fields = [
        PointField(name, rows.dtype.fields[name][1], PointField.FLOAT32, 1)
        for name in rows.dtype.names
    ]
    message = PointCloud2(height=1, width=len(rows), fields=fields, data=rows.tobytes())
    message.is_bigendian = order == ">"
    message.point_step = rows.dtype.itemsize
    message.row_step = message.point_step * len(rows)
    return message


def places(columns):
    rows = np.zeros(len(PLACES), columns)
    for name, column in zip("xyz", np.transpose(PLACES)):
        rows[name] = column
    return rows


@pytest.mark.parametrize("order", "<>")
def test_finite_points_are_read(order):
    found, colours = points_of(cloud(places(COLOURED[:3]), order))
    assert found.tolist() == [PLACES[0], PLACES[2]]
    assert (colours == GREY).all()


def test_colours_are_packed_from_blue_upwards():
    rows = places(COLOURED)
    rows["rgb"] = 0xFF0A141E
    _, colours = points_of(cloud(rows))
    assert colours.tolist() == [[0x0A, 0x14, 0x1E]] * 2


def test_a_large_cloud_is_thinned_out():
    rows = np.zeros(1000, COLOURED)
    rows["x"] = np.arange(1000)
    found, _ = points_of(cloud(rows), most=300)
    assert found[:, 0].tolist() == list(range(0, 1000, 4))


def test_an_invalid_cloud_is_refused():
    short = cloud(places(COLOURED))
    short.data = short.data[:-1]
    for message in (PointCloud2(), cloud(np.zeros(3, COLOURED[:2])), short):
        with pytest.raises(MessageError):
            points_of(message)
