"""A stand-in for viser's scene."""

import numpy as np
import pytest


class Node:
    """A node of the scene, and how often something of it was set."""

    def __init__(self, nodes, name, **properties):
        self.__dict__.update(properties, nodes=nodes, name=name, sent=0)
        nodes[name] = self

    def __setattr__(self, name, value):
        # As viser's, it sends what differs.
        self.__dict__["sent"] += not np.array_equal(self.__dict__[name], value)
        self.__dict__[name] = value

    def remove(self):
        # As viser's, with all nodes below it.
        if self.nodes.get(self.name) is self:
            for name in [name for name in self.nodes if f"{name}/".startswith(f"{self.name}/")]:
                del self.nodes[name]


class Scene:
    """The nodes by their names, and how many were made."""

    def __init__(self):
        self.nodes = {}
        self.made = 0

    def add_label(self, name, *_, **properties):
        self.made += 1
        return Node(self.nodes, name, **properties)

    add_batched_meshes_simple = add_line_segments = add_point_cloud = add_label


@pytest.fixture
def scene():
    return Scene()
