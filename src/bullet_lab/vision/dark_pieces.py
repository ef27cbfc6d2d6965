"""Pieces of an image that are darker than their neighbourhood, and their contours."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Iterator, NamedTuple, Tuple

import cv2
import numpy as np
from numpy import ndarray

# Least area of a quadrilateral, by the square of its outline's length: 1/16 of a square, a third
# of that of one that is seen at 80 degrees.
LEAST_AREA = 0.018
# Most points of a contour, by the width and height of the box around it. A convex one has 2.
_RAGGED = 2.2
# A border with a gap has an inner side as well, and the cells beside it may hang on it.
_OPEN_RAGGED = 8.0
# Most labels of 16 bits: OpenCV writes out of bounds with one more.
_MOST_LABELS = 65534
# A contour (n, 1, 2), and the offset of its u and v.
Placed = Tuple[ndarray, Tuple[int, int]]


def darker_part(grey: ndarray, window: int, part: float, contrast: int) -> ndarray:
    """Return a mask (h, w) of the pixels that are dark in their neighbourhood, as 255.

    Args:
        grey: (h, w) uint8.
        window: size of the neighbourhood, px.
        part: between its darkest (0) and its brightest level (1), up to which a pixel is dark.
        contrast: least difference of the two; where it is less, nothing is dark.
    """
    darkest, brightest = cv2.erode(grey, _square(window)), cv2.dilate(grey, _square(window))
    limit = cv2.addWeighted(darkest, 1.0 - part, brightest, part, 0.0)
    enough = cv2.compare(cv2.subtract(brightest, darkest), float(contrast), cv2.CMP_GE)
    return cv2.bitwise_and(cv2.compare(grey, limit, cv2.CMP_LE), enough)


@lru_cache(maxsize=None)
def _square(window: int) -> ndarray:
    return np.ones((window, window), np.uint8)


class DarkPieces(NamedTuple):
    """The pieces of a mask: labels (h, w), and (n, 5) u, v, width, height, area by label.

    Label 0 is the background; its area is 0.
    """

    labels: ndarray
    stats: ndarray


def dark_pieces(dark: ndarray, joined: bool) -> DarkPieces:
    """Return the pieces of a mask.

    Pixels of one piece touch at their edges or, if `joined`, at their corners.
    """
    # Labels of 16 bits are quicker. There are no more labels than runs of dark pixels in rows.
    runs = len(dark) * ((dark.shape[1] + 1) // 2)
    if runs > _MOST_LABELS:
        runs = len(dark) + cv2.countNonZero(cv2.subtract(dark[:, 1:], dark[:, :-1]))
    few = runs <= _MOST_LABELS
    # The quicker algorithm for each type; both number the pieces alike.
    joining = cv2.CCL_SPAGHETTI if few else cv2.CCL_BBDT
    connectivity, algorithm = (8, joining) if joined else (4, cv2.CCL_DEFAULT)
    kind = cv2.CV_16U if few else cv2.CV_32S
    _, labels, stats, _ = cv2.connectedComponentsWithStatsWithAlgorithm(
        dark, connectivity, kind, algorithm
    )
    stats[0] = 0
    return DarkPieces(labels, stats)


def contours_of(pieces: DarkPieces, min_side: float, is_open: bool = False) -> Iterator[Placed]:
    """Yield the outer contours of the pieces that are large and broad enough.

    If `is_open`, a piece may be a line, of which the contour has two sides.
    """
    labels, stats = pieces
    # Most pieces are too small.
    large = (stats[:, 2] + stats[:, 3] >= math.ceil(2.0 * min_side)).nonzero()[0]
    u, v, width, height, area = stats[large].T
    extent = width + height
    # A convex outline is no longer than that of the box around it; a border is some pixels wide.
    fits = area >= extent * (1.5 if is_open else np.clip(extent / 20.0, 1.5, 3.0))
    fits &= 8 * np.minimum(width, height) >= np.maximum(width, height)
    # A piece that reaches the edge of the image is cut off by it.
    fits &= np.minimum(u, v) > 0
    fits &= (u + width < labels.shape[1]) & (v + height < labels.shape[0])
    ragged = _OPEN_RAGGED if is_open else _RAGGED
    longest = (ragged * extent[fits]).tolist()
    for label, most in zip(large[fits].tolist(), longest):
        u, v, width, height, _ = stats[label].tolist()
        piece = (labels[v : v + height, u : u + width] == label).view(np.uint8)
        contours, _ = cv2.findContours(piece, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        if len(contours[0]) <= most:
            yield contours[0], (u, v)
