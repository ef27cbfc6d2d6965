"""Renderings of a marker on photographs, of which everything is known."""

import math
from typing import NamedTuple

import cv2
import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.vision.dictionaries import dictionary_named

CAMERA = PinholeCamera(640, 480, 502.3, 502.3, 319.5, 239.5)
CANVAS = (CAMERA.width, CAMERA.height)
SIZE = 0.2
"""Edge of the marker's black square, m; one cell of white is around it."""

# px between a marker's quiet zone and the edge of the image.
_MARGIN = 6.0
# Points in a pixel, each way, and points of a marker at most.
_MOST_SAMPLES, _MOST_POINTS = 16, 1.5e6
_UNIT = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])


class Conditions(NamedTuple):
    """How a marker is seen.

    Attributes:
        distance: from the camera to its middle, m.
        angle: between its axis and the line of sight, degrees.
        blur: of the lens, standard deviation in px.
        motion: length of the way that the picture moves while it is taken, px.
        noise: standard deviation of a pixel in grey levels.
        contrast: white less black, as a share of 255.
        occlusion: share of the black square that something is in front of.
        glare: brightness of a highlight on it, as a share of 255.
    """

    distance: float = 2.0
    angle: float = 0.0
    blur: float = 0.5
    motion: float = 0.0
    noise: float = 2.0
    contrast: float = 0.7
    occlusion: float = 0.0
    glare: float = 0.0


class Scene(NamedTuple):
    """A picture of one marker.

    Attributes:
        image: (480, 640) grey levels.
        marker: its id.
        corners: (4, 2) px, from its top left clockwise.
        rotation: (3, 3), of the marker in the optical frame.
        translation: (3,) m.
    """

    image: np.ndarray
    marker: int
    corners: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray


def draw_scene(conditions, backgrounds, seed):
    """Draw pose, marker, light and background at random, and take the picture.

    Args:
        conditions: what is not drawn.
        backgrounds: (480, 640) uint8 each, of which one is taken, and another is in front.
        seed: the same numbers give the same scene.
    """
    rng = np.random.default_rng(seed)
    tags = dictionary_named("apriltag_36h11")
    marker = int(rng.integers(len(tags.codes)))
    rotation, translation = _draw_pose(conditions, rng)
    corners = CAMERA.project(_UNIT * (0.5 * SIZE) @ rotation.T + translation)
    canvas = backgrounds[int(rng.integers(len(backgrounds)))].astype(np.float32)
    black, white = _levels(conditions, canvas, corners, rng)
    cells = np.pad(tags.pattern(marker).astype(np.float32), 1, constant_values=1.0)
    outline = CAMERA.project(
        _UNIT * (0.5 * SIZE * len(cells) / (len(cells) - 2)) @ rotation.T + translation
    )
    paint(canvas, black + (white - black) * cells, outline)
    if conditions.occlusion:
        other = backgrounds[int(rng.integers(len(backgrounds)))].astype(np.float32)
        _hide(canvas, other, corners, conditions.occlusion, rng)
    canvas *= _light(rng)
    if conditions.glare:
        canvas += _highlight(corners, rng) * np.float32(255.0 * conditions.glare)
    if conditions.motion:
        kernel = _motion_kernel(conditions.motion, float(rng.uniform(0.0, math.pi)))
        canvas = cv2.filter2D(canvas, -1, kernel, borderType=cv2.BORDER_REPLICATE)
    if conditions.blur:
        canvas = cv2.GaussianBlur(canvas, (0, 0), conditions.blur)
    canvas += conditions.noise * rng.standard_normal(canvas.shape, dtype=np.float32)
    image = np.clip(np.rint(canvas), 0.0, 255.0).astype(np.uint8)
    return Scene(image, marker, corners, rotation, translation)


def paint(canvas, cells, outline):
    """Paint square cells (n, n) into (h, w), each pixel the mean of what it sees of them.

    Args:
        canvas: grey levels, float32; changed.
        cells: grey levels, float32.
        outline: (4, 2) px, from the cells' top left clockwise.
    """
    height, width = canvas.shape
    left, top = np.maximum(np.floor(outline.min(axis=0)).astype(int) - 1, 0)
    right, bottom = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 2, (width, height))
    area = float((right - left) * (bottom - top))
    fine = int(np.clip(math.sqrt(_MOST_POINTS / area), 2, _MOST_SAMPLES))
    size = (int(right - left) * fine, int(bottom - top) * fine)
    n = float(len(cells))
    source = np.array([[0, 0], [n, 0], [n, n], [0, n]], dtype=np.float32) - 0.5
    there = (outline - (left, top) + 0.5) * fine - 0.5
    to_fine = cv2.getPerspectiveTransform(source, there.astype(np.float32))
    seen = [
        cv2.resize(
            cv2.warpPerspective(values, to_fine, size, flags=cv2.INTER_NEAREST),
            (right - left, bottom - top),
            interpolation=cv2.INTER_AREA,
        )
        for values in (cells, np.ones_like(cells))
    ]
    part = canvas[top:bottom, left:right]
    part[:] = seen[0] + (1.0 - seen[1]) * part


def _draw_pose(conditions, rng):
    """Return a pose with the whole marker in the picture: (3, 3) and (3,)."""
    reach = 0.5 * SIZE * 1.25
    while True:
        u, v = rng.uniform(0.0, CAMERA.width), rng.uniform(0.0, CAMERA.height)
        sight = np.array([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, 1.0])
        sight /= np.linalg.norm(sight)
        # Facing the camera, turned about its normal, tilted about an axis across the sight.
        facing = np.diag([1.0, -1.0, -1.0])
        roll = cv2.Rodrigues(np.array([0.0, 0.0, rng.uniform(-math.pi, math.pi)]))[0]
        direction = rng.uniform(-math.pi, math.pi)
        axis = np.array([math.cos(direction), math.sin(direction), 0.0])
        tilt = cv2.Rodrigues(math.radians(conditions.angle) * axis)[0]
        across = np.cross([0.0, 0.0, 1.0], sight)
        sine = float(np.linalg.norm(across))
        aim = np.eye(3)
        if sine > 1e-9:
            aim = cv2.Rodrigues(across / sine * math.asin(min(1.0, sine)))[0]
        rotation = aim @ tilt @ facing @ roll
        translation = conditions.distance * sight
        seen = CAMERA.project(reach * _UNIT @ rotation.T + translation)
        if (seen > _MARGIN).all() and (seen < np.array(CANVAS) - _MARGIN).all():
            return rotation, translation


def _levels(conditions, canvas, corners, rng):
    """Return grey levels of black and white around what is behind the marker."""
    spread = 255.0 * conditions.contrast
    u, v = corners.mean(axis=0).astype(int)
    around = float(canvas[max(0, v - 20) : v + 20, max(0, u - 20) : u + 20].mean())
    low = float(np.clip(around - spread * rng.uniform(0.3, 0.7), 12.0, 235.0 - spread))
    return low, low + spread


def _light(rng):
    """Return the brightness of the light over the picture, which falls off to one side."""
    slope = rng.uniform(-0.15, 0.15, 2)
    across, down = (np.linspace(-1.0, 1.0, size, dtype=np.float32) for size in CANVAS)
    return (1.0 + slope[0] * across + slope[1] * down[:, None]).astype(np.float32)


def _hide(
    canvas,
    front,
    corners,
    share,
    rng,
):
    """Put a disc of another picture over a share of the black square, across its edge."""
    side = int(rng.integers(4))
    place = rng.uniform(0.0, 1.0)
    middle = corners[side] + place * (corners[(side + 1) % 4] - corners[side])
    square = np.zeros(canvas.shape, np.uint8)
    cv2.fillConvexPoly(square, np.rint(corners * 16).astype(np.int32), 1, shift=4)
    away = np.sqrt(_squared_distances(middle))
    inside = np.sort(away[square > 0])
    radius = float(inside[min(len(inside) - 1, int(share * len(inside)))])
    cover = np.clip(radius - away + 0.5, 0.0, 1.0)
    canvas += cover * (front - canvas)


def _highlight(corners, rng):
    """Return a smooth highlight on a marker, 1 in its middle."""
    middle = corners.mean(axis=0)
    place = middle + rng.uniform(-0.5, 0.5) * (corners[0] - middle)
    width = 0.25 * float(np.linalg.norm(corners[2] - corners[0]))
    return np.exp(-0.5 * _squared_distances(place) / np.float32(width) ** 2)


def _squared_distances(place):
    """Return the squares of all pixels' distances from a place, px²."""
    rows, columns = np.indices(CANVAS[::-1], dtype=np.float32)
    return (columns - np.float32(place[0])) ** 2 + (rows - np.float32(place[1])) ** 2


def _motion_kernel(length, direction):
    """Return the kernel of a straight way of a length in px."""
    half = int(math.ceil(0.5 * length)) + 1
    fine = np.linspace(-0.5 * length, 0.5 * length, int(16 * length) + 1)
    u, v = half + fine * math.cos(direction), half + fine * math.sin(direction)
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    column, row = np.floor(u).astype(int), np.floor(v).astype(int)
    right, down = u - column, v - row
    for step_right, step_down in ((0, 0), (1, 0), (0, 1), (1, 1)):
        weight = np.where(step_right, right, 1.0 - right) * np.where(step_down, down, 1.0 - down)
        np.add.at(kernel, (row + step_down, column + step_right), weight)
    return kernel / kernel.sum()
