"""The lights of a world, and their shadow maps.

A shadow map holds how far a light reaches in each direction. What stands still is drawn into one
map for each light, again only when something is added, moved or taken away; what moves into a
second, small one of directional and spot lights, which lies just around it, again whenever it has
moved. So both follow from where things are now, and from nothing else.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from typing import Any, Callable, Dict, List, Sequence, Tuple

import numpy as np

from bullet_lab.simulation.rendering.graphics import Graphics, Target
from bullet_lab.simulation.rendering.shaders import (
    MOVING,
    PAINT,
    SHADOW_FRAGMENT,
    STILL,
    LightProgram,
    picture_fragment,
    picture_vertex,
    shadow_vertex,
)
from bullet_lab.simulation.world.description import Light, World

LOG = logging.getLogger(__name__)

PICTURE = "picture"
# Which of a camera's bits shows what.
BITS = {PICTURE: 0, STILL: 1, MOVING: 2}
# What a pixel of a map is to cover (m), and the sizes that a map may have for that (pixels).
PIXEL = {STILL: 0.0025, MOVING: 0.006}
SIZES = {STILL: (256, 512, 1024, 2048, 4096), MOVING: (64, 128, 256, 512)}
# Of the maps of spots, and of each of the six around a lamp.
SPOT_SIZES = {STILL: (2048,), MOVING: (512,)}
LAMP_SIZE = 1024
# A surface is lifted by so many pixels of the map out of its own shadow.
LIFT = 1.5
# In m: what is larger, as a floor, throws its shadow within the map but does not make it larger.
LARGEST = 30.0
# Textures that one program may use, less one for the picture on a surface.
MOST_MAPS = 15
# Rad, the whole opening: a wider spot throws shadows within this only.
WIDEST_SPOT = math.radians(160.0)
# In m: what is nearer to a spot or lamp throws no shadow.
NEAREST = 0.02
NOWHERE = np.zeros((4, 4))


@dataclass(frozen=True)
class Casters:
    """What throws shadows.

    Attributes:
        boxes: returns the corners of boxes around the shapes, (n, 8, 3) in m in the world.
        version: the same only while all of them are where they were.
    """

    boxes: Callable[[], np.ndarray]
    version: int

    def extent(self) -> np.ndarray:
        """Return the points that a map has to hold, (m, 3) in m."""
        boxes = self.boxes()
        small = boxes[np.ptp(boxes, axis=1).max(axis=1) <= LARGEST]
        return (small if len(small) else boxes).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class Aim:
    """Where a shadow map looks.

    Attributes:
        matrices: for each tile, from the world to its clip coordinates, (4, 4).
        size: pixels along each side of a tile.
        margin: how far a surface is lifted, m, or per m of distance from a spot or lamp.
        faces: of a lamp: nearest and farthest distance in m, and half a pixel as a share.
    """

    matrices: Sequence[np.ndarray]
    size: int
    margin: float = 0.0
    faces: Tuple[float, float, float] = (0.0, 0.0, 0.0)


def aim_sun(light: Light, points: np.ndarray, kind: str) -> Aim:
    """Return the map of a directional light that just holds points, (n, 3) in m."""
    axes = axes_along(light.pose.rotate(light.direction))
    seen = (points if len(points) else np.zeros((1, 3))) @ axes.T
    low, high = seen.min(axis=0) - PIXEL[kind], seen.max(axis=0) + PIXEL[kind]
    matrix = np.eye(4)
    matrix[:3, :3] = axes * (2.0 / (high - low))[:, None]
    matrix[:3, 3] = -(high + low) / (high - low)
    extent = float((high - low)[:2].max())
    size = next((s for s in SIZES[kind] if extent <= PIXEL[kind] * s), SIZES[kind][-1])
    return Aim((matrix,), size, LIFT * extent / size)


def aim_spot(light: Light, points: np.ndarray, kind: str) -> Aim:
    """Return the map of a spot that holds what its cone lights of points, (n, 3) in m."""
    half = 0.5 * min(light.cone.outer, WIDEST_SPOT)
    view = np.eye(4)
    view[:3, :3] = axes_along(light.pose.rotate(light.direction))
    view[:3, 3] = -view[:3, :3] @ np.asarray(light.pose.position)
    far = _farthest(light, points)
    slope = math.tan(half)
    matrix = _perspective(far) @ np.diag((1.0 / slope, 1.0 / slope, 1.0, 1.0)) @ view
    low, high = _cropped(np.column_stack((points, np.ones(len(points)))) @ matrix.T)
    size = SPOT_SIZES[kind][0]
    if (low >= high).any():
        return Aim((NOWHERE,), size)
    crop = np.eye(4)
    crop[:2, :2] = np.diag(2.0 / (high - low))
    crop[:2, 3] = -(high + low) / (high - low)
    return Aim((crop @ matrix,), size, LIFT * slope * float((high - low).max()) / size)


def aim_lamp(light: Light, points: np.ndarray) -> Aim:
    """Return the six maps around a point light: for -x, -y, -z, x, y, z."""
    far = _farthest(light, points)
    matrices = []
    for sign in (-1.0, 1.0):
        for axis in range(3):
            view = np.zeros((4, 4))
            across = [other for other in range(3) if other != axis]
            view[(0, 1), across] = 1.0
            view[2, axis] = sign
            view[:3, 3] = -view[:3, :3] @ np.asarray(light.pose.position)
            view[3, 3] = 1.0
            matrices.append(_perspective(far) @ view)
    return Aim(matrices, LAMP_SIZE, 2.0 * LIFT / LAMP_SIZE, (NEAREST, far, 0.5 / LAMP_SIZE))


def _farthest(light: Light, points: np.ndarray) -> float:
    """Return the farthest distance of points within the light's range; at least something."""
    distances = np.linalg.norm(points - np.asarray(light.pose.position), axis=1)
    return 1.01 * max(2.0 * NEAREST, min(light.attenuation.range, float(distances.max())))


def _perspective(far: float) -> np.ndarray:
    """Return OpenGL's projection for a view along +z, 45° to each side."""
    near = NEAREST
    matrix = np.diag((1.0, 1.0, (far + near) / (far - near), 0.0))
    matrix[2, 3], matrix[3, 2] = -2.0 * far * near / (far - near), 1.0
    return matrix


def _cropped(clip: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return the rectangle of [-1, 1]² that holds points in clip coordinates, (n, 4)."""
    if (clip[:, 3] <= NEAREST).any():
        # Something is beside the light or behind it.
        return -np.ones(2), np.ones(2)
    there = clip[:, :2] / clip[:, 3:]
    return np.maximum(there.min(axis=0), -1.0), np.minimum(there.max(axis=0), 1.0)


def _between(one: Aim, other: Aim) -> Tuple[List[float], List[float]]:
    """Return what leads from places in one map of a sun to those in another.

    Returns:
        Factors and what is added, along three axes, for places within [0, 1].
    """
    (first,), (second,) = one.matrices, other.matrices
    zoom = np.linalg.norm(second[:3, :3], axis=1) / np.linalg.norm(first[:3, :3], axis=1)
    shift = 0.5 * (1.0 + second[:3, 3] - zoom * (1.0 + first[:3, 3]))
    return zoom.tolist(), shift.tolist()


def axes_along(direction: Sequence[float]) -> np.ndarray:
    """Return orthogonal unit axes (3, 3), by rows; the last one goes along a direction."""
    along = np.asarray(direction) / np.linalg.norm(direction)
    first = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    first /= np.linalg.norm(first)
    return np.stack((first, np.cross(along, first), along))


class _ShadowMap:
    """One shadow map of one light, in the uniforms of the scene.

    Args:
        graphics: makes its buffers.
        root: of the scene.
        name: of the light's uniforms.
        kind: STILL or MOVING.
        tiles: columns and rows of maps in its buffer.
    """

    def __init__(
        self, graphics: Graphics, root: Any, name: str, kind: str, tiles: Tuple[int, int] = (1, 1)
    ):
        self.aim = Aim((), 0)
        self._graphics = graphics
        self._root = root
        self._name = name
        self._kind = kind
        self._targets: Dict[int, Target] = {}
        self._version = -1
        # The uniforms with each tile's matrix; that of a single one is the picture's, too.
        into = f"{name}_into_{kind}"
        self._tiles = tiles
        self._matrices = [into] if tiles == (1, 1) else [f"{into}_{k}" for k in range(6)]
        self._states = [self._state(matrix) for matrix in self._matrices]

    def is_of(self, version: int) -> bool:
        """Whether the map is of this version; from now on it is taken for that."""
        same, self._version = version == self._version, version
        return same

    def point(self, aim: Aim) -> Target:
        """Return the target to be drawn into, its cameras and the uniforms set."""
        if aim.size not in self._targets:
            if self._kind == STILL:
                self.remove()
            self._targets[aim.size] = self._target(aim.size)
        target = self._targets[aim.size]
        self.aim = aim
        put = self._root.set_shader_input
        put(f"{self._name}_{self._kind}", target.texture)
        for name, matrix in zip(self._matrices, aim.matrices):
            put(name, self._graphics.matrix(matrix))
        if len(self._matrices) > 1:
            put(f"{self._name}_faces", *aim.faces)
        return target

    def _target(self, size: int) -> Target:
        core = self._graphics.core
        target = self._graphics.shadow_target(size, self._tiles)
        for path, state in zip(target.cameras, self._states):
            camera = path.node()
            camera.set_initial_state(state)
            camera.set_scene(self._root)
            camera.set_camera_mask(core.BitMask32.bit(BITS[self._kind]))
            # The program projects by itself: what the camera's own lens sees does not matter.
            camera.set_cull_bounds(core.OmniBoundingVolume())
        return target

    def _state(self, matrix: str) -> Any:
        core = self._graphics.core
        state = core.NodePath("state")
        program = self._graphics.program(shadow_vertex(matrix), SHADOW_FRAGMENT)
        state.set_shader(program)
        # Both sides throw shadows, since a mesh may be open.
        state.set_attrib(core.CullFaceAttrib.make(core.CullFaceAttrib.M_cull_none))
        return state.get_state()

    def remove(self) -> None:
        """Give all buffers back."""
        for target in self._targets.values():
            self._graphics.remove(target)
        self._targets.clear()


class _Source:
    """A light of the world in the uniforms of the scene, with its shadow maps."""

    def __init__(self, light: Light, program: LightProgram, graphics: Graphics, root: Any):
        self.program = program
        self._light = light
        self._name = f"light{program.number}"
        self._root = root
        tiles = (3, 2) if light.kind == "point" else (1, 1)
        self._maps: Dict[str, _ShadowMap] = {}
        self._aims: List[Aim] = []
        for kind in program.maps:
            self._maps[kind] = _ShadowMap(graphics, root, self._name, kind, tiles)
        self._put("diffuse", *light.diffuse[:3])
        if light.kind != "point":
            along = np.asarray(light.pose.rotate(light.direction))
            self._put("along", *(along / np.linalg.norm(along)).tolist())
        if light.kind != "directional":
            fade = light.attenuation
            self._put("position", *light.pose.position)
            self._put("attenuation", fade.range, fade.constant, fade.linear, fade.quadratic)
        if light.kind == "spot":
            cone = light.cone
            cosines = (math.cos(0.5 * angle) for angle in (cone.inner, cone.outer))
            self._put("cone", *cosines, cone.falloff)

    def update(self, casters: Dict[str, Casters]) -> List[Target]:
        """Take where all that throws shadows is now; return the maps that are to be drawn."""
        due = []
        for kind, shadow_map in self._maps.items():
            if kind not in casters or shadow_map.is_of(casters[kind].version):
                continue
            due.append(shadow_map.point(self._aim(casters[kind], kind)))
        # A map that is not looked up now may be of anywhere: it has no say in the uniforms.
        aims = [shadow_map.aim for kind, shadow_map in self._maps.items() if kind in casters]
        if aims != self._aims:
            self._aims = aims
            self._put("margin", max(aim.margin for aim in aims))
            if self._light.kind == "directional" and len(aims) == 2:
                zoom, shift = _between(*aims)
                self._put("zoom", *zoom)
                self._put("shift", *shift)
        return due

    def shadow_of(self, points: np.ndarray, bounds: np.ndarray) -> np.ndarray:
        """Return points (…, n, 3) and where their shadows leave bounds (2, 3): (…, 2 n, 3)."""
        if self._light.kind == "directional":
            ways = np.broadcast_to(self._light.pose.rotate(self._light.direction), points.shape)
        else:
            ways = points - np.asarray(self._light.pose.position)
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = (np.where(ways > 0.0, bounds[1], bounds[0]) - points) / ways
        farthest = np.where(ways == 0.0, np.inf, steps).min(axis=-1, keepdims=True)
        return np.concatenate((points, points + np.maximum(farthest, 0.0) * ways), axis=-2)

    def remove(self) -> None:
        """Give all maps back."""
        for shadow_map in self._maps.values():
            shadow_map.remove()

    def _aim(self, casters: Casters, kind: str) -> Aim:
        points = casters.extent()
        if self._light.kind == "directional":
            return aim_sun(self._light, points, kind)
        if not len(points):
            size = LAMP_SIZE if self._light.kind == "point" else SPOT_SIZES[kind][0]
            return Aim((NOWHERE,) * 6, size, faces=(1.0, 2.0, 0.5))
        if self._light.kind == "spot":
            return aim_spot(self._light, points, kind)
        return aim_lamp(self._light, points)

    def _put(self, name: str, *values: float) -> None:
        self._root.set_shader_input(f"{self._name}_{name}", *values)


class Lighting:
    """The lights of a world in the uniforms of a scene.

    Args:
        world: for its lights.
        graphics: draws the shadow maps.
        root: node path of the scene.
    """

    def __init__(self, world: World, graphics: Graphics, root: Any):
        programs = plan_maps(world)
        self._sources = [
            _Source(light, program, graphics, root)
            for light, program in zip(world.lights, programs)
        ]
        root.set_shader_input("ambient", *world.ambient[:3])
        without = [replace(program, maps=program.maps[:1]) for program in programs]
        self._states = {
            moving: {paint: _drawing(graphics, lights, paint) for paint in PAINT}
            for moving, lights in ((True, programs), (False, without))
        }

    @property
    def casting(self) -> bool:
        """Whether any light throws shadows."""
        return any(source.program.maps for source in self._sources)

    def states(self, moving: bool) -> Dict[str, Any]:
        """Return how PLAIN, TEXTURED and SLANTED surfaces are drawn.

        Args:
            moving: with the shadows of what moves.
        """
        return self._states[moving]

    def update(self, casters: Dict[str, Casters]) -> List[Target]:
        """Take where what throws shadows is now; return the maps that are to be drawn.

        Args:
            casters: what stands still, by STILL, and what moves, by MOVING, if it matters.
        """
        return [target for source in self._sources for target in source.update(casters)]

    def shadows_of(self, boxes: np.ndarray, bounds: np.ndarray) -> List[np.ndarray]:
        """Return for each light that moving things throw shadows from where these are.

        Args:
            boxes: (n, 8, 3) corners of boxes that throw shadows, m in the world.
            bounds: (2, 3) least and greatest corner of the box around all that is to be seen.

        Returns:
            Points whose hulls hold each box and its shadow, (n, 16, 3).
        """
        return [s.shadow_of(boxes, bounds) for s in self._sources if MOVING in s.program.maps]

    def remove(self) -> None:
        """Give all shadow maps back."""
        for source in self._sources:
            source.remove()


def _drawing(graphics: Graphics, lights: Sequence[LightProgram], paint: str) -> Any:
    """Return the state that a kind of surfaces is drawn with."""
    program = graphics.program(picture_vertex(lights), picture_fragment(lights, paint))
    state = graphics.core.NodePath("state")
    state.set_shader(program)
    return state.get_state()


def plan_maps(world: World) -> List[LightProgram]:
    """Return how each light of a world is worked out; says so where shadows are left out."""
    programs, maps = [], 0
    for number, light in enumerate(world.lights):
        wanted: Tuple[str, ...] = ()
        if world.shadows and light.casts_shadows:
            wanted = (STILL,) if light.kind == "point" else (STILL, MOVING)
        if maps + len(wanted) > MOST_MAPS:
            LOG.warning("light '%s' throws no shadows: too many others do", light.name)
            wanted = ()
        maps += len(wanted)
        programs.append(LightProgram(number, light.kind, wanted))
    return programs
