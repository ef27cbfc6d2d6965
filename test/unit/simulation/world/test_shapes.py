import doctest
import importlib
import math

import pytest

from bullet_lab.simulation.physics.physics import SHAPES as BODIES
from bullet_lab.simulation.world.sdf import read_spawned
from bullet_lab.simulation.world.shapes import SHAPES, Box, Cylinder, Mesh, Plane, Sphere

WITH_EXAMPLES = (
    "core.pose",
    "simulation.plugins.mobile_base",
    "simulation.plugins.wheel_drives",
    "simulation.world.tree",
    "simulation.world.shapes",
    "simulation.world.xml",
)
SOLIDS = [Box((0.4, 1.0, 2.0)), Cylinder(0.3, 1.2), Sphere(0.7)]


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_the_examples_of_docstrings(name):
    tested = doctest.testmod(importlib.import_module(f"bullet_lab.{name}"))
    assert tested.attempted > 0
    assert tested.failed == 0


def test_a_plane_has_no_end():
    assert Plane().bounds().tolist() == [[-math.inf] * 3, [math.inf] * 3]


@pytest.mark.parametrize("shape", SOLIDS + [Plane((0.0, 0.6, 0.8), (3.0, 4.0))])
def test_a_shape_is_read_as_it_measures(shape):
    measures = "".join(
        f"<{name}>{' '.join(map(repr, values))}</{name}>"
        for name, values in shape.measures().items()
    )
    geometry = f"<geometry><{shape.tag}>{measures}</{shape.tag}></geometry>"
    text = f"<sdf version='1.6'><model name='m'><link name='l'><collision name='c'>{geometry}"
    model = read_spawned(f"{text}</collision></link></model></sdf>", "here")
    assert model.links[0].collisions[0].geometry == shape


def test_all_that_makes_something_of_shapes_knows_each():
    pytest.importorskip("rospy")
    from bullet_lab.ros.messages.conversions import MARKERS

    assert set(MARKERS) == set(SHAPES.values())
    # A mesh is made by its corners.
    assert set(BODIES) == set(SHAPES.values()) - {Mesh}
