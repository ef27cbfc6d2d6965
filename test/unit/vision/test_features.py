"""Corners, and how they are drawn."""

import numpy as np
import pytest
from marker_images import CAMERA, View, image_of, marker, true_corners

from bullet_lab.vision import drawing
from bullet_lab.vision.features import good_features, harris_corners
from bullet_lab.vision.images import VisionError, grey
from bullet_lab.vision.marker_detector import DetectedMarker
from bullet_lab.vision.marker_pose import estimate_pose

CORNERS = np.array([[200, 150], [400, 150], [400, 350], [200, 350]])
BLUE = np.array(drawing.BLUE)


@pytest.fixture()
def square():
    image = np.full((480, 640), 60, np.uint8)
    image[150:351, 200:401] = 220
    return image


def distances(points):
    """From each corner to the nearest point, px."""
    return np.linalg.norm(points[:, None, :2] - CORNERS, axis=2).min(axis=0)


def test_good_features_strongest_first_and_apart(square):
    square[300:, 300:] //= 2
    points = good_features(square)
    assert distances(points)[:2].max() < 3.0
    assert (np.diff(points[:, 2]) <= 1e-6).all()
    assert len(good_features(square, count=2)) == 2
    assert good_features(np.full((480, 640), 9, np.uint8)).shape == (0, 3)
    noise = np.random.default_rng(0).integers(0, 256, (480, 640)).astype(np.uint8)
    points = good_features(noise, 100, 0.01, 30.0)
    apart = np.linalg.norm(points[:, None, :2] - points[None, :, :2], axis=2)
    assert apart[np.triu_indices(len(points), 1)].min() >= 30.0


def test_harris_corners(square):
    square[300:, 300:] -= square[300:, 300:] // 4
    area, points = harris_corners(square)
    assert (np.diff(points[:, 2]) <= 0.0).all()
    assert points[0, 2] > 1.5 * points[-1, 2]
    assert distances(points).max() < 3.0
    # Squares of some pixels about the corners, as in figure 7d, and nothing elsewhere.
    assert area.sum() < 12 * 60
    for u, v in CORNERS:
        assert area[v - 3 : v + 4, u - 3 : u + 4].any()
    assert not harris_corners(np.full((480, 640), 9, np.uint8))[0].any()


def test_points_are_blue_discs_and_areas_blue():
    image = np.zeros((100, 100, 3), np.uint8)
    drawing.draw_points(image, np.array([[50.2, 40.0, 1.0]]))
    drawn = np.argwhere((image == BLUE).all(axis=2))
    assert (drawn.min(axis=0).tolist(), drawn.max(axis=0).tolist()) == ([37, 47], [43, 53])
    area = np.zeros((100, 100), bool)
    area[90, 10] = True
    drawing.draw_area(image, area)
    assert (image[90, 10] == BLUE).all()


def test_a_drawn_marker_has_outline_first_corner_axes_and_label():
    view = View(0.8, yaw=20.0)
    corners = true_corners(view)
    image = np.zeros((480, 640, 3), np.uint8)
    drawing.draw_axes(image, estimate_pose(corners, 0.2, CAMERA).best, 0.2, CAMERA)
    drawing.draw_marker(image, DetectedMarker(0, corners, 0, 1.0, np.eye(8)), "id 0  4.00 m")
    u, v = np.rint(corners[0]).astype(int)
    assert (image[v, u] == drawing.FIRST_CORNER).all()
    middle = 0.5 * (corners[1] + corners[2])
    near = image[int(middle[1]), int(middle[0]) - 2 : int(middle[0]) + 4].astype(int)
    assert (near[:, 1] > near[:, 0] + 30).any()
    top = int(corners[:, 1].min())
    assert image[top - 30 : top - 4].max() > 240


def test_text_stays_in_the_image():
    for place in ((-50, -50), (10_000, 10_000)):
        image = np.full((60, 200, 3), 128, np.uint8)
        drawing.draw_text(image, "text", place)
        assert image.max() > 240


def test_axes_behind_the_camera_are_not_drawn():
    image = np.zeros((480, 640, 3), np.uint8)
    pose = estimate_pose(true_corners(View(1.0)), 0.2, CAMERA).best
    drawing.draw_axes(image, pose, 5.0, CAMERA)
    assert image.max() == 0


def test_an_enlarged_marker_has_its_outline_where_the_marker_ends():
    view = View(3.0)
    image = image_of([marker()], view, samples=4)
    large = drawing.enlarged(np.dstack([image] * 3), true_corners(view), 400)
    assert large.shape == (400, 400, 3)
    green = (large == drawing.OUTLINE).all(axis=2)
    row, column = np.nonzero(green)
    side = 400 * 33.5 / (2 * 27 + 1)
    assert column.max() - column.min() == pytest.approx(side, abs=5.0)
    assert 0.5 * (row.max() + row.min()) == pytest.approx(200.0, abs=8.0)


@pytest.mark.parametrize(
    "encoding, channels", [("bgr8", 3), ("rgb8", 3), ("bgra8", 4), ("rgba8", 4)]
)
def test_grey_levels_of_colours(encoding, channels):
    pixels = np.zeros((20, 20, channels), np.uint8)
    pixels[:, :, 0] = 255
    blue_first = encoding.startswith("b")
    assert grey(pixels, encoding)[0, 0] == (29 if blue_first else 76)
    with pytest.raises(VisionError):
        grey(pixels, "mono8")
