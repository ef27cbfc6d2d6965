"""Images of a simulation: what the camera device and `view.py` draw with.

`choice` decides between EGL and PyBullet's TinyRenderer, `engine` is the PyBullet client that
draws, `scene` keeps a lit copy of the world in it, `frame` takes the pictures of one pinhole
camera, `finish` does what a lens and a sensor do to them.
"""
