"""What a lens and a sensor do to an ideal picture: distortion, blur and noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import cv2
import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.errors import LabError
from bullet_lab.simulation.rendering.graphics import SAMPLES

# Numbers in the table of noise beyond those of one picture: so many pictures differ.
SPARE_NOISE = 1 << 20
WHITE = 255.0
# The ideal picture behind a distorted one is this many times larger at most.
WIDEST = 3.0
# Outside of every picture.
NOWHERE = -10.0


class FinishError(LabError):
    """Settings of a camera, or a lens, that make no picture."""


@dataclass(frozen=True)
class CameraSettings:
    """What may change between two pictures of a camera.

    Attributes:
        samples: of each pixel, 1, 2 or 4.
        exposure: factor to the brightness.
        blur: standard deviation of the blur in pixels.
        noise_mean: of what is added to each number of the picture, as a share of white.
        noise_stddev: its standard deviation, likewise.
    """

    samples: int = 1
    exposure: float = 1.0
    blur: float = 0.0
    noise_mean: float = 0.0
    noise_stddev: float = 0.0

    def __post_init__(self) -> None:
        """Raise FinishError for a number that is not finite or out of its range."""
        values = (self.samples, self.exposure, self.blur, self.noise_mean, self.noise_stddev)
        if not all(map(math.isfinite, values)):
            raise FinishError("a camera's setting is not finite")
        if self.samples not in SAMPLES:
            known = ", ".join(map(str, SAMPLES))
            raise FinishError(f"{self.samples:g} samples for each pixel are not one of {known}")
        if min(self.exposure, self.blur, self.noise_stddev) < 0.0:
            raise FinishError("exposure, blur and the noise's deviation are not negative")
        if abs(self.noise_mean) > 1.0 or self.noise_stddev > 1.0:
            raise FinishError("noise is given as a share of white, 1 at most")


class SensorNoise:
    """Normal noise on pictures, drawn once and read from a random place for each picture.

    Numbers for each pixel of each frame would cost as much as drawing it. Within one picture all
    are independent; two share numbers, but at other pixels, unless their places happen to be the
    same (one in a million). Mean and deviation are shares of white.
    """

    def __init__(self, mean: float, stddev: float, count: int, random: np.random.Generator):
        noise = random.standard_normal(count + SPARE_NOISE, dtype=np.float32)
        noise = np.rint(WHITE * (mean + stddev * noise))
        # Apart, since adding and subtracting bytes is fast and stops at black and white.
        self._more = np.clip(noise, 0, 255).astype(np.uint8)
        self._less = np.clip(-noise, 0, 255).astype(np.uint8)

    def add_to(self, picture: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """Return the picture with noise; `random` draws the place."""
        first = int(random.integers(SPARE_NOISE))
        part = slice(first, first + picture.size)
        more, less = (a[part].reshape(picture.shape) for a in (self._more, self._less))
        return cv2.subtract(cv2.add(picture, more), less)


def blurred(picture: np.ndarray, sigma: float) -> np.ndarray:
    """Return the picture with a normal blur of `sigma` pixels, as uint8.

    Of float32, what is beyond white is cut off afterwards.
    """
    if sigma <= 0.0:
        return picture
    picture = cv2.GaussianBlur(picture, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return picture if picture.dtype == np.uint8 else cv2.convertScaleAbs(picture)


class Lens:
    """A distorting lens: which ideal picture to draw, and how to bend it into a camera's.

    Where a lens that bends strongly shows nothing, or only what would need far too large a picture,
    its own is black.

    Attributes:
        camera: what it is the lens of.
        ideal: the camera without distortion that is to draw.
        black: the share of the pixels that show nothing.

    Raises:
        FinishError: it shows nothing at all.
    """

    def __init__(self, camera: PinholeCamera):
        self.camera = self.ideal = camera
        self.black = 0.0
        self._map: Optional[np.ndarray] = None
        if any(camera.distortion):
            self.ideal, self._map = _bent(camera)
            self.black = float(np.mean(self._map[0] == NOWHERE))

    def bend(self, picture: np.ndarray) -> np.ndarray:
        """Return the picture of `camera`, given that of `ideal`."""
        return picture if self._map is None else cv2.remap(picture, *self._map, cv2.INTER_LINEAR)

    def pick(self, values: np.ndarray) -> np.ndarray:
        """Return the values of `camera`'s pixels, given those of `ideal`: of the nearest pixel.

        Between the depths of two things there is nothing, so they are not mixed.
        """
        if self._map is None:
            return values
        return cv2.remap(values, *self._map, cv2.INTER_NEAREST, borderValue=math.nan)

    def slopes(self) -> np.ndarray:
        """Return x/z and y/z of what each pixel sees in the optical frame: (2, height, width)."""
        camera, places = self.ideal, self._map
        if places is None:
            places = np.indices((camera.height, camera.width))[::-1]
        slopes = (places[0] - camera.cx) / camera.fx, (places[1] - camera.cy) / camera.fy
        return np.array(slopes, dtype=np.float32)


def _bent(camera: PinholeCamera) -> Tuple[PinholeCamera, np.ndarray]:
    """Return the ideal camera behind a lens, and where each pixel looks in its picture."""
    pixels = np.indices((camera.height, camera.width))[::-1].reshape(2, -1).T.astype(float)
    centre, size = np.array((camera.cx, camera.cy)), np.array((camera.width, camera.height))
    offsets = camera.slopes(pixels) * (camera.fx, camera.fy)
    shown = (np.abs(offsets) < 0.5 * WIDEST * size).all(axis=1)
    if not shown.any():
        raise FinishError(f"a distortion of {camera.distortion} leaves nothing of the picture")
    places = offsets + centre
    # One pixel more on each side, for the interpolation.
    first = np.floor(places[shown].min(axis=0)) - 1
    width, height = (np.ceil(places[shown].max(axis=0)) + 2 - first).astype(int).tolist()
    cx, cy = (centre - first).tolist()
    places = np.where(shown[:, None], places - first, NOWHERE)
    places = places.astype(np.float32).T.reshape(2, camera.height, camera.width)
    return PinholeCamera(width, height, camera.fx, camera.fy, cx, cy), places
