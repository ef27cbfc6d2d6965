#version 140
// Draws corners. lights.py fills in what is in capitals.
uniform mat4 p3d_ModelViewProjectionMatrix, p3d_ModelMatrix, p3d_ViewMatrixInverse;
uniform float exposure;
uniform vec3 ambient;
in vec4 p3d_Vertex;
in vec3 p3d_Normal;
in vec4 p3d_Color;
in vec2 p3d_MultiTexCoord0;
in vec3 glow;
in float shine;
out vec3 place, normal, given_off;
flat out vec4 colour;
flat out vec3 ambient_light;
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
  ambient_light = ambient;
  given_off = exposure * glow;
  vec3 to_camera = normalize(p3d_ViewMatrixInverse[3].xyz - place);
  picture = p3d_MultiTexCoord0;
LIGHTS}
