"""Make the GLSL programs that draw.

Light is Lambertian and is computed for each pixel in the world's frame:

    picture · exposure · (colour · (ambient + sum over lights of diffuse
                                    · max(0, normal · towards light) · fading · cone
                                    · what reaches the place by the shadow maps) + glow)

where the glow is the light that a surface emits, and what its ambient colour adds to its colour in
ambient light. The fading is 1 / (constant + linear d + quadratic d²), at most 1, and 0 beyond the
light's range. There are no highlights.
"""

from __future__ import annotations

from typing import Sequence, Tuple

STILL, MOVING = "still", "moving"
# m. Objects that are nearer to a spot or point light cast no shadow.
NEAREST = 0.02
# Pixels along each side of one of the six maps around a point light.
LAMP_SIZE = 1024

DEPTH_VERTEX = """#version 150
uniform mat4 p3d_ModelViewProjectionMatrix;
in vec4 p3d_Vertex;

void main() {
  gl_Position = p3d_ModelViewProjectionMatrix * p3d_Vertex;
}
"""
# The distance along the view, by which a projection divides. Shadow maps do not use it.
DEPTH_FRAGMENT = """#version 150
out vec4 depth;

void main() {
  depth = vec4(1.0 / gl_FragCoord.w);
}
"""

VERTEX = """#version 150
uniform mat4 p3d_ModelViewProjectionMatrix, p3d_ModelMatrix;
uniform float exposure;
in vec4 p3d_Vertex;
in vec3 p3d_Normal;
in vec4 p3d_Color;
in vec2 p3d_MultiTexCoord0;
in vec3 glow;
out vec3 place, normal;
flat out vec4 colour;
flat out vec3 given_off;
out vec2 picture;
DECLARED
// Where a corner is in a shadow map. A place that is a little above a surface does not lie in the
// surface's own shadow; for a spot it is higher farther away, in proportion to the distance along
// its axis, which is always 1 for a sun.
vec4 in_map(mat4 into, float lift) {
  float ahead = (into * vec4(place, 1.0)).w;
  vec4 clip = into * vec4(place + lift * ahead * normal, 1.0);
  return 0.5 * (clip + clip.w);
}

void main() {
  gl_Position = p3d_ModelViewProjectionMatrix * p3d_Vertex;
  place = (p3d_ModelMatrix * p3d_Vertex).xyz;
  normal = mat3(p3d_ModelMatrix) * p3d_Normal;
  colour = p3d_Color;
  given_off = exposure * glow;
  picture = p3d_MultiTexCoord0;
LIGHTS}
"""
# A sun's position is the direction to it.
CORNER_LINE = "  LIGHT_cosine = max(0.0, dot(normal, LIGHT_position.xyz));\n"
CORNER_MAP_LINE = "  LIGHT_in_MAP = in_map(LIGHT_into_MAP, LIGHT_lift_MAP);\n"

# Mesa's software anisotropic filter takes the nearest texel, which moves edges by up to a pixel.
# There is no branch, since Mesa's software always computes both sides.
FRAGMENT = """#version 150
uniform float exposure;
uniform vec3 ambient;
uniform sampler2D p3d_Texture0;
in vec3 place, normal;
flat in vec4 colour;
flat in vec3 given_off;
in vec2 picture;
out vec4 drawn;
DECLARED
// What a surface takes of a lamp or spot that is at an offset from it: attenuation holds the range
// and how it fades.
float lamp(vec3 n, vec3 offset, vec4 attenuation) {
  float distance = max(1e-6, length(offset));
  float fade = attenuation.y + distance * (attenuation.z + distance * attenuation.w);
  float cosine = max(0.0, dot(n, offset) / distance);
  return distance <= attenuation.x ? cosine / max(1.0, fade) : 0.0;
}

// What is left of a spot: cone holds the cosines of the inner and the outer angle and the power.
float cone_share(vec3 offset, vec3 along, vec3 cone) {
  float cosine = dot(normalize(offset), along);
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
float reach_around(sampler2DShadow maps, vec3 offset, vec3 lift) {
  offset += length(offset) * lift;
  vec3 size = abs(offset);
  float ahead = max(size.x, max(size.y, size.z));
  float column = ahead == size.x ? 0.0 : ahead == size.y ? 1.0 : 2.0;
  vec3 turned = column == 0.0 ? offset.yzx : column == 1.0 ? offset.xzy : offset;
  vec2 there = clamp(0.5 * turned.xy / ahead + 0.5, HALF_A_PIXEL, 1.0 - HALF_A_PIXEL);
  float row = turned.z < 0.0 ? 0.0 : 1.0;
  return texture(maps, vec3((there.x + column) / 3.0, (there.y + row) / 2.0,
                            1.0 - NEAREST / ahead));
}

// On a surface at a slant, what a pixel covers of a texture is longer than wide: four samples along
// it, from finer copies of the texture than one sample would need.
vec4 at_a_slant(vec2 there) {
  vec2 size = vec2(textureSize(p3d_Texture0, 0));
  vec2 right = dFdx(there), down = dFdy(there);
  vec2 r = right * size, d = down * size;
  float rr = dot(r, r), dd = dot(d, d);
  float longer = sqrt(max(max(rr, dd), 1e-12));
  float shorter = max(1.0, abs(r.x * d.y - r.y * d.x) / longer);
  float count = clamp(longer / shorter, 1.0, 4.0);
  float level = log2(longer / count);
  // Samples a quarter of the length apart where it is four times the width, else nearer.
  vec2 step = (rr > dd ? right : down) * (count - 1.0) / (3.0 * count);
  return 0.25 * (textureLod(p3d_Texture0, there - 1.5 * step, level)
                 + textureLod(p3d_Texture0, there - 0.5 * step, level)
                 + textureLod(p3d_Texture0, there + 0.5 * step, level)
                 + textureLod(p3d_Texture0, there + 1.5 * step, level));
}

void main() {
  vec3 n = normalize(normal);
  vec3 lit = ambient;
LIGHTS
  vec4 paint = PAINT;
  // Panda3D hands pixels out with blue first.
  drawn = vec4(((exposure * lit * colour.rgb + given_off) * paint.rgb).bgr, colour.a * paint.a);
}
""".replace("NEAREST", str(NEAREST)).replace("HALF_A_PIXEL", str(0.5 / LAMP_SIZE))
# For both programs: outputs of the first are inputs of the second.
DECLARED = """uniform vec3 LIGHT_diffuse, LIGHT_along, LIGHT_cone;
uniform vec4 LIGHT_position, LIGHT_attenuation;
INOUT float LIGHT_cosine;
"""
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


def picture_programs(lights: Sequence[Lit], paint: str) -> Tuple[str, str]:
    """Return the programs for corners and pixels of PLAIN, TEXTURED or SLANTED surfaces.

    The uniforms of the lights are named `light<number>_…`.
    """
    declared = _each(lights, DECLARED, MAP_DECLARED)
    vertex = VERTEX.replace("DECLARED", declared.replace("INOUT", "out"))
    fragment = FRAGMENT.replace("DECLARED", declared.replace("INOUT", "in"))
    vertex = vertex.replace("LIGHTS", _each(lights, CORNER_LINE, CORNER_MAP_LINE))
    lines = _each(lights, "  lit += LIGHT_diffuse * TAKEN", "REACH", ";\n")
    return vertex, fragment.replace("LIGHTS", lines).replace("PAINT", PAINT[paint])


def _each(lights: Sequence[Lit], of_light: str, of_map: str, end: str = "") -> str:
    """Return a text for each light, each with a text for each of its maps."""
    texts = ""
    for number, (kind, maps) in enumerate(lights):
        reach = of_map.replace("REACH", REACH[kind])
        text = of_light.replace("TAKEN", TAKEN[kind]) + "".join(
            reach.replace("MAP", m) for m in maps
        )
        texts += text.replace("LIGHT", f"light{number}") + end
    return texts
