"""Draw the pictures of cameras and of `view.py` with Panda3D.

`graphics` is the engine with its buffers, `drawables` makes triangles and textures of shapes,
`lights` has the lights with their GLSL programs and shadow maps, and `renderer` takes pictures and
depths through a pinhole camera. `plugins.camera` adds the errors of lens and sensor.
"""
