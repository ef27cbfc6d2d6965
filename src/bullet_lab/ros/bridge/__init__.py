"""The parts of the bridge: its loop, its pace, and what its devices say and take."""

from bullet_lab.moved import names_of

__getattr__ = names_of(__name__, "bullet_lab.ros.nodes.bridge")
