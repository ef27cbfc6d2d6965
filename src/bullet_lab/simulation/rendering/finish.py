"""Add the errors of a lens and a sensor to an ideal picture: distortion, blur and noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import cv2
import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.errors import LabError
from bullet_lab.simulation.rendering.graphics import SAMPLES

# How many numbers the table of noise has beyond those of one picture: the number of its offsets.
SPARE_NOISE = 1 << 20
WHITE = 255.0
# The ideal picture is at most this many times larger than the distorted one.
WIDEST = 3.0
# A coordinate outside every picture.
NOWHERE = -10.0


class FinishError(LabError):
    """Settings of a camera or a lens are invalid."""


@dataclass(frozen=True)
class CameraSettings:
    """Settings of a camera that may change between pictures.

    Attributes:
        samples: samples of each pixel, 1, 2 or 4.
        exposure: factor of the brightness.
        blur: standard deviation of the blur in pixels.
        noise_mean: mean of the noise of each pixel and colour, as a share of white.
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
            raise FinishError("a camera setting is not finite")
        if self.samples not in SAMPLES:
            known = ", ".join(map(str, SAMPLES))
            raise FinishError(f"{self.samples:g} samples per pixel; allowed are {known}")
        if min(self.exposure, self.blur, self.noise_stddev) < 0.0:
            raise FinishError("exposure, blur and noise_stddev must not be negative")
        if abs(self.noise_mean) > 1.0 or self.noise_stddev > 1.0:
            raise FinishError("noise is a share of white; at most 1 is allowed")


class SensorNoise:
    """Normal noise, drawn once and read from a random offset for each picture.

    Drawing new numbers for each frame would take as long as rendering it. The numbers in a picture
    are independent. Two pictures share numbers, at different pixels unless their offsets are the
    same (one in a million). Mean and deviation are shares of white.
    """

    def __init__(self, mean: float, stddev: float, count: int, random: np.random.Generator):
        noise = random.standard_normal(count + SPARE_NOISE, dtype=np.float32)
        noise = np.rint(WHITE * (mean + stddev * noise))
        # Two arrays, since adding and subtracting bytes is fast and saturates.
        self._more = np.clip(noise, 0, 255).astype(np.uint8)
        self._less = np.clip(-noise, 0, 255).astype(np.uint8)

    def add_to(self, picture: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """Return the picture with noise; `random` draws the offset."""
        first = int(random.integers(SPARE_NOISE))
        part = slice(first, first + picture.size)
        more, less = (a[part].reshape(picture.shape) for a in (self._more, self._less))
        return cv2.subtract(cv2.add(picture, more), less)


def blurred(picture: np.ndarray, sigma: float) -> np.ndarray:
    """Return the picture with a Gaussian blur of `sigma` pixels, as uint8.

    A float32 picture is clipped to white afterwards.
    """
    if sigma <= 0.0:
        return picture
    picture = cv2.GaussianBlur(picture, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return picture if picture.dtype == np.uint8 else cv2.convertScaleAbs(picture)


class Lens:
    """A distorting lens: it gives the ideal picture to draw, and distorts that.

    Pixels outside the lens, or that would need too large an ideal picture, are black.

    Attributes:
        camera: the camera with distortion.
        ideal: the camera without distortion that draws.
        black: the share of black pixels.

    Raises:
        FinishError: all pixels are black.
    """

    def __init__(self, camera: PinholeCamera):
        self.camera = self.ideal = camera
        self.black = 0.0
        self._map: Optional[np.ndarray] = None
        if any(camera.distortion):
            self.ideal, self._map = _bent(camera)
            self.black = float(np.mean(self._map[0] == NOWHERE))

    def bend(self, picture: np.ndarray) -> np.ndarray:
        """Return the picture of `camera` from that of `ideal`."""
        return picture if self._map is None else cv2.remap(picture, *self._map, cv2.INTER_LINEAR)

    def pick(self, values: np.ndarray) -> np.ndarray:
        """Return the values of `camera`'s pixels from the nearest pixels of `ideal`.

        Interpolation would mix the depths of two objects.
        """
        if self._map is None:
            return values
        return cv2.remap(values, *self._map, cv2.INTER_NEAREST, borderValue=math.nan)

    def slopes(self) -> np.ndarray:
        """Return x/z and y/z of each pixel's ray in the optical frame, (2, height, width)."""
        camera, places = self.ideal, self._map
        if places is None:
            places = np.indices((camera.height, camera.width))[::-1]
        slopes = (places[0] - camera.cx) / camera.fx, (places[1] - camera.cy) / camera.fy
        return np.array(slopes, dtype=np.float32)


def _bent(camera: PinholeCamera) -> Tuple[PinholeCamera, np.ndarray]:
    """Return the ideal camera of a lens, and the place of each pixel in its picture."""
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
