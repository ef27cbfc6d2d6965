"""Pictures of a simulation: what cameras and `view.py` draw with, on Panda3D.

`graphics` is the engine with its buffers, `scene` what is to be seen, with each link's `drawables`
and the `lights` with their shadow maps, `shaders` the programs that draw, and `renderer` takes
pictures and depths through a pinhole. `surfaces` reads shapes with the images on them; `finish`
does to a picture what a lens and a sensor do.
"""
