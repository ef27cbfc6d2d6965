"""What every node is made of: start, parameters, publishers, lock step, transforms."""

from bullet_lab.moved import names_of

__getattr__ = names_of(__name__, "bullet_lab.ros.node.node")
