"""Pictures of a simulation through a pinhole camera, with exactly the geometry asked for."""

from __future__ import annotations

import math
import weakref
from collections import deque
from dataclasses import dataclass
from typing import Any, Callable, Deque, Dict, List, Mapping, Tuple

import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.physics.attached_frame import AttachedFrame
from bullet_lab.simulation.rendering import graphics, shaders
from bullet_lab.simulation.rendering.drawables import Drawable, Drawables
from bullet_lab.simulation.rendering.graphics import (
    DEPTHS,
    SAMPLES,
    Graphics,
    RendererError,
    Target,
    panda3d,
    set_pose,
)
from bullet_lab.simulation.rendering.lights import BITS, PICTURE, Lighting
from bullet_lab.simulation.rendering.shaders import MOVING, PLAIN, SLANTED, STILL, TEXTURED
from bullet_lab.simulation.world.description import Mesh, World
from bullet_lab.simulation.world.meshes import file_version

# With more, it takes too long to see whether any is in view.
MOST_HULLS = 64
# From x ahead, z up to Panda3D's axes of a camera: y ahead, z up.
AHEAD = Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, -0.5 * math.pi))
# A texture is drawn by the better and slower way where the cosine of its surface's normal with the
# direction of view is less: where a pixel's footprint is 1.3 times as long as wide. (Below that,
# sharper textures only let the smallest markers flicker.)
SLANT = 0.77
KEPT_DRAWABLES = 4


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
            raise RendererError("a pinhole camera has no distortion; bend the picture with a Lens")


class _LinkNode:
    """What is to be seen of one link, below a node of its own."""

    def __init__(self, root: Any, frame: AttachedFrame, drawable: Drawable):
        self._frame, self._drawable, self._pose = frame, drawable, Pose()
        self.path = root.attach_new_node("link")
        # Corners of the boxes around what throws shadows, (n, 8, 3) in m in the world.
        self.boxes = drawable.boxes
        self._textured = []
        for node, patch in drawable.nodes:
            # The node itself may hang below other links, too, that are seen from elsewhere.
            path = self.path.attach_new_node("look")
            path.attach_new_node(node)
            if patch is not None:
                self._textured.append((path, *patch))

    def follow(self) -> bool:
        """Go where the link is; return whether it has moved."""
        pose = self._frame.pose()
        if pose == self._pose:
            return False
        self._pose = pose
        set_pose(self.path, pose)
        self.boxes = self._drawable.boxes @ pose.rotation_matrix().T + np.asarray(pose.position)
        return True

    def face(self, eye: Vector, programs: Mapping[str, Any]) -> None:
        """Choose how textures are drawn for a place in the world, m, that they are seen from."""
        for path, centre, normal in self._textured:
            way = centre - (self._pose.inverse() * Pose(eye)).position
            slanted = abs(way @ normal) < SLANT * np.linalg.norm(way)
            path.set_shader(programs[SLANTED if slanted else TEXTURED])


class Scene:
    """What is to be seen in a world, all below its `root`, a node path of Panda3D's."""

    def __init__(self, world: World, models: Mapping[str, Any], graphics: Graphics):
        self.root = panda3d().NodePath("scene")
        self._models = models
        self._graphics = graphics
        self._lighting = Lighting(world, graphics, self.root)
        # Links that look the same share one drawable for as long as any of them is there. The last
        # ones are kept, for models that go and come back: glibc, before 2.38, hardly uses again
        # what the driver gives back of a texture.
        self._maker = Drawables(world.ambient)
        self._drawables: Any = weakref.WeakValueDictionary()
        self._last: Deque[Drawable] = deque(maxlen=KEPT_DRAWABLES)
        # Each model with its links, by its name.
        self._shown: Dict[str, Tuple[Any, List[_LinkNode]]] = {}
        # How often what stands still, and what moves, has changed.
        self._versions = {STILL: 0, MOVING: 0}
        self._moves: Dict[str, int] = {}

    def update(self) -> None:
        """Bring everything to where the models are."""
        for name in [n for n, (i, _) in self._shown.items() if self._models.get(n) is not i]:
            self._remove(name)
        for name, instance in self._models.items():
            if name not in self._shown:
                self._shown[name] = (instance, self._nodes_of(instance))
            kind = _kind(instance)
            if kind == STILL and self._moves.get(name) == instance.moves:
                continue
            is_new, self._moves[name] = name not in self._moves, instance.moves
            moved = [link.follow() for link in self._shown[name][1]]
            self._versions[kind] += is_new or any(moved)

    def prepare(self, eye: Vector, in_view: Callable[[np.ndarray], bool]) -> List[Target]:
        """Choose how all is drawn for an eye, m; return shadow maps that must be drawn first.

        `in_view` says whether any of several hulls may be seen, see `Lighting.shadows_of`.
        """
        moving = self._boxes(MOVING)
        seen = len(moving) > 0 and any(map(in_view, self._lighting.shadows_of(moving)))
        programs = self._lighting.programs[seen]
        self.root.set_shader(programs[PLAIN])
        for _, links in self._shown.values():
            for link in links:
                link.face(eye, programs)
        kinds = (STILL, MOVING) if seen else (STILL,)
        return self._lighting.update({kind: self._versions[kind] for kind in kinds}, self._boxes)

    def relight(self, world: World) -> None:
        """Take the lights of a world from now on."""
        self._lighting.remove()
        self._lighting = Lighting(world, self._graphics, self.root)

    def close(self) -> None:
        """Give everything back."""
        for name in list(self._shown):
            self._remove(name)
        self._lighting.remove()
        # A target that drew this scene last still knows its root.
        self.root.set_state(panda3d().RenderState.make_empty())

    def _remove(self, name: str) -> None:
        instance, links = self._shown.pop(name)
        self._moves.pop(name, None)
        self._versions[_kind(instance)] += 1
        for link in links:
            link.path.remove_node()

    def _boxes(self, kind: str) -> np.ndarray:
        """Return the corners of the boxes around what throws shadows, (n, 8, 3)."""
        links = (link for i, links in self._shown.values() if _kind(i) == kind for link in links)
        return np.concatenate([np.zeros((0, 8, 3)), *(link.boxes for link in links)])

    def _nodes_of(self, instance: Any) -> List[_LinkNode]:
        nodes, kind = [], _kind(instance)
        for body in instance.bodies.values():
            for link in filter(lambda link: link.visuals, body.links):
                files = [v.geometry for v in link.visuals if isinstance(v.geometry, Mesh)]
                files += [v.material.texture for v in link.visuals if v.material.texture]
                key = (link.visuals, kind, tuple(map(file_version, files)))
                drawable = self._drawables.get(key)
                if drawable is None:
                    where = f"model '{instance.name}': link '{link.name}'"
                    drawable = self._drawables[key] = self._maker.of(link.visuals, kind, where)
                    self._last.append(drawable)
                nodes.append(_LinkNode(self.root, AttachedFrame(body, link.name), drawable))
        return nodes


def _kind(instance: Any) -> str:
    return STILL if instance.model.static else MOVING


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
        set_pose(target.cameras[0], pose * AHEAD)
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
