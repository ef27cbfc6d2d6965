"""What a camera_info says of an image, and which ones are refused."""

import math

import pytest

pytest.importorskip("rospy")

from sensor_msgs.msg import CameraInfo  # noqa: E402

from bullet_lab.ros.messages.images import CameraGeometryError, camera_of  # noqa: E402


def info(**changes):
    message = CameraInfo(width=640, height=480, distortion_model="plumb_bob")
    message.D = [-0.2, 0.05, 0.001, 0.002, 0.01]
    message.K = [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]
    message.P = [480.0, 0.0, 310.0, 0.0, 0.0, 480.0, 235.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def test_a_raw_image_has_k_and_d():
    camera = camera_of(info(), 640, 480)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (500.0, 510.0, 320.0, 240.0)
    assert camera.distortion == (-0.2, 0.05, 0.001, 0.002, 0.01)


def test_a_rectified_image_has_p_and_no_distortion():
    camera = camera_of(info(), 640, 480, rectified=True)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (480.0, 480.0, 310.0, 235.0)
    assert not any(camera.distortion)


@pytest.mark.parametrize(
    "model, numbers", [("", []), ("plumb_bob", [0.0] * 5), ("other", [0.0] * 8)]
)
def test_a_lens_of_zeros_is_none(model, numbers):
    assert not any(camera_of(info(distortion_model=model, D=numbers), 640, 480).distortion)


def test_four_numbers_are_those_without_k3():
    camera = camera_of(info(D=[0.1, 0.2, 0.3, 0.4]), 640, 480)
    assert camera.distortion == (0.1, 0.2, 0.3, 0.4, 0.0)


def test_a_region_moves_the_principal_point():
    message = info()
    message.roi.x_offset, message.roi.y_offset = 100, 50
    message.roi.width, message.roi.height = 200, 120
    camera = camera_of(message, 200, 120)
    assert (camera.width, camera.height, camera.cx, camera.cy) == (200, 120, 220.0, 190.0)
    with pytest.raises(CameraGeometryError, match="about 200 x 120 px, not 640 x 480"):
        camera_of(message, 640, 480)


@pytest.mark.parametrize(
    "changes, reason",
    [
        ({"K": [0.0] * 9}, "zero K: the camera is not calibrated"),
        ({"K": [math.nan] + [0.0] * 8}, "not finite"),
        ({"D": [math.inf] * 5}, "not finite"),
        ({"K": [-500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]}, "focal lengths"),
        ({"K": [500.0, 9.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]}, "no pinhole camera's"),
        ({"K": [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 0.0]}, "no pinhole camera's"),
        ({"width": 320}, "about 320 x 480 px, not 640 x 480"),
        ({"binning_x": 2}, "binning"),
        ({"distortion_model": "equidistant"}, "only plumb_bob is known"),
        ({"D": [0.1] * 8}, "only plumb_bob is known"),
    ],
    ids=str,
)
def test_what_says_nothing_of_use_is_refused(changes, reason):
    with pytest.raises(CameraGeometryError, match=reason):
        camera_of(info(**changes), 640, 480)


def test_a_zero_p_is_refused_for_a_rectified_image():
    with pytest.raises(CameraGeometryError, match="zero P"):
        camera_of(info(P=[0.0] * 12), 640, 480, rectified=True)
