"""Corners, and how they are drawn."""

import numpy as np
import pytest
from marker_images import CAMERA, View, image_of, marker, true_corners
from scipy.spatial.distance import pdist

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


def black(height=480, width=640):
    return np.zeros((height, width, 3), np.uint8)


def is_of(image, colour):
    return (image == colour).all(axis=2)


def seen(view):
    """The corners and the pose of a marker."""
    corners = true_corners(view)
    return corners, estimate_pose(corners, 0.2, CAMERA).best


def distances(points):
    """From each corner to the nearest point, px."""
    return np.linalg.norm(points[:, None, :2] - CORNERS, axis=2).min(axis=0)


def test_good_features_strongest_first_and_apart(square):
    points = good_features(square)
    assert distances(points)[:2].max() < 3.0
    assert (np.diff(points[:, 2]) <= 1e-6).all()
    assert len(good_features(square, count=2)) == 2
    assert good_features(EVEN).shape == (0, 3)
    noise = np.random.default_rng(0).integers(0, 256, (480, 640)).astype(np.uint8)
    assert pdist(good_features(noise, 100, 0.01, 30.0)[:, :2]).min() >= 30.0


def test_harris_corners(square):
    area, points = harris_corners(square)
    assert (np.diff(points[:, 2]) <= 0.0).all()
    assert points[0, 2] > 1.5 * points[-1, 2]
    assert distances(points).max() < 3.0
    # Squares of some pixels about the corners, as in figure 7d, and nothing elsewhere.
    assert area.sum() < 12 * 60
    for u, v in CORNERS:
        assert area[v - 3 : v + 4, u - 3 : u + 4].any()
    assert not harris_corners(EVEN)[0].any()


def test_points_are_blue_discs_and_areas_blue():
    image, area = black(100, 100), np.zeros((100, 100), bool)
    drawing.draw_points(image, np.array([[50.2, 40.0, 1.0]]))
    drawn = np.argwhere(is_of(image, drawing.BLUE))
    assert (drawn.min(axis=0).tolist(), drawn.max(axis=0).tolist()) == ([37, 47], [43, 53])
    area[90, 10] = True
    drawing.draw_area(image, area)
    assert is_of(image, drawing.BLUE)[90, 10]


def test_a_drawn_marker_has_outline_first_corner_axes_and_label():
    corners, pose = seen(View(0.8, yaw=20.0))
    image = black()
    drawing.draw_axes(image, pose, 0.2, CAMERA)
    drawing.draw_marker(image, DetectedMarker(0, corners, 0, 1.0, np.eye(8)), "id 0  4.00 m")
    u, v = np.rint(corners[0]).astype(int)
    assert is_of(image, drawing.FIRST_CORNER)[v, u]
    u, v = corners[1:3].mean(axis=0).astype(int)
    near = image[v, u - 2 : u + 4].astype(int)
    assert (near[:, 1] > near[:, 0] + 30).any()
    top = int(corners[:, 1].min())
    assert image[top - 30 : top - 4].max() > 240


@pytest.mark.parametrize("place", [(-50, -50), (10_000, 10_000)])
def test_text_stays_in_the_image(place):
    image = black(60, 200)
    drawing.draw_text(image, "text", place)
    assert image.max() > 240


def test_axes_behind_the_camera_are_not_drawn():
    image = black()
    drawing.draw_axes(image, seen(View(1.0))[1], 5.0, CAMERA)
    assert image.max() == 0


def test_an_enlarged_marker_has_its_outline_where_the_marker_ends():
    view = View(3.0)
    image = image_of([marker()], view, samples=4)
    large = drawing.enlarged(np.dstack([image] * 3), true_corners(view), 400)
    assert large.shape == (400, 400, 3)
    row, column = np.nonzero(is_of(large, drawing.OUTLINE))
    side = 400 * 33.5 / (2 * 27 + 1)
    assert column.max() - column.min() == pytest.approx(side, abs=5.0)
    assert 0.5 * (row.max() + row.min()) == pytest.approx(200.0, abs=8.0)


@pytest.mark.parametrize(
    "encoding, channels, level",
    [("bgr8", 3, 29), ("rgb8", 3, 76), ("bgra8", 4, 29), ("rgba8", 4, 76)],
)
def test_grey_levels_of_colours(encoding, channels, level):
    pixels = np.zeros((20, 20, channels), np.uint8)
    pixels[:, :, 0] = 255
    assert grey(pixels, encoding)[0, 0] == level
    with pytest.raises(VisionError):
        grey(pixels, "mono8")
