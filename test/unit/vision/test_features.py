"""Corners, and how they are drawn."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from alike import assert_as_before, lines_of
from marker_images import CAMERA, View, image_of, marker, true_corners
from shared import cases

from bullet_lab.vision import drawing
from bullet_lab.vision.features import good_features, harris_corners
from bullet_lab.vision.images import VisionError, grey
from bullet_lab.vision.marker_detector import DetectedMarker
from bullet_lab.vision.marker_pose import estimate_pose

CORNERS = np.array([[200, 150], [400, 150], [400, 350], [200, 350]])
EVEN = np.full((480, 640), 9, np.uint8)


@pytest.fixture()
def square():
    """A square of which a corner is less bright."""
    image = np.full((480, 640), 60, np.uint8)
    image[150:351, 200:401] = 220
    image[300:, 300:] = 0.75 * image[300:, 300:]
    return image


def distances(points):
    """From each corner to the nearest point, px."""
    return np.linalg.norm(points[:, None, :2] - CORNERS, axis=2).min(axis=0)


def test_good_features_strongest_first(square):
    points = good_features(square)
    assert distances(points)[:2].max() < 3.0
    assert (np.diff(points[:, 2]) <= 1e-6).all()
    assert len(good_features(square, count=2)) == 2
    assert good_features(EVEN).shape == (0, 3)


def test_harris_corners(square):
    area, points = harris_corners(square)
    assert (np.diff(points[:, 2]) <= 0.0).all()
    assert distances(points).max() < 3.0
    # Squares of some pixels about the corners, as in figure 7d, and nothing elsewhere.
    assert area.sum() < 12 * 60
    for u, v in CORNERS:
        assert area[v - 3 : v + 4, u - 3 : u + 4].any()
    assert not harris_corners(EVEN)[0].any()


def test_corners_are_as_before():
    noise = np.random.default_rng(1).integers(0, 256, (60, 80)).astype(np.uint8)
    image = cv2.GaussianBlur(noise, (0, 0), 3.0)
    area, harris = harris_corners(image)
    told = [str(area.sum())]
    # Which of the weak ones are peaks is up to the processor.
    for points in (harris[:30], good_features(image)):
        told += lines_of(points / points[0], "points")
    assert_as_before(told, Path(__file__).with_name("corners.txt"), within=1e-4)


def drawn():
    """All that is drawn, in one image: a marker from near by and another, corners and texts."""
    near, far = View(0.8, yaw=20.0, shift=(-0.1, 0.0)), View(3.0, shift=(1.2, -1.0))
    # With hardly broad lines.
    between = View(1.66, shift=(0.2, -0.3))
    image = np.dstack([image_of([marker()], far, samples=4)] * 3)
    for view in (near, between, far):
        corners = true_corners(view)
        pose = estimate_pose(corners, 0.2, CAMERA).best
        drawing.draw_axes(image, pose, 0.2, CAMERA)
        drawing.draw_marker(image, DetectedMarker(0, corners, 0, 1.0, np.eye(8)), "id 0  4.00 m")
    # Behind the camera and too far aside there are none.
    for size in (9.0, 5.992):
        drawing.draw_axes(image, pose, size, CAMERA)
    for place in ((-50, -50), (10_000, 10_000)):
        drawing.draw_text(image, "in the image", place)
    drawing.draw_points(image, np.array([[450.2, 240.6, 1.0]]))
    drawing.draw_area(image, np.add.outer(np.arange(480), np.arange(640)) == 800)
    return np.hstack((image, drawing.enlarged(image, corners, 480)))


def test_drawings_are_as_before():
    before = cv2.imread(str(Path(__file__).parent / "drawn.png"))
    assert np.array_equal(drawn(), before)


@cases("""
encoding, channels, level:
  - [bgr8, 3, 29]
  - [rgb8, 3, 76]
  - [bgra8, 4, 29]
  - [rgba8, 4, 76]
""")
def test_grey_levels_of_colours(encoding, channels, level):
    pixels = np.zeros((20, 20, channels), np.uint8)
    pixels[:, :, 0] = 255
    assert grey(pixels, encoding)[0, 0] == level
    with pytest.raises(VisionError):
        grey(pixels, "mono8")
