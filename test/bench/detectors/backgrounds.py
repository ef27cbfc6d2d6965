"""Photographs that Python packages ship, as backgrounds of 640x480, and pictures without one."""

import importlib.util
from pathlib import Path

import cv2
import numpy as np

SIZE = (640, 480)
# Packages and their folders; what they would download is passed over.
_FOLDERS = (
    ("skimage", "data"),
    ("sklearn", "datasets/images"),
    ("matplotlib", "mpl-data/sample_data"),
)
_KINDS = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
# px, and grey levels of standard deviation: less is no photograph.
_LEAST_EDGE, _LEAST_SPREAD = 128, 10.0


def photographs():
    """Return the photographs by name, (480, 640) grey levels, cut to that shape in their middle."""
    return {name: _fitted(image) for name, image in originals().items()}


def originals():
    """Return the photographs by name as they are, grey levels."""
    found = {}
    for package, folder in _FOLDERS:
        spec = importlib.util.find_spec(package)
        # Debian's packages come without.
        for place in (spec and spec.submodule_search_locations) or ():
            for path in sorted(Path(place, folder).glob("*")):
                image = _read(path) if path.suffix.lower() in _KINDS else None
                if image is not None:
                    found[path.name] = image
    return found


def _read(path):
    """Return a photograph; None where it is too small or too even for one."""
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None or min(image.shape) < _LEAST_EDGE or image.std() < _LEAST_SPREAD:
        return None
    return image


def _fitted(image):
    height, width = image.shape
    scale = max(SIZE[0] / width, SIZE[1] / height)
    size = (max(SIZE[0], round(scale * width)), max(SIZE[1], round(scale * height)))
    how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_CUBIC
    image = cv2.resize(image, size, interpolation=how)
    left, top = (size[0] - SIZE[0]) // 2, (size[1] - SIZE[1]) // 2
    return np.ascontiguousarray(image[top : top + SIZE[1], left : left + SIZE[0]])


def crops(image, count, size, seed):
    """Yield pieces of a photograph (width, height) px: anywhere, scaled, turned and mirrored.

    Args:
        image: grey levels.
        count: so many.
        size: of a piece.
        seed: of places, scales and turns.
    """
    rng = np.random.default_rng(seed)
    for _ in range(count):
        piece = np.rot90(image, int(rng.integers(4)))
        if rng.random() < 0.5:
            piece = piece[:, ::-1]
        least = max(size[0] / piece.shape[1], size[1] / piece.shape[0])
        scale = max(least, float(np.exp(rng.uniform(np.log(0.3), np.log(2.0)))))
        width, height = int(size[0] / scale), int(size[1] / scale)
        left = int(rng.integers(piece.shape[1] - width + 1))
        top = int(rng.integers(piece.shape[0] - height + 1))
        part = np.ascontiguousarray(piece[top : top + height, left : left + width])
        how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
        piece = cv2.resize(part, size, interpolation=how).astype(np.float32)
        gain, offset = rng.uniform(0.6, 1.2), rng.uniform(-20.0, 20.0)
        yield np.clip(np.rint(gain * piece + offset), 0.0, 255.0).astype(np.uint8)
