import cv2
import numpy as np
import pytest
from message_fields import check

from bullet_lab.ros.messages.conversions import Converter, compressed_message
from bullet_lab.simulation.plugins.samples import ImageSample, PointsSample


def picture(*shape, seed=0):
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def test_points_are_read_as_what_they_were():
    points = np.random.default_rng(0).normal(size=(3, 4, 3)).astype(np.float32)
    colours = picture(3, 4, 3, seed=1)
    sample = PointsSample(9, "optical", points, colours)
    converter = Converter(PointsSample)
    message = converter.convert(sample)
    fields = """
        header.stamp: 0.009
        height: 3
        width: 4
        is_dense: true
        point_step: 32
        row_step: 128
        is_bigendian: false
        # All of FLOAT32.
        fields: [[x, 0, 7, 1], [y, 4, 7, 1], [z, 8, 7, 1], [rgb, 16, 7, 1]]
    """
    check(message, fields)
    found = np.frombuffer(message.data, np.uint8).reshape(3, 4, 32)
    assert found[..., :12].tobytes() == points.tobytes()
    # As PCL takes them apart: blue, green, red.
    assert (found[..., 16:19] == colours[..., ::-1]).all()
    assert not found[..., 19].any()
    points[1, 1] = np.nan
    assert not converter.convert(sample).is_dense
    smaller = PointsSample(9, "optical", points[:2], colours[:2])
    assert len(converter.convert(smaller).data) == 2 * 4 * 32


COLOURED = np.full((8, 12, 3), [200, 100, 50], np.uint8)


@pytest.mark.parametrize(
    "encoding, format, pixels, said, shown",
    [
        ("rgb8", "png", COLOURED, "rgb8; png compressed bgr8", COLOURED[..., ::-1]),
        ("bgr8", "png", COLOURED, "bgr8; png compressed bgr8", COLOURED),
        ("mono8", "png", COLOURED[..., 0], "mono8; png compressed ", COLOURED[..., 0]),
        ("rgb8", "jpeg", COLOURED, "rgb8; jpeg compressed bgr8", COLOURED[..., ::-1]),
    ],
)
def test_pictures_are_compressed_as_image_transport_does(encoding, format, pixels, said, shown):
    settings = {"format": format, "jpeg_quality": 90, "jpeg_progressive": False}
    settings.update(jpeg_optimize=True, png_level=3)
    message = compressed_message(ImageSample(1500, "eye", encoding, pixels), settings)
    check(message, "{header.stamp: 1.5, header.frame_id: eye}")
    assert message.format == said
    decoded = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert decoded.shape == shown.shape
    assert np.abs(decoded.astype(int) - shown).max() <= (3 if format == "jpeg" else 0)
