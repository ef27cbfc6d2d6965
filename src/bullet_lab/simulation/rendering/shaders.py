"""The programs that draw, in GLSL.

Light is Lambert's, worked out for each pixel in the world's frame:

    colour · exposure · (ambient + sum over lights of diffuse · max(0, normal · towards light)
                         · fading · cone · what reaches the place by the shadow maps)

with fading 1 / (constant + linear d + quadratic d²), 1 at most and 0 beyond the light's range.
There are no highlights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Sequence

STILL, MOVING = "still", "moving"

VERSION = "#version 150\n"

VERTEX = """
uniform mat4 p3d_ModelViewProjectionMatrix;
uniform mat4 p3d_ModelMatrix;
in vec4 p3d_Vertex;
in vec3 p3d_Normal;
in vec4 p3d_Color;
in vec2 p3d_MultiTexCoord0;
out vec3 place;
out vec3 normal;
flat out vec4 colour;
out vec2 picture;

void main() {
  gl_Position = p3d_ModelViewProjectionMatrix * p3d_Vertex;
  place = (p3d_ModelMatrix * p3d_Vertex).xyz;
  normal = mat3(p3d_ModelMatrix) * p3d_Normal;
  colour = p3d_Color;
  picture = p3d_MultiTexCoord0;
"""

# Distance along the view: what a projection divides by.
DEPTH_VERTEX = """#version 150
uniform mat4 p3d_ModelViewProjectionMatrix;
in vec4 p3d_Vertex;
out float ahead;

void main() {
  gl_Position = p3d_ModelViewProjectionMatrix * p3d_Vertex;
  ahead = gl_Position.w;
}
"""

DEPTH_FRAGMENT = """#version 150
in float ahead;
out vec4 depth;

void main() {
  depth = vec4(ahead);
}
"""

SHADOW_FRAGMENT = """#version 150
void main() {
}
"""

FRAGMENT = """
uniform float exposure;
uniform vec3 ambient;
in vec3 place;
in vec3 normal;
flat in vec4 colour;
in vec2 picture;
out vec4 drawn;

// What is left of a light at a distance within its range.
float fading(float distance, vec4 attenuation) {
  float fade = attenuation.y + distance * (attenuation.z + distance * attenuation.w);
  return 1.0 / max(1.0, fade);
}

// What is left of a spot: cone holds the cosines of the inner and the outer angle and the power.
float cone_share(float cosine, vec3 cone) {
  float share = clamp((cosine - cone.y) / max(1e-6, cone.x - cone.y), 0.0, 1.0);
  return cone.z == 1.0 ? share : pow(share, cone.z);
}

// The share of a light that a shadow map lets through; all of it where the map does not reach.
float reach(sampler2DShadow map, vec3 there) {
  vec2 off = abs(there.xy - 0.5);
  float share = texture(map, vec3(there.xy, min(there.z, 1.0)));
  return max(off.x, off.y) > 0.5 ? 1.0 : share;
}

float reach(sampler2DShadow map, vec4 there) {
  return there.w > 0.0 ? reach(map, there.xyz / there.w) : 1.0;
}

// The same for a lamp with six maps around it: columns for x, y, z, rows for the two directions.
// faces holds the nearest and the farthest distance in the maps, and half a pixel of one.
float reach_around(sampler2DShadow maps, vec3 offset, vec3 faces) {
  vec3 size = abs(offset);
  float ahead = max(size.x, max(size.y, size.z));
  float column = ahead == size.x ? 0.0 : ahead == size.y ? 1.0 : 2.0;
  vec3 turned = column == 0.0 ? offset.yzx : column == 1.0 ? offset.xzy : offset;
  vec2 there = clamp(0.5 * turned.xy / ahead + 0.5, faces.z, 1.0 - faces.z);
  float row = turned.z < 0.0 ? 0.0 : 1.0;
  float near = faces.x, far = faces.y;
  float depth = (far + near - 2.0 * far * near / ahead) / (far - near);
  return texture(maps, vec3((there.x + column) / 3.0, (there.y + row) / 2.0,
                            min(0.5 * depth + 0.5, 1.0)));
}
"""

# What the footprint of a pixel covers of a texture: as the driver has it, a square as wide as the
# footprint is long.
PAINTED = """
uniform sampler2D p3d_Texture0;

vec3 painted(vec2 there) {
  return texture(p3d_Texture0, there).rgb;
}
"""

# On a surface at a slant the footprint is longer than wide: four samples along it, from finer
# copies of the texture than one sample would need. The driver's own anisotropic filter will not do:
# Mesa's in software takes the nearest texel, which moves edges by up to a pixel. Without a branch:
# in software both ways of one are always taken.
PAINTED_AT_A_SLANT = """
uniform sampler2D p3d_Texture0;

vec3 painted(vec2 there) {
  vec2 size = vec2(textureSize(p3d_Texture0, 0));
  vec2 right = dFdx(there), down = dFdy(there);
  vec2 r = right * size, d = down * size;
  float rr = dot(r, r), dd = dot(d, d);
  float longer = sqrt(max(max(rr, dd), 1e-12));
  float shorter = max(1.0, abs(r.x * d.y - r.y * d.x) / longer);
  float count = clamp(longer / shorter, 1.0, 4.0);
  float level = log2(longer / count);
  // Samples a quarter of the footprint apart where it is four times as long as wide, else nearer.
  vec2 step = (rr > dd ? right : down) * (count - 1.0) / (3.0 * count);
  return 0.25 * (textureLod(p3d_Texture0, there - 1.5 * step, level).rgb
                 + textureLod(p3d_Texture0, there - 0.5 * step, level).rgb
                 + textureLod(p3d_Texture0, there + 0.5 * step, level).rgb
                 + textureLod(p3d_Texture0, there + 1.5 * step, level).rgb);
}
"""

PLAIN, TEXTURED, SLANTED = "plain", "textured", "slanted"
PAINT = {PLAIN: "", TEXTURED: PAINTED, SLANTED: PAINTED_AT_A_SLANT}

# What is worked out for corners and interpolated between them. A place that is a little above a
# surface does not lie in the surface's own shadow; for a spot it is higher farther away, in
# proportion to the distance along its axis. From the [-1, 1] of clip coordinates to the [0, 1] of a
# map; a sun's rays are parallel, so nothing is to be divided by.
SUN_CORNER = """
  LIGHT_cosine = max(0.0, -dot(normal, LIGHT_along));
"""
SUN_IN_MAP = """
  LIGHT_in_still = 0.5 * (LIGHT_into_still * vec4(place + LIGHT_margin * normal, 1.0)).xyz + 0.5;
"""
SPOT_IN_MAP = """
  {
    float ahead = (LIGHT_into_MAP * vec4(place, 1.0)).w;
    vec4 clip = LIGHT_into_MAP * vec4(place + LIGHT_margin * ahead * normal, 1.0);
    LIGHT_in_MAP = 0.5 * (clip + clip.w);
  }
"""

SUN_LINES = """
  if (LIGHT_cosine > 0.0) lit += LIGHT_diffuse * LIGHT_cosine{factors};
"""
LAMP_LINES = """
  {{
    vec3 towards = LIGHT_position - place;
    float distance = max(1e-6, length(towards));
    towards /= distance;
    float cosine = dot(n, towards);
    if (cosine > 0.0 && distance <= LIGHT_attenuation.x)
      lit += LIGHT_diffuse * cosine * fading(distance, LIGHT_attenuation){factors};
  }}
"""


@dataclass(frozen=True)
class LightProgram:
    """How one light is worked out; its uniforms are named `light<number>_…`.

    Attributes:
        number: of the light.
        kind: directional, point or spot.
        maps: its shadow maps: none, STILL, or of other lights than points STILL and MOVING.
    """

    number: int
    kind: str
    maps: Sequence[str] = ()

    def vertex_declarations(self) -> str:
        """Return what the program for corners declares."""
        names: List[str] = []
        if self.kind == "directional":
            names += ["uniform vec3 LIGHT_along", "out float LIGHT_cosine"]
        if self.kind != "point" and self.maps:
            names += ["uniform float LIGHT_margin"]
            names += [f"uniform mat4 LIGHT_into_{name}" for name in self._in_maps()]
        return self._named("".join(f"{name};\n" for name in names) + self._places("out"))

    def vertex_lines(self) -> str:
        """Return what is worked out for a corner."""
        if self.kind == "directional":
            return self._named(SUN_CORNER + (SUN_IN_MAP if self.maps else ""))
        return self._named("".join(SPOT_IN_MAP.replace("MAP", name) for name in self._in_maps()))

    def fragment_declarations(self) -> str:
        """Return what the program for pixels declares."""
        names = ["uniform vec3 LIGHT_diffuse"]
        if self.kind == "directional":
            names += ["in float LIGHT_cosine"]
        else:
            names += ["uniform vec3 LIGHT_position", "uniform vec4 LIGHT_attenuation"]
        names += ["uniform vec3 LIGHT_along", "uniform vec3 LIGHT_cone"] * (self.kind == "spot")
        names += [f"uniform sampler2DShadow LIGHT_{name}" for name in self.maps]
        if self.kind == "point" and self.maps:
            names += ["uniform vec3 LIGHT_faces", "uniform float LIGHT_margin"]
        if self.kind == "directional" and MOVING in self.maps:
            names += ["uniform vec3 LIGHT_zoom", "uniform vec3 LIGHT_shift"]
        return self._named("".join(f"{name};\n" for name in names) + self._places("in"))

    def fragment_lines(self) -> str:
        """Return what adds the light to `lit`, given `place` and the normal `n`."""
        factors: List[str] = []
        if self.kind == "spot":
            factors += ["cone_share(dot(-towards, LIGHT_along), LIGHT_cone)"]
        if self.kind == "directional":
            # Both maps look along the same axes.
            there = {STILL: "LIGHT_in_still", MOVING: "LIGHT_zoom * LIGHT_in_still + LIGHT_shift"}
            factors += [f"reach(LIGHT_{name}, {there[name]})" for name in self.maps]
        elif self.kind == "point" and self.maps:
            lifted = "place + LIGHT_margin * distance * n - LIGHT_position"
            factors += [f"reach_around(LIGHT_still, {lifted}, LIGHT_faces)"]
        else:
            factors += [f"reach(LIGHT_{name}, LIGHT_in_{name})" for name in self._in_maps()]
        lines = SUN_LINES if self.kind == "directional" else LAMP_LINES
        return self._named(lines.format(factors="".join(f" * {factor}" for factor in factors)))

    def _in_maps(self) -> Sequence[str]:
        """Return the maps that corners have their places in."""
        if self.kind == "point":
            return ()
        return self.maps[:1] if self.kind == "directional" else self.maps

    def _places(self, way: str) -> str:
        size = "vec3" if self.kind == "directional" else "vec4"
        return "".join(f"{way} {size} LIGHT_in_{name};\n" for name in self._in_maps())

    def _named(self, text: str) -> str:
        return text.replace("LIGHT", f"light{self.number}")


def picture_vertex(lights: Sequence[LightProgram]) -> str:
    """Return the program for the corners of what is seen."""
    declared = "".join(light.vertex_declarations() for light in lights)
    return f"{VERSION}{declared}{VERTEX}{''.join(light.vertex_lines() for light in lights)}}}\n"


def picture_fragment(lights: Sequence[LightProgram], paint: str) -> str:
    """Return the program for the pixels of what is seen: PLAIN, TEXTURED, or also SLANTED."""
    declared = "".join(light.fragment_declarations() for light in lights)
    added = "".join(light.fragment_lines() for light in lights)
    surface = "colour.rgb" if paint == PLAIN else "colour.rgb * painted(picture)"
    return f"""{VERSION}{declared}{FRAGMENT}{PAINT[paint]}
void main() {{
  vec3 n = normalize(normal);
  vec3 lit = ambient;
{added}
  // Panda3D hands pixels out with blue first.
  drawn = vec4((exposure * lit * {surface}).bgr, colour.a);
}}
"""


def shadow_vertex(into_map: str) -> str:
    """Return the program for the corners of what throws shadows.

    Args:
        into_map: name of the uniform with the matrix from the world to the map's clip
            coordinates.
    """
    return f"""{VERSION}
uniform mat4 p3d_ModelMatrix;
uniform mat4 {into_map};
in vec4 p3d_Vertex;

void main() {{
  gl_Position = {into_map} * (p3d_ModelMatrix * p3d_Vertex);
}}
"""
