#version 140
// The distance along the view, by which a projection divides. Shadow maps do not use it.
out vec4 depth;

void main() {
  depth = vec4(1.0 / gl_FragCoord.w);
}
