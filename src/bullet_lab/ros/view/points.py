"""Clouds of points on the page, as depth cameras and lasers that turn send them."""

from __future__ import annotations

from typing import Any, Optional, Tuple

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField

from bullet_lab.ros.view.displays import Display, Stage, placed
from bullet_lab.ros.view.feeds import reader_of
from bullet_lab.ros.view.raw import RawError

KINDS = {
    PointField.INT8: "i1",
    PointField.UINT8: "u1",
    PointField.INT16: "i2",
    PointField.UINT16: "u2",
    PointField.INT32: "i4",
    PointField.UINT32: "u4",
    PointField.FLOAT32: "f4",
    PointField.FLOAT64: "f8",
}
# More are thinned out, for the network and for the browser.
MOST_POINTS = 8000
SIZE = 0.015
GREY = 128


class PointsDisplay(Display):
    """The points of a cloud, in their colours where it has some."""

    def __init__(self, stage: Stage, topic: str):
        super().__init__(stage, topic, _read, large=True)
        self._node: Any = None

    def show(self, message: Tuple[str, np.ndarray, np.ndarray]) -> None:  # noqa: D102
        frame, points, colours = message
        points = placed(self.stage.where(frame), points).astype(np.float32)
        if self._node is not None and len(points):
            self._node.points, self._node.colors = points, colours
        elif len(points):
            self._node = self.stage.scene.add_point_cloud(
                self.node, points, colours, point_size=SIZE, precision="float32"
            )
        else:
            self.hide()

    def hide(self) -> None:  # noqa: D102
        if self._node is not None:
            self._node.remove()
            self._node = None


READ = reader_of(PointCloud2)


def _read(data: bytes) -> Tuple[str, np.ndarray, np.ndarray]:
    message = READ(data)
    return (message.header.frame_id.lstrip("/"), *points_of(message))


def points_of(message: Any, most: int = MOST_POINTS) -> Tuple[np.ndarray, np.ndarray]:
    """Return places (n, 3) in m and colours (n, 3) uint8 of some of the points of a cloud.

    Those that are nowhere are left out. Raises RawError for what is no cloud.
    """
    columns = [_column(message, name) for name in "xyz"]
    if any(column is None for column in columns):
        raise RawError("a cloud of points without x, y and z")
    places = np.column_stack(columns).astype(np.float64)
    seen = np.flatnonzero(np.isfinite(places).all(axis=1))
    seen = seen[:: max(1, -(-len(seen) // most))]
    colours = np.full((len(seen), 3), GREY, np.uint8)
    named = {one.name for one in message.fields}
    packed = _column(message, "rgb" if "rgb" in named else "rgba")
    if packed is not None and packed.dtype.itemsize == 4:
        # One word holds them, from blue upwards, be it called a float or an integer.
        words = np.ascontiguousarray(packed[seen]).view(np.uint32)
        colours = np.stack([words >> shift & 255 for shift in (16, 8, 0)], axis=1).astype(np.uint8)
    return places[seen], colours


def _column(message: Any, name: str) -> Optional[np.ndarray]:
    """Return a field of all points, by rows; None where there is none of that name."""
    field = next((one for one in message.fields if one.name == name), None)
    if field is None:
        return None
    try:
        order = ">" if message.is_bigendian else "<"
        return np.ndarray(
            (message.height, message.width),
            order + KINDS[field.datatype],
            message.data,
            field.offset,
            (message.row_step, message.point_step),
        ).reshape(-1)
    except (KeyError, TypeError, ValueError) as error:
        raise RawError(f"a cloud that is not what it says: {error}") from error
