"""Where corners are seen, what a view ends at, and what a lens shows."""

import cv2
import numpy as np
import pytest
import yaml
from picture_worlds import CAMERA, checkers, plate, simulation_of, thing, write_plate
from shared import cases

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.lenses import Lens
from bullet_lab.simulation.rendering import RendererError
from bullet_lab.simulation.rendering.renderer import Shot
from bullet_lab.simulation.world.description import Box

CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)


def inner_corners(columns, rows, cell):
    """The inner corners of a board about the origin, (n, 3)."""
    y, z = np.arange(columns // 2 - 1, -columns // 2, -1), np.arange(rows // 2 - 1, -rows // 2, -1)
    return cell * np.stack(np.meshgrid([0.0], y, z), axis=-1).reshape(-1, 3)


def offsets(renderer, camera, corners, poses, half, samples=1):
    """Offsets in px of corners in pictures, from where the camera's geometry has them."""
    lens, found = Lens(camera), []
    shot = Shot(lens.ideal, samples=samples)
    for pose in poses:
        picture = lens.picture(lambda turn, at=pose: renderer.picture(at * turn, shot))
        assert picture.shape == (camera.height, camera.width, 3)
        local = (corners - pose.position) @ pose.rotation_matrix()
        pixels = camera.project(np.column_stack((-local[:, 1], -local[:, 2], local[:, 0])))
        edge = (camera.width - half - 3, camera.height - half - 3)
        pixels = pixels[((pixels > half + 2) & (pixels < edge)).all(axis=1)]
        start = pixels.astype(np.float32)[:, None] + 0.25
        grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        seen = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), CRITERIA)[:, 0]
        found.append(seen - pixels)
    return np.concatenate(found)


@cases("""
camera, samples:
  # Width and height, focal lengths, middle, and distortion; and samples.
  - [[320, 240, 439.596, 439.596, 159.5, 119.5], 1]
  - [[1920, 1080, 554.256, 554.256, 959.5, 539.5], 1]
  - [[640, 480, 502.3, 502.3, 319.5, 239.5], 4]
  - [[501, 333, 411.0, 370.0, 230.3, 190.8], 1]
  - [[640, 480, 502.3, 502.3, 319.5, 239.5, [-0.25, 0.08, 0.001, -0.002, 0.01]], 1]
""")
def test_corners_are_seen_where_camera_info_has_them(tmp_path, camera, samples):
    camera = PinholeCamera(*camera)
    # Nine cells across, from 1 m, and more than is seen. Texels of four pixels: a sharper edge is
    # found less exactly than it is drawn.
    columns, rows, cell = 18, 14, camera.width / 9 / camera.fx
    pixels = checkers(columns, rows, camera.width // 36)
    path = write_plate(tmp_path, "wide", pixels, columns * cell, rows * cell)
    random, poses = np.random.default_rng(1), []
    for _ in range(3):
        y, z = random.uniform(-0.5 * cell, 0.5 * cell, 2)
        poses.append(Pose.from_rpy((-1.0, y, z), tuple(random.uniform(-0.06, 0.06, 3))))
    with simulation_of(plate(path, Pose())) as simulation:
        corners, half = inner_corners(columns, rows, cell), min(12, camera.width // 36)
        found = offsets(simulation.renderer(), camera, corners, poses, half, samples)
    assert len(found) > 100
    assert np.abs(found.mean(axis=0)).max() < 0.01
    assert np.hypot(*found.T).max() < 0.05


def test_near_and_far_end_the_view():
    wall = thing("wall", Box((0.1, 9.0, 9.0)), Pose((1.05, 0.0, 0.0)))
    with simulation_of(wall) as simulation:

        def blue(**limits):
            picture = simulation.renderer().picture(Pose(), Shot(CAMERA, **limits))
            return (picture[240, 320] == (0, 0, 255)).all()

        assert blue(near=1.2)
        assert blue(near=0.1, far=0.9)
        assert not blue(near=0.9, far=1.1)


BENT = PinholeCamera(64, 48, 50, 50, 31, 23, (-0.25, 0.08, 0.001, -0.002, 0.01))
WRONG = """
[{near: 0.0}, {near: 1.0, far: 1.0}, {far: .inf}, {samples: 0}, {samples: 3}, {samples: .nan}]
"""


@pytest.mark.parametrize("wrong", [{"camera": BENT}, *yaml.safe_load(WRONG)])
def test_impossible_shots_are_refused(wrong):
    with pytest.raises(RendererError):
        Shot(**{"camera": CAMERA, **wrong})


@cases("""
distortion, focal:
  # One of a real lens with a wide view; one that bends outwards; those that fold, at the slope
  # where r (1 + k1 r²) is greatest.
  - [[-0.279817, 0.060321, 0.00031, 0.0, 0.000487], 228.8]
  - [[9.0, 0.0, 0.0, 0.0, 0.0], 300.0]
  - [[-0.9, 0.0, 0.0, 0.0, 0.0], 300.0]
  - [[-2.0, 0.0, 0.01, 0.02, 0.0], 300.0]
""")
def test_where_a_lens_shows_nothing_its_picture_is_black(distortion, focal):
    camera = PinholeCamera(640, 480, focal, focal, 319.5, 239.5, distortion)
    lens = Lens(camera)
    black = 0.0
    if distortion[0] < -0.5:
        radius = focal * 2.0 / 3.0 / np.sqrt(-3.0 * distortion[0])
        black = 1.0 - np.pi * radius**2 / (640 * 480)
    assert lens.black == pytest.approx(black, abs=0.005)
    size = (lens.ideal.height, lens.ideal.width)
    dark = (lens.picture(lambda _: np.full((*size, 3), 255, np.uint8)) == 0).all(axis=2)
    assert dark.mean() == pytest.approx(lens.black, abs=0.005)
    assert np.array_equal(np.isnan(lens.pick(np.ones(size, np.float32))), dark)
    assert lens.ideal.width <= 3 * camera.width + 4
    # Slopes are the inverse of a projection.
    pixels = np.indices((640, 480)).reshape(2, -1).T.astype(float)
    slopes = camera.slopes(pixels)
    there = np.isfinite(slopes).all(axis=1)
    back = camera.project(np.column_stack((slopes[there], np.ones(there.sum()))))
    assert np.abs(back - pixels[there]).max() < 1e-3


def test_a_lens_that_shows_nothing_is_refused():
    with pytest.raises(RendererError, match="leaves nothing"):
        Lens(PinholeCamera(2, 2, 1.0, 1.0, 900.0, 900.0, (-9.0, 0, 0, 0, 0)))
