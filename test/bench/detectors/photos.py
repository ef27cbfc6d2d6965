"""Detectors on a folder of photographs, of which nothing is known: their consensus is the truth."""

import time

import cv2
import numpy as np

_KINDS = (".jpg", ".jpeg", ".png", ".bmp", ".pgm", ".pnm", ".tif", ".tiff")
# Two findings are of one marker if their middles are nearer than this part of a diagonal.
_NEAR = 0.25


def pictures(folder):
    """Return the pictures in a folder and the folders in it."""
    return sorted(path for path in folder.rglob("*") if path.suffix.lower() in _KINDS)


def consensus(found):
    """Return the markers of a picture, each as the corners by the detectors that found it.

    >>> square = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]])
    >>> both = consensus({"a": [(1, square)], "b": [(1, square + 1.0), (2, square)]})
    >>> [sorted(marker) for marker in both]
    [['a', 'b'], ['b']]
    """
    markers = []
    for name, each in found.items():
        for number, corners in each:
            for other, by in markers:
                first = next(iter(by.values()))
                away = np.linalg.norm(corners.mean(axis=0) - first.mean(axis=0))
                size = np.linalg.norm(first[2] - first[0])
                if other == number and name not in by and away < _NEAR * size:
                    by[name] = corners
                    break
            else:
                markers.append((number, {name: corners}))
    return [by for _, by in markers]


def on_photos(folder, finders):
    """Return figures by detector: found of those that two or more found, found alone, corners, ms.

    Corners are compared with the median of the other detectors', where there are two.
    """
    times = {name: [] for name in finders}
    markers = []
    for path in pictures(folder):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            continue
        found = {}
        for name, find in finders.items():
            start = time.process_time()
            found[name] = find(image)
            times[name].append(1e3 * (time.process_time() - start))
        markers += consensus(found)
    agreed = [by for by in markers if len(by) > 1]
    return {
        name: {
            "pictures": len(times[name]),
            "agreed": len(agreed),
            "found": sum(name in by for by in agreed),
            "alone": sum(set(by) == {name} for by in markers),
            "corners_px": _median([_off(by, name) for by in agreed if name in by and len(by) > 2]),
            "median_ms": _median(times[name]),
        }
        for name in finders
    }


def _off(by, name):
    others = np.median([corners for other, corners in by.items() if other != name], axis=0)
    return float(np.linalg.norm(by[name] - others, axis=1).max())


def _median(values):
    return float(np.median(values)) if len(values) else None
