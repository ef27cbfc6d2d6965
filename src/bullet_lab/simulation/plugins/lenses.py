"""What happens to pictures in cameras: lenses, blur and noise.

A lens distorts one picture or, for wide angles, joins several pictures.
"""

from __future__ import annotations

import math
from functools import cached_property, reduce
from typing import Callable

import cv2
import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins import PluginError, SensorTag
from bullet_lab.simulation.rendering import RendererError

# The ideal picture is at most this many times larger than the distorted one.
WIDEST = 3.0
# A coordinate outside every picture.
NOWHERE = -10.0
# Functions with their inverses.
FUNCTIONS = {"tan": (np.tan, np.arctan), "sin": (np.sin, np.arcsin), "id": (np.array, np.array)}
# c1, c2 and the function of SDF's lenses: a ray at an angle a from the axis is at the distance
# c1 * f * function(a / c2 + c3) from the middle, in half widths of the picture.
LENSES = {
    "stereographic": (2.0, 2.0, "tan"),
    "gnomonical": (1.0, 1.0, "tan"),
    "equidistant": (1.0, 1.0, "id"),
    "equisolid_angle": (2.0, 2.0, "sin"),
    "orthographic": (1.0, 1.0, "sin"),
}
# The faces of a cube, by pitch and yaw in quarters of a turn.
FACES = [
    Pose.from_rpy((0.0, 0.0, 0.0), (0.0, pitch * 0.5 * math.pi, yaw * 0.5 * math.pi))
    for pitch, yaw in ((0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (-1, 0))
]
# Pixels of a face beyond its edge, for the interpolation.
MARGIN = 3
# How many numbers the table of noise has beyond those of one picture: the number of its offsets.
SPARE_NOISE = 1 << 20
# The value of white.
WHITE = 255.0


class Lens:
    """A distorting lens: the ideal camera to draw with, and the distortion of its pictures.

    Pixels outside the lens, or that would need too large an ideal picture, are black.

    Attributes:
        camera: the camera with distortion.
        ideal: the camera without distortion that draws.
        black: the share of black pixels.

    Raises:
        RendererError: all pixels are black.
    """

    black = 0.0

    def __init__(self, camera: PinholeCamera):
        self.camera = self.ideal = camera
        # The pose of each ideal picture in the camera, and where each pixel is in it, (2, h, w).
        self._faces: list[tuple[Pose, np.ndarray]] = []
        if not any(camera.distortion):
            return
        pixels = np.indices((camera.height, camera.width))[::-1].reshape(2, -1).T.astype(float)
        centre, size = np.array((camera.cx, camera.cy)), np.array((camera.width, camera.height))
        offsets = camera.slopes(pixels) * (camera.fx, camera.fy)
        shown = (np.abs(offsets) < 0.5 * WIDEST * size).all(axis=1)
        if not shown.any():
            what = f"a distortion of {camera.distortion}"
            raise RendererError(f"{what} leaves nothing of the picture")
        places = offsets + centre
        # One pixel more on each side, for the interpolation.
        first = np.floor(places[shown].min(axis=0)) - 1
        width, height = (np.ceil(places[shown].max(axis=0)) + 2 - first).astype(int).tolist()
        self.ideal = PinholeCamera(width, height, camera.fx, camera.fy, *(centre - first).tolist())
        places = np.where(shown[:, None], places - first, NOWHERE).astype(np.float32)
        self._faces = [(Pose(), places.T.reshape(2, camera.height, camera.width))]
        self.black = 1.0 - float(np.mean(shown))

    def picture(self, draw: Callable[[Pose], np.ndarray]) -> np.ndarray:
        """Return the picture of `camera`; `draw` draws with `ideal` at a pose in the camera."""
        if not self._faces:
            return draw(Pose())
        faces = (cv2.remap(draw(turn), *places, cv2.INTER_LINEAR) for turn, places in self._faces)
        # Each pixel is of one face, and black in the others.
        return reduce(np.add, faces)

    def pick(self, values: np.ndarray) -> np.ndarray:
        """Return the values of `camera`'s pixels from the nearest pixels of `ideal`.

        Interpolation would mix the depths of two objects.
        """
        for _, places in self._faces:
            values = cv2.remap(values, *places, cv2.INTER_NEAREST, borderValue=math.nan)
        return values

    @cached_property
    def slopes(self) -> np.ndarray:
        """The slopes x/z and y/z of each pixel's ray in the optical frame, (2, height, width)."""
        camera = self.ideal
        places = np.indices((camera.height, camera.width))[::-1]
        if self._faces:
            ((_, places),) = self._faces
        slopes = (places[0] - camera.cx) / camera.fx, (places[1] - camera.cy) / camera.fy
        return np.array(slopes, dtype=np.float32)


class WideLens(Lens):
    """The lens of a `<sensor type="wideanglecamera">`: joins the faces of a cube around the camera.

    Pixels beyond its cutoff angle are black, without a warning. `camera` is the geometry near the
    middle, `ideal` draws a face. Raises PluginError if it does not reach the field of view.
    """

    def __init__(self, tag: SensorTag, width: int, height: int, fov: float):
        radius_of, angle_of = _function(tag, 0.5 * width, fov)
        focal = float(radius_of(1e-6) - radius_of(0.0)) / 1e-6
        middle = 0.5 * (width - 1), 0.5 * (height - 1)
        self.camera = PinholeCamera(width, height, focal, focal, *middle)
        down, right = np.indices((height, width)) - np.reshape(middle[::-1], (2, 1, 1))
        radius = np.hypot(right, down)
        cutoff = min(tag.positive("camera/lens/cutoff_angle", 0.5 * math.pi), math.pi)
        with np.errstate(invalid="ignore"):
            angle = angle_of(radius)
            shown = (angle >= 0.0) & (angle <= cutoff)
        across = np.sin(angle) / np.maximum(radius, 1e-9)
        rays = np.stack((np.cos(angle), -across * right, -across * down), axis=-1)
        # A face has as many pixels in a radian as the picture where it has most, within limits.
        reach = np.linspace(0.0, np.max(angle[shown], initial=0.0), 100)
        if not reach[1] > 0.0:
            raise PluginError(f"{tag.where('camera/lens')}: shows nothing")
        focal = math.ceil(min(np.diff(radius_of(reach)).max() / reach[1], width))
        side = 2 * (focal + MARGIN)
        centre = 0.5 * (side - 1)
        self.ideal = PinholeCamera(side, side, focal, focal, centre, centre)
        axes = [face.rotation_matrix() for face in FACES]
        nearest = np.argmax([rays @ own[:, 0] for own in axes], axis=0)
        self._faces = []
        for number, face in enumerate(FACES):
            own = shown & (nearest == number)
            if own.any():
                ahead, *sideways = (rays[own] @ axes[number]).T
                places = np.full((2, height, width), NOWHERE, np.float32)
                places[:, own] = centre - focal * np.array(sideways) / ahead
                self._faces.append((face, places))


def _function(tag: SensorTag, half: float, fov: float) -> tuple[Callable, Callable]:
    """Return the distance in pixels for an angle in rad, and its inverse."""
    kind = tag.choice("camera/lens/type", (*LENSES, "custom"))
    first, second, name = LENSES.get(kind, (0.0, 0.0, ""))
    shift, factor = 0.0, 1.0
    if kind == "custom":
        custom = "camera/lens/custom_function"
        first, second, factor = (tag.positive(f"{custom}/{key}", 1.0) for key in ("c1", "c2", "f"))
        shift = tag.number(f"{custom}/c3")
        name = tag.choice(f"{custom}/fun", tuple(FUNCTIONS))
    function, inverse = FUNCTIONS[name]
    if tag.boolean("camera/lens/scale_to_hfov", True):
        end = 0.5 * fov / second + shift
        if not 0.0 < end < (math.inf if name == "id" else 0.5 * math.pi + 1e-9):
            where = tag.where("camera/horizontal_fov")
            raise PluginError(f"{where}: a {kind} lens does not reach {fov:g} rad")
        factor = 1.0 / (first * float(function(end)))
    scale = half * first * factor
    return (
        lambda angle: scale * function(angle / second + shift),
        lambda radius: second * (inverse(radius / scale) - shift),
    )


class SensorNoise:
    """Normal noise, drawn once and read from a random offset for each picture.

    Drawing new numbers for each frame would take as long as rendering it. The numbers in a picture
    are independent. Two pictures share numbers, at different pixels unless their offsets are the
    same (one in a million). Mean and deviation, its `key`, are shares of white.
    """

    def __init__(self, mean: float, stddev: float, count: int, random: np.random.Generator):
        self.key = (mean, stddev)
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
