"""Lights: the GLSL programs that draw in their light, and their shadow maps.

A shadow map holds how far a light reaches in each direction. Each light has a map of the static
models, drawn again when one is added, moved or removed. Directional and spot lights have a second,
small map just around the models that move, drawn again after each motion. So pictures only depend
on the present poses.

Light is Lambertian and is computed for each pixel in the world's frame:

    picture · exposure · (colour · (ambient + sum over lights of diffuse
                                    · max(0, normal · towards light) · fading · cone
                                    · what reaches the place by the shadow maps) + glow)

where the glow is the light that a surface emits, and what its ambient colour adds to its colour in
ambient light. The fading is 1 / (constant + linear d + quadratic d²), at most 1, and 0 beyond the
light's range. Surfaces with a `shine` have wide highlights of suns, computed at their corners:

    shine · specular · max(0, normal · the direction halfway between sun and camera)
"""

from __future__ import annotations

import itertools
import logging
import math
from dataclasses import dataclass
from typing import Any, Callable, Iterator, Sequence, Tuple

import numpy as np
from numpy import ndarray

from bullet_lab.simulation.rendering import Canvas, Graphics, panda_matrix, program_text
from bullet_lab.simulation.world.description import BLACK, Light, World

LOG = logging.getLogger(__name__)

STILL, MOVING = "still", "moving"
# m. Objects that are nearer to a spot or point light cast no shadow.
NEAREST = 0.02
# Pixels along each side of one of the six maps around a point light.
LAMP_SIZE = 1024

PICTURE = "picture"
# The bits of a camera's mask, by what it shows.
BITS = {PICTURE: 0, STILL: 1, MOVING: 2}
# The aim for the size of a pixel in the map of a directional light (m), and its sizes (pixels).
PIXEL = {STILL: 0.0025, MOVING: 0.006}
SIZES = {STILL: (256, 512, 1024, 2048, 4096), MOVING: (64, 128, 256, 512)}
SPOT_SIZE = {STILL: 2048, MOVING: 512}
# So many lights hand their colour to the pixels as an output of the corners: Mesa's software reads
# that many times as fast as a uniform. With more, the outputs may not suffice for all shadow maps.
FLAT_LIGHTS = 2
# The axes across and ahead in the maps of a point light.
LAMP_AXES = np.eye(3)[np.array([[1, 2, 0], [0, 2, 1], [0, 1, 2]])]
# A surface is lifted out of its own shadow by so many pixels of the map.
LIFT = 1.5
# m. A larger object, such as a floor, casts shadows but does not enlarge the map.
LARGEST = 30.0
# The textures that a program may use, without the picture on a surface.
MOST_MAPS = 15
# Rad, the whole opening: a wider spot casts shadows only within this angle.
WIDEST_SPOT = math.radians(160.0)

# For a shadow map: a matrix (4, 4) from the world to clip coordinates for each tile; its size in
# pixels; how far a surface is lifted, in m, or per m of distance from a spot or point light.
Aim = Tuple[Sequence[ndarray], int, float]

# A sun's position is the direction to it.
CORNER_LINE = """  LIGHT_cosine = max(0.0, dot(normal, LIGHT_position.xyz));
  given_off += exposure * shine * LIGHT_specular
    * max(0.0, dot(normal, normalize(LIGHT_position.xyz + to_camera)));
"""
CORNER_MAP_LINE = "  LIGHT_in_MAP = in_map(LIGHT_into_MAP, LIGHT_lift_MAP);\n"

# For both programs: outputs of the first are inputs of the second.
DECLARED = """uniform vec3 LIGHT_diffuse, LIGHT_specular, LIGHT_along, LIGHT_cone;
uniform vec4 LIGHT_position, LIGHT_attenuation;
INOUT float LIGHT_cosine;
"""
# Of the first lights.
FLAT_DECLARED = "flat INOUT vec3 LIGHT_flat_diffuse;\n"
FLAT_LINE = "  LIGHT_flat_diffuse = LIGHT_diffuse;\n"
MAP_DECLARED = """uniform sampler2DShadow LIGHT_MAP;
uniform mat4 LIGHT_into_MAP;
uniform float LIGHT_lift_MAP;
INOUT vec4 LIGHT_in_MAP;
"""
# The share of each kind of light that a surface gets, and the share that a shadow map lets through.
LAMP = "lamp(n, LIGHT_position.xyz - place, LIGHT_attenuation)"
CONE = "cone_share(place - LIGHT_position.xyz, LIGHT_along, LIGHT_cone)"
TAKEN = {"directional": "LIGHT_cosine", "point": LAMP, "spot": f"{LAMP} * {CONE}"}
REACH = {
    "directional": " * reach(LIGHT_MAP, LIGHT_in_MAP.xyz)",
    "point": " * reach_around(LIGHT_MAP, place - LIGHT_position.xyz, LIGHT_lift_MAP * n)",
    "spot": " * reach(LIGHT_MAP, LIGHT_in_MAP)",
}
# The factor of the colour of triangles.
PLAIN, TEXTURED, SLANTED = "plain", "textured", "slanted"
PAINT = {
    PLAIN: "vec4(1.0)",
    TEXTURED: "texture(p3d_Texture0, picture)",
    SLANTED: "at_a_slant(picture)",
}

# The kind of a light, and its shadow maps: none, STILL, or STILL and, but for points, MOVING.
Lit = Tuple[str, Sequence[str]]


def picture_programs(lights: Sequence[Lit], paint: str) -> tuple[str, str]:
    """Return the programs for corners and pixels of PLAIN, TEXTURED or SLANTED surfaces.

    The uniforms of the lights are named `light<number>_…`.
    """
    first = lights[:FLAT_LIGHTS]
    declared = _each(lights, DECLARED, MAP_DECLARED) + _each(first, FLAT_DECLARED)
    vertex, fragment = program_text("picture.vert"), program_text("picture.frag")
    vertex = vertex.replace("DECLARED", declared.replace("INOUT", "out"))
    fragment = fragment.replace("DECLARED", declared.replace("INOUT", "in"))
    for name, value in (("NEAREST", NEAREST), ("HALF_A_PIXEL", 0.5 / LAMP_SIZE)):
        fragment = fragment.replace(name, str(value))
    corner_lines = _each(lights, CORNER_LINE, CORNER_MAP_LINE) + _each(first, FLAT_LINE)
    vertex = vertex.replace("LIGHTS", corner_lines)
    lines = _each(lights, "  lit += LIGHT_diffuse * TAKEN", "REACH", ";\n")
    for number in range(len(first)):
        lines = lines.replace(f"light{number}_diffuse", f"light{number}_flat_diffuse")
    return vertex, fragment.replace("LIGHTS", lines).replace("PAINT", PAINT[paint])


def _each(lights: Sequence[Lit], of_light: str, of_map: str = "", end: str = "") -> str:
    """Return a text for each light, each with a text for each of its maps."""
    texts = ""
    for number, (kind, maps) in enumerate(lights):
        reach = of_map.replace("REACH", REACH[kind])
        text = of_light.replace("TAKEN", TAKEN[kind]) + "".join(
            reach.replace("MAP", m) for m in maps
        )
        texts += text.replace("LIGHT", f"light{number}") + end
    return texts


def aim_at(boxes: ndarray, light: Light, kind: str) -> Aim:
    """Return the smallest map, STILL or MOVING, for the boxes (n, 8, 3) that a light reaches."""
    place = np.asarray(light.pose.position)
    if light.kind == "point":
        ahead = [axes * ((1,), (1,), (sign,)) for sign in (-1, 1) for axes in LAMP_AXES]
        return [_perspective(axes, place) for axes in ahead], LAMP_SIZE, 2.0 * LIFT / LAMP_SIZE
    axes = axes_along(light.pose.rotate(light.direction))
    if light.kind == "spot":
        slope = math.tan(0.5 * min(light.cone.outer, WIDEST_SPOT))
        matrix, limits, rim = _perspective(axes, place), np.array((slope, slope, 1.0)), 1e-4
    else:
        matrix, limits, rim = np.eye(4), np.full(3, math.inf), PIXEL[kind]
        matrix[:3, :3] = axes
    small = boxes[np.ptp(boxes, axis=1).max(axis=1) <= LARGEST]
    points = (small if len(small) else boxes).reshape(-1, 3)
    clip = np.column_stack((points, np.ones(len(points)))) @ matrix.T
    there = clip[:, :3] / np.maximum(clip[:, 3:], NEAREST)
    if (clip[:, 3] < NEAREST).any():
        # A corner is beside the light or behind it.
        there = np.append(there, (-limits, limits), axis=0)
    low = np.maximum(there.min(axis=0, initial=math.inf) - rim, -limits)
    high = np.minimum(there.max(axis=0, initial=-math.inf) + rim, limits)
    if (low >= high).any():
        # The light reaches nothing.
        return [np.zeros((4, 4))], SIZES[kind][0], 0.0
    extent, size = float((high - low)[:2].max()), SPOT_SIZE[kind]
    if light.kind == "directional":
        size = next((s for s in SIZES[kind] if extent <= PIXEL[kind] * s), SIZES[kind][-1])
    fit = np.diag((*(2.0 / (high - low)), 1.0))
    fit[:3, 3] = -(high + low) / (high - low)
    return [fit @ matrix], size, LIFT * extent / size


def _perspective(axes: ndarray, place: ndarray) -> ndarray:
    """Return the projection from a point along the last of three axes, 45° to each side.

    A depth, from 0 to 1, is 1 - NEAREST / distance.
    """
    matrix = np.zeros((4, 4))
    matrix[(0, 1, 3), :3] = axes
    matrix[:, 3] = -matrix[:, :3] @ place
    matrix[2] = matrix[3] - (0.0, 0.0, 0.0, 2.0 * NEAREST)
    return matrix


def axes_along(direction: Sequence[float]) -> ndarray:
    """Return orthogonal unit axes as rows (3, 3); the last one is along a direction."""
    along = np.asarray(direction) / np.linalg.norm(direction)
    first = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    first /= np.linalg.norm(first)
    return np.stack((first, np.cross(along, first), along))


@dataclass(eq=False)
class _ShadowMap:
    """A shadow map of a light, in the uniforms of the scene below a root; a camera draws it."""

    graphics: Graphics
    root: Any
    camera_state: Any
    light: Light
    name: str
    kind: str
    target: Canvas | None = None
    version: int = -1

    def update(self, version: int, boxes: Callable[[str], ndarray]) -> list[Canvas]:
        """Return the map if it must be drawn again: for another version."""
        if self.version == version:
            return []
        self.version = version
        matrices, size, lift = aim_at(boxes(self.kind), self.light, self.kind)
        if self.target is None or self.target.size != size:
            self.remove()
            tiles = (3, 2) if len(matrices) > 1 else (1, 1)
            self.target = self.graphics.shadow_target(size, tiles)
        self.target.aim(self.root, self.camera_state, BITS[self.kind], matrices)
        put = self.root.set_shader_input
        put(f"{self.name}_{self.kind}", self.target.texture)
        put(f"{self.name}_into_{self.kind}", panda_matrix(matrices[0]))
        put(f"{self.name}_lift_{self.kind}", lift)
        return [self.target]

    def remove(self) -> None:
        """Release the buffer."""
        if self.target is not None:
            self.graphics.remove(self.target)


class Lighting:
    """The lights of a world in the uniforms of a scene.

    Attributes:
        programs: by whether they use the maps of moving models, and by PLAIN, TEXTURED or SLANTED.
    """

    def __init__(self, world: World, graphics: Graphics, root: Any):
        self._maps: list[_ShadowMap] = []
        self._positions: list[ndarray] = []
        self.programs: dict[bool, dict[str, Any]] = {False: {}, True: {}}
        planned = list(zip(world.lights, plan_maps(world)))
        root.set_shader_input("ambient", *world.ambient[:3])
        # Both sides of a triangle cast shadows, since a mesh may be open.
        state = graphics.state(graphics.depth_program, cull="none")
        for number, (light, kinds) in enumerate(planned):
            uniforms = _uniforms(light)
            for name, values in uniforms.items():
                root.set_shader_input(f"light{number}_{name}", *map(float, values))
            for kind in kinds:
                name = f"light{number}"
                self._maps.append(_ShadowMap(graphics, root, state, light, name, kind))
            if MOVING in kinds:
                self._positions.append(np.array(uniforms["position"]))
        for moving, paint in itertools.product((False, True), PAINT):
            lit = [(light.kind, kinds[: 1 + moving]) for light, kinds in planned]
            program = graphics.program(*picture_programs(lit, paint))
            self.programs[moving][paint] = program

    def update(self, now: dict[str, int], boxes: Callable[[str], ndarray]) -> list[Canvas]:
        """Return the maps that must be drawn again.

        `now` has the version of the STILL models, and of the MOVING ones if these are needed; a
        version changes with any pose. `boxes` gives the corners of their boxes, (n, 8, 3).
        """
        known = (shadow_map for shadow_map in self._maps if shadow_map.kind in now)
        return [target for each in known for target in each.update(now[each.kind], boxes)]

    def shadows_of(self, boxes: ndarray) -> Iterator[ndarray]:
        """Yield for each light the hulls of moving boxes (n, 8, 3) with their shadows, (n, 16, 4).

        These are homogeneous: the corners, and the directions of the infinite shadows.
        """
        for position in self._positions:
            hulls = np.zeros((len(boxes), 16, 4))
            hulls[:, :8, :3], hulls[:, :8, 3] = boxes, 1.0
            hulls[:, 8:, :3] = position[3] * boxes - position[:3]
            yield hulls

    def remove(self) -> None:
        """Release all shadow maps."""
        for shadow_map in self._maps:
            shadow_map.remove()


def _uniforms(light: Light) -> dict[str, Sequence[float]]:
    """Return the uniforms of a light by their names in the programs."""
    along = np.asarray(light.pose.rotate(light.direction))
    along = along / (np.linalg.norm(along) or 1.0)
    fade, cone = light.attenuation, light.cone
    return {
        "diffuse": light.diffuse[:3],
        "specular": light.specular[:3] if light.kind == "directional" else BLACK[:3],
        "position": (*-along, 0.0) if light.kind == "directional" else (*light.pose.position, 1.0),
        "along": along,
        "attenuation": (fade.range, fade.constant, fade.linear, fade.quadratic),
        "cone": (math.cos(0.5 * cone.inner), math.cos(0.5 * cone.outer), cone.falloff),
    }


def plan_maps(world: World) -> list[tuple[str, ...]]:
    """Return the kinds of shadow maps of each light; warn if there are too many."""
    planned: list[tuple[str, ...]] = []
    for light in world.lights:
        wanted = (STILL,) if light.kind == "point" else (STILL, MOVING)
        wanted = wanted if world.shadows and light.casts_shadows else ()
        if sum(map(len, planned)) + len(wanted) > MOST_MAPS:
            LOG.warning("light '%s' casts no shadows; %d maps are the limit", light.name, MOST_MAPS)
            wanted = ()
        planned.append(wanted)
    return planned
