"""What shapes are like to touch: friction of pairs and in directions, and wheels on treads."""

import math

import pytest
from rovers import G, even_inertia
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import (
    Box,
    Collision,
    Link,
    Model,
    Plane,
    World,
)


def slowing(floor, *shapes, heading=0.0, towards=0.0, coulomb=False):
    """What friction takes, as a part of g, from a sled that slides in a direction (rad)."""
    ground = Link("l", collisions=(Collision(Plane(), friction=floor),))
    link = Link("l", inertia=even_inertia(2.0, 0.01), collisions=shapes)
    pose = Pose.from_rpy((0.0, 0.0, 0.1), (0.0, 0.0, heading))
    models = Model("floor", (ground,), static=True), Model("sled", (link,), pose=pose)
    with Simulation(World("w", models, gravity=(0.0, 0.0, -G), coulomb=coulomb)) as simulation:
        simulation.run_for(0.2)
        body = simulation.models["sled"].bodies["l"]
        along = math.cos(towards), math.sin(towards)
        body.set_velocity((2.0 * along[0], 2.0 * along[1], 0.0), (0.0, 0.0, 0.0))
        simulation.run_for(0.1)
        (vx, vy, _), _ = body.velocity()
        return (2.0 - (vx * along[0] + vy * along[1])) / (0.1 * G)


@cases("""
one, floor, smaller:
  - [0.1, 1.0, 0.1]
  - [0.4, 50.0, 0.4]
  - [1.0, 0.3, 0.3]
  - [0.0, 100.0, 0.0]
""")
def test_the_smaller_friction_counts(one, floor, smaller):
    shape = Collision(Box((0.3, 0.3, 0.2)), friction=one)
    assert slowing(floor, shape) == pytest.approx(smaller, abs=0.01)


@cases("""
heading, turned, towards, friction:
  - [0, 0, 0, 0.1]
  - [0, 0, 1, 0.6]
  - [1, 0, 1, 0.1]
  - [1, 0, 2, 0.6]
  - [0, 1, 1, 0.1]
  - [1, 1, 2, 0.1]
""")
def test_a_direction_of_friction_is_that_of_the_shape(heading, turned, towards, friction):
    """Turns are quarters; it turns with the shape in its link."""
    pose = Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, 0.5 * math.pi * turned))
    runner = Collision(
        Box((0.3, 0.3, 0.2)), pose, 0.1, cross_friction=0.6, direction=(1.0, 0.0, 0.0)
    )
    angles = {"heading": 0.5 * math.pi * heading, "towards": 0.5 * math.pi * towards}
    assert slowing(1.0, runner, **angles) == pytest.approx(friction, abs=0.01)


def test_friction_has_a_limit_along_each_axis_of_the_world_or_for_all_directions():
    shape = Collision(Box((0.3, 0.3, 0.2)), friction=0.5)
    oblique = 0.25 * math.pi
    assert slowing(1.0, shape, towards=oblique) == pytest.approx(0.5 * math.sqrt(2.0), abs=0.01)
    assert slowing(1.0, shape, towards=oblique, coulomb=True) == pytest.approx(0.5, abs=0.01)
