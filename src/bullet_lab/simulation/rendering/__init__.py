"""Draw the pictures of cameras and of `view.py` with Panda3D.

`graphics` is the engine with its buffers, `surfaces` makes triangles of shapes, `drawables` gives
them to Panda3D with their textures, `lights` holds the lights with their shadow maps, `shaders` the
GLSL programs, `renderer` takes pictures and depths through a pinhole camera, and `finish` adds lens
and sensor errors to a picture.
"""
