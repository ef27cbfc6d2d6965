"""Take pictures and depths of a simulation through a pinhole camera."""

from __future__ import annotations

import math
import weakref
from collections import deque
from dataclasses import dataclass
from typing import Any, Mapping

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.physics.attached_frame import AttachedFrame
from bullet_lab.simulation.rendering import (
    DEPTHS,
    SAMPLES,
    Canvas,
    RendererError,
    panda3d,
    set_pose,
    shared_graphics,
)
from bullet_lab.simulation.rendering.drawables import Drawable, Drawables
from bullet_lab.simulation.rendering.lights import (
    BITS,
    MOVING,
    PICTURE,
    PLAIN,
    SLANTED,
    STILL,
    TEXTURED,
    Lighting,
)
from bullet_lab.simulation.world.description import Mesh, World
from bullet_lab.simulation.world.meshes import file_version

# From axes with x ahead and z up to those of Panda3D's camera, y ahead and z up.
AHEAD = Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, -0.5 * math.pi))
# Below this cosine between a surface's normal and the view, textures are filtered better and more
# slowly: a pixel's footprint is 1.3 times as long as wide. Above it, sharper textures only make
# the smallest markers flicker.
SLANT = 0.77
# How many drawables of removed models are kept, for models that come back.
KEPT_DRAWABLES = 4


@dataclass(frozen=True)
class Shot:
    """The settings of a picture: a camera without distortion, and `near` and `far` in metres.

    A pixel is the mean of its samples, 1, 2 or 4, which makes edges smooth.
    """

    camera: PinholeCamera
    near: float = 0.1
    far: float = 100.0
    samples: int = 1

    def __post_init__(self) -> None:
        """Raise RendererError for invalid settings."""
        if not 0.0 < self.near < self.far < math.inf:
            limits = f"near {self.near:g} m, far {self.far:g} m"
            raise RendererError(f"{limits}; 0 < near < far is needed")
        if self.samples not in SAMPLES:
            known = ", ".join(map(str, SAMPLES))
            raise RendererError(f"{self.samples:g} samples per pixel; allowed are {known}")
        if any(self.camera.distortion):
            raise RendererError("a pinhole camera has no distortion; bend the picture with a Lens")


def centred_camera(width: int, height: int, horizontal_fov: float) -> PinholeCamera:
    """Return a camera with square pixels, its principal point in the middle; the angle in rad."""
    focal = 0.5 * width / math.tan(0.5 * horizontal_fov)
    return PinholeCamera(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))


class _LinkNode:
    """The node of a link, with its drawable."""

    def __init__(self, root: Any, frame: AttachedFrame, drawable: Drawable):
        self._frame, self._drawable = frame, drawable
        self._pose: Pose | None = None
        self.path = root.attach_new_node("link")
        # Corners of the boxes around shadow casters, (n, 8, 3) in m in the world.
        self.boxes = drawable.boxes
        self._textured = []
        for node, patch in drawable.nodes:
            # Other links may share the node; they are seen from other directions.
            path = self.path.attach_new_node("look")
            path.attach_new_node(node)
            if patch is not None:
                self._textured.append((path, *patch))

    def follow(self) -> bool:
        """Move the node to the link; return whether it has moved."""
        pose = self._frame.pose()
        if pose == self._pose:
            return False
        self._pose = pose
        set_pose(self.path, pose)
        self.boxes = self._drawable.boxes @ pose.rotation_matrix().T + np.asarray(pose.position)
        return True

    def face(self, eye: Vector, programs: Mapping[str, Any]) -> None:
        """Choose the programs of textures for an eye at a point in the world, m."""
        for path, centre, normal in self._textured:
            ray = centre - (self._pose.inverse() * Pose(eye)).position
            slanted = abs(ray @ normal) < SLANT * np.linalg.norm(ray)
            path.set_shader(programs[SLANTED if slanted else TEXTURED])


@dataclass
class _ShownModel:
    """A model, STILL or MOVING, its links with visuals, and how often it had been placed."""

    instance: Any
    kind: str
    links: list[_LinkNode]
    moves: int = -1


class Renderer:
    """Draws the models that a world has at each picture, with its lights and background.

    `driver` is the name of the driver. All methods raise RendererError.
    """

    def __init__(self, world: World, models: Mapping[str, Any]):
        self._graphics = shared = shared_graphics()
        self.driver = shared.driver
        self._models = models
        # Below it, in Panda3D, is all that is visible.
        self._root = panda3d().NodePath("scene")
        self._lighting = Lighting(world, shared, self._root)
        self._background = np.asarray(world.background[:3])
        self._states = {samples: shared.state(samples=samples) for samples in SAMPLES}
        self._states[DEPTHS] = shared.state(shared.depth_program)
        # Equal links share a drawable as long as one of them exists. The last ones are kept for
        # models that come back: glibc before 2.38 hardly reuses the memory of released textures.
        self._maker = Drawables(world.ambient)
        self._drawables: Any = weakref.WeakValueDictionary()
        self._last: deque[Drawable] = deque(maxlen=KEPT_DRAWABLES)
        self._shown: dict[str, _ShownModel] = {}
        # How often the static and the moving models have changed.
        self._versions = {STILL: 0, MOVING: 0}

    def picture(
        self,
        pose: Pose,
        shot: Shot,
        exposure: float = 1.0,
        part: tuple[slice, slice] = (slice(None), slice(None)),
    ) -> ndarray:
        """Return the picture along the x axis of a pose, with its z axis up.

        Exposure is a factor of the brightness; brighter colours than white become white. A part is
        the rows and columns to draw.

        Returns:
            (height, width, 3) uint8, RGB; less for a part. The same world, pose and shot give the
            same bytes.
        """
        self._root.set_shader_input("exposure", float(exposure))
        background = np.clip(exposure * self._background, 0.0, 1.0)
        target = self._aimed(pose, shot, shot.samples, background)
        target.cut(*part)
        self._graphics.draw([*self._shadow_maps(pose, shot), target])
        # Panda3D gives blue first.
        return cv2.cvtColor(target.pixels(np.uint8, 4)[part], cv2.COLOR_BGRA2RGB)

    def depths(self, pose: Pose, shot: Shot) -> ndarray:
        """Return the depth along the view at the centre of each pixel.

        Returns:
            (height, width) float32 in m, +inf where nothing is visible.
        """
        target = self._aimed(pose, shot, DEPTHS, np.zeros(3))
        self._graphics.draw([target])
        depths = target.pixels(np.float32, 1)[..., 0]
        return np.where(depths == 0.0, np.float32(np.inf), depths)

    def relight(self, world: World) -> None:
        """Use the lights of a world from now on."""
        self._lighting.remove()
        self._lighting = Lighting(world, self._graphics, self._root)

    def close(self) -> None:
        """Release everything."""
        for name in list(self._shown):
            self._remove(name)
        self._lighting.remove()
        # A target that drew this scene last still refers to its root.
        self._root.set_state(panda3d().RenderState.make_empty())

    def _aimed(self, pose: Pose, shot: Shot, samples: int, background: ndarray) -> Canvas:
        self._update()
        target = self._graphics.target(shot.camera.width, shot.camera.height, samples)
        target.buffer.set_clear_color((*background, 1.0))
        target.aim(self._root, self._states[samples], BITS[PICTURE], [projection(shot)])
        set_pose(target.cameras[0], pose * AHEAD)
        return target

    def _update(self) -> None:
        """Move all nodes to the poses of the models."""
        for name in [n for n, m in self._shown.items() if self._models.get(n) is not m.instance]:
            self._remove(name)
        for name, instance in self._models.items():
            if name not in self._shown:
                self._shown[name] = self._new_model(instance)
            model = self._shown[name]
            if model.kind == MOVING or model.moves != instance.moves:
                model.moves = instance.moves
                self._versions[model.kind] += sum(link.follow() for link in model.links)

    def _shadow_maps(self, pose: Pose, shot: Shot) -> list[Canvas]:
        """Choose the programs for a view; return the shadow maps to draw before it."""
        moving = self._boxes(MOVING)
        hulls = self._lighting.shadows_of(moving) if len(moving) else ()
        seen = any(in_view(hull, pose, shot) for hull in hulls)
        programs = self._lighting.programs[seen]
        self._root.set_shader(programs[PLAIN])
        for model in self._shown.values():
            for link in model.links:
                link.face(pose.position, programs)
        kinds = (STILL, MOVING) if seen else (STILL,)
        return self._lighting.update({kind: self._versions[kind] for kind in kinds}, self._boxes)

    def _remove(self, name: str) -> None:
        model = self._shown.pop(name)
        self._versions[model.kind] += 1
        for link in model.links:
            link.path.remove_node()

    def _boxes(self, kind: str) -> ndarray:
        """Return the corners of the boxes around shadow casters, (n, 8, 3)."""
        models = [model for model in self._shown.values() if model.kind == kind]
        boxes = [link.boxes for model in models for link in model.links]
        return np.concatenate([np.zeros((0, 8, 3)), *boxes])

    def _new_model(self, instance: Any) -> _ShownModel:
        nodes, kind = [], STILL if instance.model.static else MOVING
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
                nodes.append(_LinkNode(self._root, AttachedFrame(body, link.name), drawable))
        return _ShownModel(instance, kind, nodes)


def projection(shot: Shot) -> ndarray:
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


def in_view(hulls: ndarray, pose: Pose, shot: Shot) -> bool:
    """Return whether any of several convex hulls may be visible.

    Hulls are (n, m, 4): homogeneous points of each in the world, with a last value of 0 for
    directions. A hull is invisible if its part beyond `near` is outside one side of the view.
    """
    local = (hulls[..., :3] - hulls[..., 3:] * pose.position) @ (pose * AHEAD).rotation_matrix()
    clip = np.concatenate((local, hulls[..., 3:]), axis=2) @ projection(shot).T
    # A little wider than the view: shadows have soft edges.
    edge = 1.01 * clip[..., 3:]
    sides = np.concatenate((edge + clip[..., :2], edge - clip[..., :2]), axis=2)
    # A side's distances of the points beyond `near`, and of those before it, by their distances
    # from `near`: where the sum of two is positive, so is the point of their edge at `near`.
    ahead = clip[..., 2:3] + clip[..., 3:]
    ratios = sides / np.maximum(np.abs(ahead), 1e-12)
    beyond, before = (
        np.where(there, ratios, -np.inf).max(axis=1) for there in (ahead >= 0.0, ahead < 0.0)
    )
    inside = np.maximum(beyond, beyond + before) > 0.0
    return bool(inside.all(axis=1).any())
