import math

import cv2
import numpy as np
import pytest
from picture_worlds import (
    CAMERA,
    FOCAL,
    checkers,
    plate,
    simulation_of,
    write_plate,
)

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.camera import Lens
from bullet_lab.simulation.rendering.graphics import RendererError
from bullet_lab.simulation.rendering.renderer import Shot

COLUMNS, ROWS, CELL = 10, 8, 0.1
PLACE = (2.0, 0.0, 1.0)
# The inner corners in the world.
CORNERS = np.array(
    [
        (PLACE[0], CELL * (COLUMNS / 2 - i), PLACE[2] + CELL * (ROWS / 2 - j))
        for j in range(1, ROWS)
        for i in range(1, COLUMNS)
    ]
)
BENT = (-0.25, 0.08, 0.001, -0.002, 0.01)
ODD = PinholeCamera(501, 333, 411.0, 370.0, 230.3, 190.8)


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    folder = tmp_path_factory.mktemp("board")
    path = write_plate(folder, "board", checkers(COLUMNS, ROWS), COLUMNS * CELL, ROWS * CELL)
    with simulation_of(plate(path, Pose(PLACE))) as simulation:
        yield simulation.renderer()


def in_optical_frame(pose, points):
    """Points of the world as a camera at a pose has them: x right, y down, z ahead."""
    local = [pose.inverse().rotate(tuple(p - np.array(pose.position))) for p in points]
    return np.array([(-y, -z, x) for x, y, z in local])


def errors_of_board(folder, models):
    """Offsets of the corners on the board, with other models beside it."""
    path = write_plate(folder, "board", checkers(COLUMNS, ROWS), COLUMNS * CELL, ROWS * CELL)
    models = [plate(path, Pose(PLACE)), *models]
    with simulation_of(*models) as simulation:
        return errors(simulation.renderer(), CAMERA, 1.0)


def errors(renderer, camera, samples, count=4):
    """Offsets of the corners in pictures from where the camera's geometry has them."""
    random = np.random.default_rng(1)
    lens = Lens(camera)
    found = []
    for _ in range(count):
        place = random.uniform((0.3, -0.3, 0.7), (1.0, 0.3, 1.3))
        pose = Pose.from_rpy(tuple(place), tuple(random.uniform(-0.1, 0.1, 3)))
        picture = lens.bend(renderer.picture(pose, Shot(lens.ideal, samples=samples)))
        assert picture.shape == (camera.height, camera.width, 3)
        pixels = camera.project(in_optical_frame(pose, CORNERS))
        edge = (camera.width - 21, camera.height - 21)
        pixels = pixels[((pixels > 20) & (pixels < edge)).all(axis=1)]
        start = (pixels + random.normal(0, 0.3, pixels.shape)).astype(np.float32)
        grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
        seen = cv2.cornerSubPix(grey, start[:, None].copy(), (5, 5), (-1, -1), criteria)[:, 0]
        found.append(seen - pixels)
    return np.concatenate(found)


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("distortion", [(0.0,) * 5, BENT])
def test_corners_are_seen_where_camera_info_has_them(board, samples, distortion):
    camera = PinholeCamera(640, 480, FOCAL, FOCAL, 319.5, 239.5, distortion)
    offsets = errors(board, camera, samples)
    assert len(offsets) > 150
    assert np.abs(offsets.mean(axis=0)).max() < 0.02
    assert np.hypot(*offsets.T).mean() < 0.1


def test_any_principal_point_and_focal_lengths(board):
    offsets = errors(board, ODD, 1.0)
    assert np.abs(offsets.mean(axis=0)).max() < 0.02
    assert np.hypot(*offsets.T).mean() < 0.1


def test_pictures_larger_than_the_frame_buffer(board):
    offsets = errors(board, PinholeCamera(1600, 1000, 1300.0, 1300.0, 799.5, 499.5), 1.0, count=2)
    assert np.abs(offsets.mean(axis=0)).max() < 0.03
    assert np.hypot(*offsets.T).mean() < 0.1


def test_near_and_far_end_the_view(board):
    pose = Pose((1.0, 0.0, 1.0))
    middle = (slice(200, 280), slice(280, 360))
    blue = (0, 0, 255)
    assert (board.picture(pose, Shot(CAMERA, near=1.1))[middle] == blue).all()
    assert (board.picture(pose, Shot(CAMERA, near=0.1, far=0.9))[middle] == blue).all()
    assert (board.picture(pose, Shot(CAMERA, near=0.9, far=1.1))[middle] != blue).any(axis=-1).all()


@pytest.mark.parametrize(
    "wrong",
    [
        {"near": 0.0},
        {"near": 1.0, "far": 1.0},
        {"far": float("inf")},
        {"samples": 0},
        {"samples": 3},
        {"samples": 8},
        {"samples": float("nan")},
        {"camera": PinholeCamera(64, 48, 50, 50, 31, 23, BENT)},
    ],
)
def test_impossible_shots_are_refused(wrong):
    with pytest.raises(RendererError):
        Shot(**{"camera": CAMERA, **wrong})


# One of a real lens with a wide view; one that bends outwards; those that fold, at the slope where
# r (1 + k1 r²) is greatest.
STRONG = [
    ((-0.279817, 0.060321, 0.00031, 0.0, 0.000487), 228.8),
    ((9.0, 0.0, 0.0, 0.0, 0.0), 300.0),
    ((-0.9, 0.0, 0.0, 0.0, 0.0), 300.0),
    ((-2.0, 0.0, 0.01, 0.02, 0.0), 300.0),
]


@pytest.mark.parametrize(("distortion", "focal"), STRONG)
def test_where_a_lens_shows_nothing_its_picture_is_black(distortion, focal):
    camera = PinholeCamera(640, 480, focal, focal, 319.5, 239.5, distortion)
    lens = Lens(camera)
    black = 0.0
    if distortion[0] < -0.5:
        radius = focal * 2.0 / 3.0 / np.sqrt(-3.0 * distortion[0])
        black = 1.0 - np.pi * radius**2 / (640 * 480)
    assert lens.black == pytest.approx(black, abs=0.005)
    picture = lens.bend(np.full((lens.ideal.height, lens.ideal.width, 3), 255, np.uint8))
    dark = (picture == 0).all(axis=2)
    assert dark.mean() == pytest.approx(lens.black, abs=0.005)
    depths = lens.pick(np.ones((lens.ideal.height, lens.ideal.width), np.float32))
    assert np.array_equal(np.isnan(depths), dark)
    assert lens.ideal.width <= 3 * camera.width + 4


@pytest.mark.parametrize(("distortion", "focal"), STRONG)
def test_slopes_are_the_inverse_of_a_projection(distortion, focal):
    camera = PinholeCamera(640, 480, focal, focal, 319.5, 239.5, distortion)
    pixels = np.indices((640, 480)).reshape(2, -1).T.astype(float)
    slopes = camera.slopes(pixels)
    there = np.isfinite(slopes).all(axis=1)
    back = camera.project(np.column_stack((slopes[there], np.ones(there.sum()))))
    assert np.abs(back - pixels[there]).max() < 1e-3


def test_a_lens_that_shows_nothing_is_refused():
    with pytest.raises(RendererError, match="leaves nothing"):
        Lens(PinholeCamera(2, 2, 1.0, 1.0, 900.0, 900.0, (-9.0, 0, 0, 0, 0)))


@pytest.mark.parametrize("degrees", [40, 80, 120])
@pytest.mark.parametrize(("width", "height"), [(320, 240), (640, 480), (1920, 1080)])
def test_corners_all_over_the_picture(tmp_path, width, height, degrees):
    focal = 0.5 * width / math.tan(0.5 * math.radians(degrees))
    camera = PinholeCamera(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))
    # Nine cells across, from 1 m, and more than is seen. Texels of four pixels: a sharper edge is
    # found less exactly than it is drawn.
    columns, rows, cell, half = 18, 14, width / 9 / focal, min(12, width // 36)
    pixels = checkers(columns, rows, width // 36)
    path = write_plate(tmp_path, "wide", pixels, columns * cell, rows * cell)
    points = np.array(
        [
            (0.0, cell * (columns / 2 - i), cell * (rows / 2 - j))
            for j in range(1, rows)
            for i in range(1, columns)
        ]
    )
    random = np.random.default_rng(2)
    found = []
    with simulation_of(plate(path, Pose())) as simulation:
        for _ in range(3):
            place = (-1.0, *(cell * random.uniform(-0.5, 0.5, 2)))
            pose = Pose.from_rpy(place, tuple(random.uniform(-0.06, 0.06, 3)))
            picture = simulation.renderer().picture(pose, Shot(camera))
            there = camera.project(in_optical_frame(pose, points))
            edge = (width - half - 3, height - half - 3)
            there = there[((there > half + 2) & (there < edge)).all(axis=1)]
            grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
            start = there.astype(np.float32)[:, None].copy()
            seen = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), criteria)[:, 0]
            found.append(seen - there)
    assert len(np.concatenate(found)) > 100
    assert np.hypot(*np.concatenate(found).T).max() < 0.05
