"""What a camera_info says of an image, and which ones are refused."""

import yaml
from message_fields import check, message
from sensor_msgs.msg import CameraInfo
from shared import cases, refuses

from bullet_lab.ros.messages.images import CameraGeometryError, camera_of

USUAL = """
    width: 640
    height: 480
    distortion_model: plumb_bob
    D: [-0.2, 0.05, 0.001, 0.002, 0.01]
    K: [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]
    P: [480.0, 0.0, 310.0, 0.0, 0.0, 480.0, 235.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""


def camera(changes="", size=(640, 480), rectified=False):
    """Return the camera of a usual camera_info with changes, for an image of a size."""
    fields = {**yaml.safe_load(USUAL), **yaml.safe_load(f"{{{changes}}}")}
    return camera_of(message(CameraInfo, yaml.safe_dump(fields)), *size, rectified=rectified)


@cases("""
changes, fields:
  # Changes, and the camera then.
  # Of a raw image: K and D.
  - - ""
    - "{fx: 500.0, fy: 510.0, cx: 320.0, cy: 240.0, distortion: [-0.2, 0.05, 0.001, 0.002, 0.01]}"
  # A lens of zeros is none.
  - ["distortion_model: '', D: []", "{distortion: [0.0, 0.0, 0.0, 0.0, 0.0]}"]
  - ["D: [0, 0, 0, 0, 0]", "{distortion: [0.0, 0.0, 0.0, 0.0, 0.0]}"]
  - ["distortion_model: x, D: [0, 0, 0, 0, 0, 0, 0, 0]", "{distortion: [0.0, 0.0, 0.0, 0.0, 0.0]}"]
  # Four numbers are those without k3.
  - ["D: [0.1, 0.2, 0.3, 0.4]", "{distortion: [0.1, 0.2, 0.3, 0.4, 0.0]}"]
""")
def test_a_raw_image_has_k_and_d(changes, fields):
    check(camera(changes), fields)


def test_a_rectified_image_has_p_and_no_distortion():
    fields = "{fx: 480.0, fy: 480.0, cx: 310.0, cy: 235.0, distortion: [0.0, 0.0, 0.0, 0.0, 0.0]}"
    check(camera(rectified=True), fields)


def test_a_region_moves_the_principal_point():
    region = "roi: {x_offset: 100, y_offset: 50, width: 200, height: 120}"
    check(camera(region, (200, 120)), "{width: 200, height: 120, cx: 220.0, cy: 190.0}")
    with refuses("about 200 x 120 px, not 640 x 480", CameraGeometryError):
        camera(region)


@cases("""
changes, reason:
  "K: [0, 0, 0, 0, 0, 0, 0, 0, 0]": "zero K: the camera is not calibrated"
  "K: [.nan, 0, 0, 0, 0, 0, 0, 0, 0]": not finite
  "D: [.inf, 0, 0, 0, 0]": not finite
  "K: [-500, 0, 320, 0, 510, 240, 0, 0, 1]": focal lengths
  "K: [500, 9, 320, 0, 510, 240, 0, 0, 1]": no pinhole camera's
  "K: [500, 0, 320, 0, 510, 240, 0, 0, 0]": no pinhole camera's
  "width: 320": about 320 x 480 px, not 640 x 480
  "binning_x: 2": binning
  "distortion_model: equidistant": only plumb_bob is known
  "D: [0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1]": only plumb_bob is known
""")
def test_what_says_nothing_of_use_is_refused(changes, reason):
    with refuses(reason, CameraGeometryError):
        camera(changes)


def test_a_zero_p_is_refused_for_a_rectified_image():
    with refuses("zero P", CameraGeometryError):
        camera("P: [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]", rectified=True)
