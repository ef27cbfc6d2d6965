import cv2
import numpy as np
import pytest
from message_fields import check, message_of
from sensor_msgs.msg import PointField

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.ros.messages.conversions import Converter, compressed_message
from bullet_lab.simulation.plugins.samples import CameraInfoSample, ImageSample, PointsSample

CAMERA = PinholeCamera(64, 48, 50.0, 51.0, 31.5, 23.5, (0.1, 0.2, 0.3, 0.4, 0.5))


@pytest.mark.parametrize(
    ("encoding", "shape", "step"), [("rgb8", (48, 64, 3), 192), ("mono8", (48, 64), 64)]
)
def test_images(encoding, shape, step):
    pixels = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    message = message_of(ImageSample(1234, "optical", encoding, pixels))
    fields = """
        header.stamp: 1.234
        header.frame_id: optical
        width: 64
        height: 48
        is_bigendian: 0
    """
    check(message, fields)
    assert (message.encoding, message.step) == (encoding, step)
    assert message.data == pixels.tobytes()


def test_images_whose_rows_are_not_in_one_piece():
    pixels = np.random.default_rng(0).integers(0, 256, (48, 128, 3), dtype=np.uint8)[:, ::2]
    assert message_of(ImageSample(0, "f", "rgb8", pixels)).data == pixels.tobytes()


def test_camera_info():
    message = message_of(CameraInfoSample(5, "optical", CAMERA, baseline=0.2))
    fields = """
        header.stamp: 0.005
        width: 64
        height: 48
        distortion_model: plumb_bob
        D: [0.1, 0.2, 0.3, 0.4, 0.5]
        K: [50.0, 0.0, 31.5, 0.0, 51.0, 23.5, 0.0, 0.0, 1.0]
        R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
        P: [50.0, 0.0, 31.5, -10.0, 0.0, 51.0, 23.5, 0.0, 0.0, 0.0, 1.0, 0.0]
    """
    check(message, fields)


def test_depth_images():
    depths = np.array([[1.5, np.nan], [0.4, 5.0], [2.0, 3.0]], np.float32)
    message = message_of(ImageSample(7, "optical", "32FC1", depths))
    assert (message.width, message.height, message.step) == (2, 3, 8)
    np.testing.assert_array_equal(np.frombuffer(message.data, "<f4").reshape(3, 2), depths)
    whole = message_of(ImageSample(7, "optical", "16UC1", np.array([[65000, 1]], np.uint16)))
    assert (whole.step, whole.data) == (4, b"\xe8\xfd\x01\x00")


def test_points_are_read_as_what_they_were():
    points = np.random.default_rng(0).normal(size=(3, 4, 3)).astype(np.float32)
    colours = np.random.default_rng(1).integers(0, 256, (3, 4, 3), dtype=np.uint8)
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
    """
    check(message, fields)
    assert [f.name for f in message.fields] == ["x", "y", "z", "rgb"]
    assert [f.offset for f in message.fields] == [0, 4, 8, 16]
    assert {(f.datatype, f.count) for f in message.fields} == {(PointField.FLOAT32, 1)}
    found = np.frombuffer(message.data, np.uint8).reshape(3, 4, 32)
    assert found[..., :12].tobytes() == points.tobytes()
    # As PCL takes them apart: blue, green, red.
    assert (found[..., 16:19] == colours[..., ::-1]).all()
    assert not found[..., 19].any()
    points[1, 1] = np.nan
    assert not converter.convert(sample).is_dense
    smaller = PointsSample(9, "optical", points[:2], colours[:2])
    assert len(converter.convert(smaller).data) == 2 * 4 * 32


@pytest.mark.parametrize(
    ("encoding", "format", "said"),
    [
        ("rgb8", "png", "rgb8; png compressed bgr8"),
        ("bgr8", "png", "bgr8; png compressed bgr8"),
        ("mono8", "png", "mono8; png compressed "),
        ("rgb8", "jpeg", "rgb8; jpeg compressed bgr8"),
    ],
)
def test_pictures_are_compressed_as_image_transport_does(encoding, format, said):
    settings = {"format": format, "jpeg_quality": 90, "jpeg_progressive": False}
    settings.update(jpeg_optimize=True, png_level=3)
    colour = np.array([200, 100, 50], np.uint8)
    pixels = np.tile(colour, (8, 12, 1)) if encoding != "mono8" else np.full((8, 12), 99, np.uint8)
    message = compressed_message(ImageSample(1500, "eye", encoding, pixels), settings)
    assert message.format == said
    assert (message.header.stamp.to_sec(), message.header.frame_id) == (1.5, "eye")
    decoded = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_UNCHANGED)
    wanted = pixels[..., ::-1] if encoding == "rgb8" else pixels
    assert decoded.shape == wanted.shape
    assert np.abs(decoded.astype(int) - wanted).max() <= (3 if format == "jpeg" else 0)
