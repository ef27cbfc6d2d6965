#version 140
// Draws pixels. lights.py fills in what is in capitals.
//
// Mesa's software anisotropic filter takes the nearest texel, which moves edges by up to a pixel.
// There is no branch, since Mesa's software always computes both sides.
uniform float exposure;
uniform sampler2D p3d_Texture0;
in vec3 place, normal, given_off;
// Mesa's software reads these many times as fast as uniforms.
flat in vec3 ambient_light;
flat in vec4 colour;
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
  vec3 lit = ambient_light;
LIGHTS
  vec4 paint = PAINT;
  drawn = vec4((exposure * lit * colour.rgb + given_off) * paint.rgb, colour.a * paint.a);
}
