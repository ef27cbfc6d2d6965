"""Drawing of detections into images."""

from __future__ import annotations

from typing import Sequence

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.vision.images import mean_side
from bullet_lab.vision.marker_detector import DetectedMarker
from bullet_lab.vision.pose_fit import MarkerPose

# Colours as in OpenCV: blue, green, red.
BLUE = (255, 0, 0)
OUTLINE = (60, 200, 60)
FIRST_CORNER = (40, 40, 230)
AXES = ((40, 40, 230), (60, 200, 60), (255, 80, 0))
_WHITE = (255, 255, 255)
_BLACK = (0, 0, 0)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_SCALE = 0.5
# Positions are drawn to 1/16 px.
_SHIFT = 4
# Radius of a point, px.
_RADIUS = 3
# Side in px of a marker that is drawn with broad lines.
_LARGE = 60.0


def draw_points(image: ndarray, points: ndarray) -> None:
    """Draw (n, 2 or more) points u, v as blue discs, as in figure 7c."""
    for u, v in np.rint(points[:, :2]).astype(int).tolist():
        cv2.circle(image, (u, v), _RADIUS, BLUE, -1)


def draw_area(image: ndarray, area: ndarray) -> None:
    """Colour an area (h, w) of an image blue, as in figure 7d."""
    image[area] = BLUE


def draw_marker(image: ndarray, marker: DetectedMarker, label: str) -> None:
    """Draw a marker's outline, its first corner and a label beside it."""
    draw_outline(image, marker.corners)
    left, bottom = marker.corners[:, 0].min(), marker.corners[:, 1].min() - 8
    draw_text(image, label, (int(left), int(bottom)))


def draw_outline(image: ndarray, corners: ndarray) -> None:
    """Draw (4, 2) corners as a quadrilateral, the first of them marked."""
    # A broad line would hide a small marker.
    width, half = (2, 3) if mean_side(corners) > _LARGE else (1, 1)
    outline = np.rint(corners * 2**_SHIFT).astype(np.int32)
    cv2.polylines(image, [outline[:, None]], True, OUTLINE, width, cv2.LINE_AA, _SHIFT)
    u, v = np.rint(corners[0]).astype(int).tolist()
    cv2.rectangle(image, (u - half, v - half), (u + half, v + half), FIRST_CORNER, -1)


def enlarged(image: ndarray, corners: ndarray, size: int) -> ndarray:
    """Return the part (size, size, 3) of a BGR image around a marker (4, 2), with its outline."""
    half = int(np.ceil(0.8 * mean_side(corners)))
    u, v = np.rint(corners.mean(axis=0)).astype(int).tolist()
    padded = cv2.copyMakeBorder(image, half, half, half, half, cv2.BORDER_REPLICATE)
    part = padded[v : v + 2 * half + 1, u : u + 2 * half + 1]
    large = cv2.resize(part, (size, size), interpolation=cv2.INTER_NEAREST)
    scale = size / part.shape[0]
    # The centre of a pixel is a whole number.
    draw_outline(large, (corners - (u - half, v - half) + 0.5) * scale - 0.5)
    return large


def draw_axes(image: ndarray, pose: MarkerPose, size: float, camera: PinholeCamera) -> None:
    """Draw a marker's axes, half its size long: x red, y green, z blue."""
    ends = 0.5 * size * np.vstack((np.zeros(3), np.eye(3)))
    pixels = camera.project(ends @ pose.rotation.T + pose.translation)
    if not np.isfinite(pixels).all() or np.abs(pixels).max() > 1e5:
        return
    points = list(map(tuple, np.rint(pixels * 2**_SHIFT).astype(int).tolist()))
    width = 2 if np.ptp(pixels, axis=0).max() > 0.5 * _LARGE else 1
    for end, colour in zip(points[1:], AXES):
        cv2.line(image, points[0], end, colour, width, cv2.LINE_AA, _SHIFT)


def draw_text(image: ndarray, text: str, place: Sequence[int]) -> None:
    """Write white text on black inside the image; `place` is the left end of the base line."""
    (width, height), base = cv2.getTextSize(text, _FONT, _SCALE, 1)
    u = int(np.clip(place[0], 2, max(2, image.shape[1] - width - 2)))
    v = int(np.clip(place[1], height + 4, image.shape[0] - base - 2))
    cv2.rectangle(image, (u - 2, v - height - 3), (u + width + 2, v + base), _BLACK, -1)
    cv2.putText(image, text, (u, v), _FONT, _SCALE, _WHITE, 1, cv2.LINE_AA)
