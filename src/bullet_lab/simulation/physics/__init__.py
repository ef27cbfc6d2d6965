"""Bodies in PyBullet: how they are made, how they move, and what they touch."""

from bullet_lab.moved import names_of

__getattr__ = names_of(__name__, "bullet_lab.simulation.physics.physics")
