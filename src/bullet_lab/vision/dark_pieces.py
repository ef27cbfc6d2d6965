"""Pieces of an image that are darker than their neighbourhood, and their contours."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Dict, Iterator, List, NamedTuple, Tuple

import cv2
import numpy as np

# Least area of a quadrilateral, by the square of its outline's length: 1/16 of a square, a third
# of that of one that is seen at 80 degrees.
LEAST_AREA = 0.018
# Most points of a contour, by the width and height of the box around it. A convex one has 2.
_RAGGED = 2.2
# A border with a gap has an inner side as well, and the cells beside it may hang on it.
_OPEN_RAGGED = 8.0
# Most labels of 16 bits: OpenCV writes out of bounds with one more.
_MOST_LABELS = 65534
# Pieces smaller than this each way are traced together, px.
_TILE = 24
_OUTER = cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
# A contour (n, 1, 2), and the offset of its u and v.
Placed = Tuple[np.ndarray, Tuple[int, int]]


def darker_part(grey: np.ndarray, window: int, part: float, contrast: int) -> np.ndarray:
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
def _square(window: int) -> np.ndarray:
    return np.ones((window, window), np.uint8)


class DarkPieces(NamedTuple):
    """The pieces of a mask: labels (h, w), and (n, 5) u, v, width, height, area by label.

    Label 0 is the background; its area is 0.
    """

    labels: np.ndarray
    stats: np.ndarray


def dark_pieces(dark: np.ndarray, joined: bool) -> DarkPieces:
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
    large, most = large[fits], (ragged * extent[fits]).tolist()
    for placed, longest in zip(_contours(labels, large, stats[large, :4]), most):
        if len(placed[0]) <= longest:
            yield placed


def _contours(labels: np.ndarray, labelled: np.ndarray, boxes: np.ndarray) -> List[Placed]:
    """Return the outer contours of pieces that do not reach the edge of the image, in order.

    Args:
        labels: (h, w) label of each pixel.
        labelled: (n,) labels of the pieces.
        boxes: (n, 4) u, v, width, height of each.
    """
    contours: Dict[int, Placed] = {}
    is_small = boxes[:, 2:].max(axis=1, initial=0) < _TILE
    small, large = np.flatnonzero(is_small), np.flatnonzero(~is_small)
    if len(small):
        traced = _small_contours(labels, labelled[small], boxes[small, :2])
        contours.update(zip(small.tolist(), traced))
    for k, label, box in zip(large.tolist(), labelled[large].tolist(), boxes[large].tolist()):
        u, v, width, height = box
        piece = (labels[v : v + height, u : u + width] == label).view(np.uint8)
        contours[k] = cv2.findContours(piece, *_OUTER)[0][0], (u, v)
    return [contours[k] for k in range(len(labelled))]


def _small_contours(labels: np.ndarray, labelled: np.ndarray, corners: np.ndarray) -> List[Placed]:
    """Return the contours of pieces smaller than a tile; `corners` (n, 2) are u, v of their boxes.

    All are traced in one image, one below the other: calling OpenCV for each takes longer than
    tracing it.
    """
    height, width = labels.shape
    rows, columns = min(_TILE, height), min(_TILE, width)
    # The last row of a tile is empty, as no piece reaches the last row of the image.
    corners = np.minimum(corners, (width - columns, height - rows))
    shape = (height - rows + 1, width - columns + 1, rows, columns)
    windows = np.ndarray(shape, labels.dtype, labels, strides=labels.strides * 2)
    tiles = windows[corners[:, 1], corners[:, 0]] == labelled.astype(labels.dtype)[:, None, None]
    below = cv2.findContours(tiles.reshape(-1, columns).view(np.uint8), *_OUTER)[0]
    contours = {int(contour[0, 0, 1]) // rows: contour for contour in below}
    return [(contours[k], (u, v - rows * k)) for k, (u, v) in enumerate(corners.tolist())]
