"""Pictures of a simulation through a pinhole camera, with exactly the geometry asked for."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, Dict, Mapping, Union

import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.simulation.rendering.graphics import SAMPLES, RendererError, Target, shared_graphics
from bullet_lab.simulation.rendering.lights import BITS, PICTURE
from bullet_lab.simulation.rendering.scene import PAINT_TAG, Scene
from bullet_lab.simulation.rendering.shaders import DEPTH_FRAGMENT, DEPTH_VERTEX
from bullet_lab.simulation.world.description import World

DEPTH = "depth"
# Lenses of shots taken last, that are kept.
KEPT_LENSES = 8
# With more, it takes too long to see whether any is in view.
MOST_HULLS = 64
# Of a camera's own state over that of what it sees.
OVERRIDE = 100
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
        self._lens = functools.lru_cache(maxsize=KEPT_LENSES)(self._make_lens)
        self._states: Dict[Union[int, str], Any] = {}
        for kind in (*SAMPLES, DEPTH):
            state = core.NodePath("state")
            state.set_attrib(turned)
            # Neither is left to what was drawn last.
            several = kind in SAMPLES and kind > 1
            modes = core.AntialiasAttrib
            state.set_antialias(modes.M_multisample if several else modes.M_none)
            if kind == DEPTH:
                program = self._graphics.program(DEPTH_VERTEX, DEPTH_FRAGMENT)
                state.set_shader(program)
                # What is behind glass is not measured.
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

    def _make_lens(self, shot: Shot) -> Any:
        lens = self._graphics.core.MatrixLens()
        lens.set_user_mat(self._graphics.matrix(projection(shot)))
        return lens

    def _draw(self, target: Target, kind: Union[int, str], pose: Pose, shot: Shot) -> None:
        self._scene.update()
        (path,) = target.cameras
        core = self._graphics.core
        x, y, z, w = (pose * AHEAD).quaternion
        path.set_pos_quat(core.LPoint3(*pose.position), core.LQuaternion(w, x, y, z))
        node = path.node()
        node.set_lens(self._lens(shot))
        node.set_scene(self._scene.root)
        node.set_initial_state(self._states[kind])
        node.set_camera_mask(core.BitMask32.bit(BITS[PICTURE]))
        if kind == DEPTH:
            self._graphics.draw([target])
            return
        view = self._scene.view(pose.position, lambda hulls: in_view(hulls, pose, shot))
        if target.states is not view.states:
            target.states = view.states
            node.set_tag_state_key(PAINT_TAG)
            for paint, state in view.states.items():
                node.set_tag_state(paint, state)
        self._graphics.draw([*view.shadow_maps, target])


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


def in_view(hulls: np.ndarray, pose: Pose, shot: Shot) -> bool:
    """Return whether any of several convex hulls may be seen; True if in doubt.

    What of a hull is before the nearest distance may not be seen where all of it lies beyond one
    side of the view.

    Args:
        hulls: (n, m, 3) points of each, m in the world.
        pose: of the camera: x ahead, z up.
        shot: its view.
    """
    if len(hulls) > MOST_HULLS:
        return True
    points = (hulls - np.asarray(pose.position)) @ pose.rotation_matrix()
    ahead = points[..., 0] - shot.near
    # Where what joins two points comes through the plane of the nearest distance.
    crosses = (ahead[:, :, None] < 0.0) & (ahead[:, None, :] >= 0.0)
    shares = ahead[:, :, None] / np.where(crosses, ahead[:, :, None] - ahead[:, None, :], 1.0)
    between = points[:, :, None] + shares[..., None] * (points[:, None] - points[:, :, None])
    count = len(hulls)
    seen = np.concatenate((ahead >= 0.0, crosses.reshape(count, -1)), axis=1)
    inside = np.concatenate((points, between.reshape(count, -1, 3)), axis=1) @ _sides(shot.camera)
    return bool(((inside >= 0.0) & seen[..., None]).any(axis=1).all(axis=1).any())


@functools.lru_cache(maxsize=KEPT_LENSES)
def _sides(camera: PinholeCamera) -> np.ndarray:
    """Return normals, by columns, of the four sides of a view: x ahead, y left, z up; (3, 4)."""
    columns = (
        (camera.cx + 1.0, -camera.fx, 0.0),
        (camera.width - camera.cx, camera.fx, 0.0),
        (camera.cy + 1.0, 0.0, -camera.fy),
        (camera.height - camera.cy, 0.0, camera.fy),
    )
    return np.array(columns).T
