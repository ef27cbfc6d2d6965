"""Pictures of a scene through a pinhole camera, with exactly the geometry asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterator, Optional, Tuple

import cv2
import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.numerics.pinhole import PinholeCamera
from bullet_lab.simulation.pose import Pose, Vector
from bullet_lab.simulation.rendering.choice import EGL
from bullet_lab.simulation.rendering.engine import EGL_BUFFER
from bullet_lab.simulation.rendering.scene import Scene

# Where the renderers put what should be at pixel (0, 0), in OpenCV's convention.
PIXEL_SHIFT = {"egl": (0.0, 0.0), "tiny": (0.5, -0.5)}
# TinyRenderer drops triangles with a corner exactly in the plane of the eye, which places in
# round numbers would bring about: it looks from a few micrometres further back.
BACK = {"egl": Pose(), "tiny": Pose((-3e-6, 0.0, 0.0))}
MOST_SAMPLES = 8.0


class FrameError(LabError):
    """A picture that cannot be taken."""


@dataclass(frozen=True)
class Shot:
    """How to take a picture.

    Attributes:
        camera: geometry of the picture; without distortion.
        near: closest distance drawn, in metres.
        far: farthest distance drawn, in metres.
        samples: drawn pixels per pixel of the picture, along each side; 1 or more. The picture
            is their mean, so that edges and far textures do not alias.
    """

    camera: PinholeCamera
    near: float = 0.1
    far: float = 100.0
    samples: float = 1.0

    def __post_init__(self) -> None:
        """Raise FrameError where no such picture exists."""
        if not 0.0 < self.near < self.far < math.inf:
            raise FrameError(f"no view reaches from {self.near:g} m to {self.far:g} m")
        if not 1.0 <= self.samples <= MOST_SAMPLES:
            raise FrameError(f"{self.samples:g} samples per pixel are not within 1 … 8")
        if any(self.camera.distortion):
            raise FrameError("a pinhole distorts nothing")


class Photographer:
    """Takes pictures of a scene.

    Args:
        scene: what to take pictures of.
        background: RGB within [0, 1] of what nothing stands in front of.
    """

    def __init__(self, scene: Scene, background: Vector):
        self._scene = scene
        self._background = np.asarray(background, dtype=float)
        self._last_sky: Optional[np.ndarray] = None

    def take(self, pose: Pose, shot: Shot, exposure: float = 1.0) -> np.ndarray:
        """Return what is seen along the x axis of a pose, its z axis upwards.

        Args:
            pose: of the camera in the world.
            shot: how.
            exposure: factor to the brightness; what exceeds white is white.

        Returns:
            (height, width, 3) uint8, RGB. The same scene and arguments give the same bytes.

        Raises:
            LabError: a model cannot be drawn.
        """
        camera = shot.camera
        self._scene.update(pose.position, 1.0 / (shot.samples * max(camera.fx, camera.fy)))
        view = view_matrix(pose * BACK[self._scene.engine.renderer])
        # Whole pixels; the focal lengths follow, so that the picture keeps its geometry.
        width, height = round(shot.samples * camera.width), round(shot.samples * camera.height)
        drawn = _resized(camera, width, height)
        tiles = list(_tiles(drawn, self._scene.engine.renderer))
        if len(tiles) == 1:
            picture = self._draw(drawn, shot, view, exposure)
        else:
            picture = np.empty((height, width, 3), np.uint8)
            for left, top, part in tiles:
                where = np.s_[top : top + part.height, left : left + part.width]
                picture[where] = self._draw(part, shot, view, exposure)
        if (width, height) == (camera.width, camera.height):
            return picture
        return cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)

    def measure(self, pose: Pose, shot: Shot) -> np.ndarray:
        """Return the distance along the view of what is seen through each pixel.

        Args:
            pose: of the camera in the world: x ahead, z up.
            shot: how to look; always with one sample per pixel.

        Returns:
            (height, width) float32 in metres, +inf where nothing is within the view.

        Raises:
            LabError: a model cannot be drawn.
        """
        camera, renderer = shot.camera, self._scene.engine.renderer
        self._scene.update(pose.position, 1.0 / max(camera.fx, camera.fy))
        view = view_matrix(pose * BACK[renderer])
        depths = np.empty((camera.height, camera.width), np.float32)
        for left, top, part in _tiles(camera, renderer):
            where = np.s_[top : top + part.height, left : left + part.width]
            _, depth = self._render(part, shot, view)
            depths[where] = _metres(depth, shot, _EMPTY[renderer])
        return depths

    def close(self) -> None:
        """Give up the scene."""
        self._scene.close()

    @property
    def renderer(self) -> str:
        """What draws: "egl" or "tiny"."""
        return self._scene.engine.renderer

    def _draw(
        self, camera: PinholeCamera, shot: Shot, view: Tuple[float, ...], exposure: float
    ) -> np.ndarray:
        pixels, depth = self._render(camera, shot, view)
        picture = cv2.cvtColor(pixels, cv2.COLOR_RGBA2RGB)
        gain = exposure * self._scene.lighting.peak
        if gain != 1.0:
            picture = cv2.convertScaleAbs(picture, alpha=gain)
        empty = cv2.compare(depth, _EMPTY[self._scene.engine.renderer], cv2.CMP_GE)
        if cv2.countNonZero(empty):
            cv2.copyTo(self._sky(picture.shape, exposure), empty, picture)
        return picture

    def _render(
        self, camera: PinholeCamera, shot: Shot, view: Tuple[float, ...]
    ) -> Tuple[np.ndarray, np.ndarray]:
        """Return RGBA and depth as the engine draws them."""
        engine = self._scene.engine
        lens = projection_matrix(camera, shot.near, shot.far, PIXEL_SHIFT[engine.renderer])
        textures = self._scene.texture_map
        columns = None if textures is None else textures.columns
        return engine.draw(camera.width, camera.height, view, lens, columns)

    def _sky(self, shape: Tuple[int, ...], exposure: float) -> np.ndarray:
        """Return a picture of nothing."""
        colour = np.clip(np.round(255.0 * exposure * self._background), 0, 255).astype(np.uint8)
        sky = self._last_sky
        # Filling one takes as long as all else that is done to a picture.
        if sky is None or sky.shape != shape or (sky[0, 0] != colour).any():
            sky = self._last_sky = np.full(shape, colour)
        return sky


# Depth of what nothing was drawn to: TinyRenderer's is a rounding below EGL's.
_EMPTY = {"egl": 1.0, "tiny": 0.99999}


def view_matrix(pose: Pose) -> Tuple[float, ...]:
    """Return OpenGL's view matrix, by columns, of an eye that looks along x, z up."""
    x, y, z = pose.rotation_matrix().T
    matrix = np.eye(4)
    matrix[:3, :3] = (-y, z, -x)
    matrix[:3, 3] = -matrix[:3, :3] @ np.asarray(pose.position)
    return tuple(matrix.T.ravel())


def projection_matrix(
    camera: PinholeCamera, near: float, far: float, shift: Tuple[float, float] = (0.0, 0.0)
) -> Tuple[float, ...]:
    """Return OpenGL's projection matrix, by columns, of a camera without distortion.

    OpenGL's pixels begin at their edges, OpenCV's at their centres.
    """
    matrix = np.zeros((4, 4))
    matrix[0, 0] = 2.0 * camera.fx / camera.width
    matrix[1, 1] = 2.0 * camera.fy / camera.height
    matrix[0, 2] = 1.0 - 2.0 * (camera.cx + 0.5 - shift[0]) / camera.width
    matrix[1, 2] = 2.0 * (camera.cy + 0.5 - shift[1]) / camera.height - 1.0
    matrix[2, 2] = -(far + near) / (far - near)
    matrix[2, 3] = -2.0 * far * near / (far - near)
    matrix[3, 2] = -1.0
    return tuple(matrix.T.ravel())


def _metres(depth: np.ndarray, shot: Shot, empty: float) -> np.ndarray:
    """Return distances in m for OpenGL's depths; +inf where nothing was drawn."""
    near, far = shot.near, shot.far
    metres = far * near / (far - (far - near) * depth.astype(np.float64))
    return np.where(depth >= empty, np.inf, metres)


def _resized(camera: PinholeCamera, width: int, height: int) -> PinholeCamera:
    """Return the camera of the same picture with other pixels."""
    kx, ky = width / camera.width, height / camera.height
    cx, cy = kx * (camera.cx + 0.5) - 0.5, ky * (camera.cy + 0.5) - 0.5
    return PinholeCamera(width, height, kx * camera.fx, ky * camera.fy, cx, cy)


def _tiles(camera: PinholeCamera, renderer: str) -> Iterator[Tuple[int, int, PinholeCamera]]:
    """Yield left, top and camera of parts that the renderer can draw at once."""
    largest = EGL_BUFFER if renderer == EGL else (camera.width, camera.height)
    columns, rows = -(-camera.width // largest[0]), -(-camera.height // largest[1])
    wide, tall = -(-camera.width // columns), -(-camera.height // rows)
    for top in range(0, camera.height, tall):
        for left in range(0, camera.width, wide):
            width, height = min(wide, camera.width - left), min(tall, camera.height - top)
            yield (
                left,
                top,
                PinholeCamera(
                    width, height, camera.fx, camera.fy, camera.cx - left, camera.cy - top
                ),
            )
