import numpy as np
import pytest

pytest.importorskip("rospy")

from bullet_lab.numerics.pinhole import PinholeCamera
from bullet_lab.ros.conversions import OUTPUT_CONVERTERS
from bullet_lab.simulation.samples import CameraInfoSample, ImageSample

CAMERA = PinholeCamera(64, 48, 50.0, 51.0, 31.5, 23.5, (0.1, 0.2, 0.3, 0.4, 0.5))


def message_of(sample):
    return OUTPUT_CONVERTERS[type(sample)]().convert(sample)


@pytest.mark.parametrize(
    ("encoding", "shape", "step"), [("rgb8", (48, 64, 3), 192), ("mono8", (48, 64), 64)]
)
def test_images(encoding, shape, step):
    pixels = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    message = message_of(ImageSample(1234, "optical", encoding, pixels))
    assert message.header.stamp.to_nsec() == 1_234_000_000
    assert message.header.frame_id == "optical"
    assert (message.width, message.height, message.step) == (64, 48, step)
    assert message.encoding == encoding
    assert message.is_bigendian == 0
    assert message.data == pixels.tobytes()


def test_images_whose_rows_are_not_in_one_piece():
    pixels = np.random.default_rng(0).integers(0, 256, (48, 128, 3), dtype=np.uint8)[:, ::2]
    assert message_of(ImageSample(0, "f", "rgb8", pixels)).data == pixels.tobytes()


def test_camera_info():
    message = message_of(CameraInfoSample(5, "optical", CAMERA, baseline=0.2))
    assert message.header.stamp.to_nsec() == 5_000_000
    assert (message.width, message.height) == (64, 48)
    assert message.distortion_model == "plumb_bob"
    assert message.D == [0.1, 0.2, 0.3, 0.4, 0.5]
    assert message.K == [50.0, 0.0, 31.5, 0.0, 51.0, 23.5, 0.0, 0.0, 1.0]
    assert message.R == [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    assert message.P == [50.0, 0.0, 31.5, -10.0, 0.0, 51.0, 23.5, 0.0, 0.0, 0.0, 1.0, 0.0]
