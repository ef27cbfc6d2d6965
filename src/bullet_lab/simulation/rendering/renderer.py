"""Pictures of a simulation through a pinhole camera, with exactly the geometry asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Mapping

import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.simulation.rendering import graphics, shaders
from bullet_lab.simulation.rendering.graphics import DEPTHS, SAMPLES, RendererError, Target
from bullet_lab.simulation.rendering.lights import BITS, PICTURE
from bullet_lab.simulation.rendering.scene import Scene
from bullet_lab.simulation.world.description import World

# With more, it takes too long to see whether any is in view.
MOST_HULLS = 64
# From x ahead, z up to Panda3D's axes of a camera: y ahead, z up.
AHEAD = Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, -0.5 * math.pi))


@dataclass(frozen=True)
class Shot:
    """How to take a picture: with a camera without distortion, from `near` to `far`, in metres.

    The mean of the samples of each pixel, 1, 2 or 4, is its colour, so that edges do not alias.
    """

    camera: PinholeCamera
    near: float = 0.1
    far: float = 100.0
    samples: int = 1

    def __post_init__(self) -> None:
        """Raise RendererError where no such picture exists."""
        if not 0.0 < self.near < self.far < math.inf:
            raise RendererError(f"no view reaches from {self.near:g} m to {self.far:g} m")
        if self.samples not in SAMPLES:
            known = ", ".join(map(str, SAMPLES))
            raise RendererError(f"{self.samples:g} samples for each pixel are not one of {known}")
        if any(self.camera.distortion):
            raise RendererError("a pinhole distorts nothing")


class Renderer:
    """Draws the models, by name, that a world has at each picture, with its lights and background.

    `driver` says what draws. All of it raises RendererError for what cannot be drawn.
    """

    def __init__(self, world: World, models: Mapping[str, Any]):
        self._graphics = shared = graphics.shared_graphics()
        self.driver = shared.driver
        self._scene = Scene(world, models, shared)
        self._background = np.asarray(world.background[:3])
        self._states = {samples: shared.state(samples=samples) for samples in SAMPLES}
        program = shared.program(shaders.DEPTH_VERTEX, shaders.DEPTH_FRAGMENT)
        self._states[DEPTHS] = shared.state(program)

    def picture(self, pose: Pose, shot: Shot, exposure: float = 1.0) -> np.ndarray:
        """Return what is seen along the x axis of a pose, its z axis upwards.

        Exposure is a factor to the brightness; what exceeds white is white.

        Returns:
            (height, width, 3) uint8, RGB. The same world, pose and shot give the same bytes.
        """
        self._scene.root.set_shader_input("exposure", float(exposure))
        background = np.clip(exposure * self._background, 0.0, 1.0)
        target = self._aimed(pose, shot, shot.samples, background)
        maps = self._scene.prepare(pose.position, lambda hulls: in_view(hulls, pose, shot))
        self._graphics.draw([*maps, target])
        return target.pixels(np.uint8, 3)

    def depths(self, pose: Pose, shot: Shot) -> np.ndarray:
        """Return the distance along the view of what is seen through each pixel's centre.

        Returns:
            (height, width) float32 in m, +inf where nothing is within the view.
        """
        target = self._aimed(pose, shot, DEPTHS, np.zeros(3))
        self._graphics.draw([target])
        depths = target.pixels(np.float32, 1)[..., 0]
        depths[depths == 0.0] = np.inf
        return depths

    def relight(self, world: World) -> None:
        """Take the lights of a world from now on."""
        self._scene.relight(world)

    def close(self) -> None:
        """Give everything back."""
        self._scene.close()

    def _aimed(self, pose: Pose, shot: Shot, samples: int, background: np.ndarray) -> Target:
        self._scene.update()
        target = self._graphics.target(shot.camera.width, shot.camera.height, samples)
        # Blue first: what Panda3D hands out as blue is red then.
        target.buffer.set_clear_color((*background[::-1], 1.0))
        target.look(self._scene.root, self._states[samples], BITS[PICTURE], [projection(shot)])
        graphics.set_pose(target.cameras[0], pose * AHEAD)
        return target


def projection(shot: Shot) -> np.ndarray:
    """Return the matrix from x right, y ahead, z up to clip coordinates, upside down: (4, 4).

    OpenGL's pixels begin at their edges, OpenCV's at their centres.
    """
    camera, near, far = shot.camera, shot.near, shot.far
    width, height = camera.width, camera.height
    return np.array(
        (
            (2.0 * camera.fx / width, 2.0 * (camera.cx + 0.5) / width - 1.0, 0.0, 0.0),
            (0.0, 2.0 * (camera.cy + 0.5) / height - 1.0, -2.0 * camera.fy / height, 0.0),
            (0.0, (far + near) / (far - near), 0.0, -2.0 * far * near / (far - near)),
            (0.0, 1.0, 0.0, 0.0),
        )
    )


def in_view(hulls: np.ndarray, pose: Pose, shot: Shot) -> bool:
    """Return whether any of several convex hulls may be seen; True if in doubt.

    Hulls are (n, m, 4): homogeneous points of each in the world, 0 last for directions. What of one
    is beyond the nearest distance cannot be seen where all of it lies beyond one side of the view.
    """
    if len(hulls) > MOST_HULLS:
        return True
    local = (hulls[..., :3] - hulls[..., 3:] * pose.position) @ (pose * AHEAD).rotation_matrix()
    clip = np.concatenate((local, hulls[..., 3:]), axis=2) @ projection(shot).T
    # Points beyond the nearest distance, and where what joins others to them comes through it.
    ahead = clip[..., 2] + clip[..., 3]
    beyond, before = np.maximum(ahead, 0.0)[:, None, :, None], np.minimum(ahead, 0.0)
    kept = beyond * clip[:, :, None] - (beyond > 0.0) * before[:, :, None, None] * clip[:, None]
    # A little more than is seen: shadows have soft edges.
    edge = 1.01 * kept[..., 3:]
    inside = np.concatenate((edge + kept[..., :2], edge - kept[..., :2]), axis=3) > 0.0
    return bool(inside.any(axis=(1, 2)).all(axis=1).any())
