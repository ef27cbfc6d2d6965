"""Pictures of a simulation through a pinhole camera, with exactly the geometry asked for."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import Any, Dict, Mapping, Union

import numpy as np

from bullet_lab.numerics.pinhole import PinholeCamera
from bullet_lab.simulation.description import World
from bullet_lab.simulation.pose import Pose
from bullet_lab.simulation.rendering.graphics import (
    SAMPLES,
    RendererError,
    Target,
    shared_graphics,
)
from bullet_lab.simulation.rendering.lights import BITS, OVERRIDE, PICTURE
from bullet_lab.simulation.rendering.scene import Scene
from bullet_lab.simulation.rendering.shaders import DEPTH_FRAGMENT, DEPTH_VERTEX

LOG = logging.getLogger(__name__)

DEPTH = "depth"
# From x ahead, z up to Panda3D's axes of a camera: y ahead, z up.
AHEAD = Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, -0.5 * math.pi))


@dataclass(frozen=True)
class Shot:
    """How to take a picture.

    Attributes:
        camera: geometry of the picture; without distortion.
        near: closest distance drawn, in metres.
        far: farthest distance drawn, in metres.
        samples: of each pixel, 1, 2 or 4: their mean is its colour, so that edges do not alias.
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
    """Draws a simulation.

    Args:
        world: for its lights and background.
        models: all model instances by name, as they are at each picture.

    Raises:
        RendererError: nothing can be drawn here.
    """

    def __init__(self, world: World, models: Mapping[str, Any]):
        self._graphics = shared_graphics()
        self._scene = Scene(world, models, self._graphics)
        self._background = np.asarray(world.background[:3])
        core = self._graphics.core
        # Pictures are drawn upside down, which spares turning them round: so what is clockwise
        # turns, too.
        turned = core.CullFaceAttrib.make(core.CullFaceAttrib.M_cull_counter_clockwise)
        self._states: Dict[Union[int, str], Any] = {}
        for kind in (*SAMPLES, DEPTH):
            state = core.NodePath("state")
            state.set_attrib(turned)
            # Neither is left to what was drawn last.
            several = kind in SAMPLES and kind > 1
            modes = core.AntialiasAttrib
            state.set_antialias(modes.M_multisample if several else modes.M_none, OVERRIDE)
            if kind == DEPTH:
                program = self._graphics.program(DEPTH_VERTEX, DEPTH_FRAGMENT)
                state.set_shader(program, OVERRIDE)
                state.set_transparency(core.TransparencyAttrib.M_none, OVERRIDE)
            self._states[kind] = state.get_state()

    @property
    def driver(self) -> str:
        """What draws, such as "llvmpipe (LLVM 15.0.6, 256 bits)"."""
        return self._graphics.driver

    def picture(self, pose: Pose, shot: Shot, exposure: float = 1.0) -> np.ndarray:
        """Return what is seen along the x axis of a pose, its z axis upwards.

        Args:
            pose: of the camera in the world.
            shot: how.
            exposure: factor to the brightness; what exceeds white is white.

        Returns:
            (height, width, 3) uint8, RGB. The same world, pose and shot give the same bytes.

        Raises:
            RendererError: this cannot be drawn.
        """
        camera = shot.camera
        target = self._graphics.picture_target(camera.width, camera.height, shot.samples)
        self._scene.root.set_shader_input("exposure", float(exposure))
        # Blue first: what Panda3D hands out as blue is red then.
        target.clear_with(np.clip(exposure * self._background, 0.0, 1.0)[::-1])
        self._draw(target, shot.samples, pose, shot)
        return target.pixels(np.uint8, 3)

    def depths(self, pose: Pose, shot: Shot) -> np.ndarray:
        """Return the distance along the view of what is seen through each pixel's centre.

        Args:
            pose: of the camera in the world: x ahead, z up.
            shot: how to look; samples do not count.

        Returns:
            (height, width) float32 in m, +inf where nothing is within the view.

        Raises:
            RendererError: this cannot be drawn.
        """
        target = self._graphics.depth_target(shot.camera.width, shot.camera.height)
        target.clear_with((0.0, 0.0, 0.0))
        self._draw(target, DEPTH, pose, shot)
        depths = target.pixels(np.float32, 1)[..., 0]
        depths[depths == 0.0] = np.inf
        return depths

    def close(self) -> None:
        """Give everything back."""
        self._scene.close()

    def _draw(self, target: Target, kind: Union[int, str], pose: Pose, shot: Shot) -> None:
        shadow_maps = self._scene.update(pose.position)
        (path,) = target.cameras
        core = self._graphics.core
        x, y, z, w = (pose * AHEAD).quaternion
        path.set_pos_quat(core.LPoint3(*pose.position), core.LQuaternion(w, x, y, z))
        lens = core.MatrixLens()
        lens.set_user_mat(self._graphics.matrix(projection(shot)))
        node = path.node()
        node.set_lens(lens)
        node.set_scene(self._scene.root)
        node.set_initial_state(self._states[kind])
        node.set_camera_mask(core.BitMask32.bit(BITS[PICTURE]))
        self._graphics.draw([*shadow_maps, target])


def projection(shot: Shot) -> np.ndarray:
    """Return the matrix from x right, y ahead, z up to clip coordinates, upside down: (4, 4).

    OpenGL's pixels begin at their edges, OpenCV's at their centres.
    """
    camera, near, far = shot.camera, shot.near, shot.far
    return np.array(
        [
            [2.0 * camera.fx / camera.width, 2.0 * (camera.cx + 0.5) / camera.width - 1.0, 0, 0],
            [0, 2.0 * (camera.cy + 0.5) / camera.height - 1.0, -2.0 * camera.fy / camera.height, 0],
            [0, (far + near) / (far - near), 0, -2.0 * far * near / (far - near)],
            [0, 1.0, 0, 0],
        ]
    )
