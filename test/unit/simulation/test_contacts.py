from dataclasses import replace

import numpy as np
import pytest
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.models import EntityError
from bullet_lab.simulation.world.description import Box, Collision, Inertia, Link, Model

SIDE = 0.2


def link(mass, name="link", pose=Pose()):  # noqa: B008
    inertia = Inertia(mass, (0.0, 0.0, 0.0), mass * SIDE**2 / 6.0 * np.eye(3))
    return Link(name, pose, inertia, (), (Collision(Box((SIDE, SIDE, SIDE))),))


def cube(name, position):
    return Model(name, (link(2.0),), pose=Pose(position))


def test_those_that_touch_are_named_both_ways_and_nothing_touches_itself(world):
    world.add(cube("lower", (1.0, 2.0, 0.5 * SIDE)))
    world.add(cube("upper", (1.05, 2.0, 1.5 * SIDE)))
    links = (link(1.0, "one", Pose((0, 0, 0.1))), link(1.0, "two", Pose((0, 0, 0.3))))
    world.add(Model("tower", links))
    world.run_for(0.5)
    assert world.contacts("lower") == {"ground_plane", "upper"}
    assert world.contacts("upper") == {"lower"}
    assert world.contacts("ground_plane") == {"lower", "tower"}
    assert world.contacts("tower") == {"ground_plane"}


def test_models_that_went_are_not_named(world):
    world.add(cube("cube", (0.0, 0.0, 0.5 * SIDE)))
    world.run_for(0.1)
    assert world.contacts("cube") == {"ground_plane"}
    world.remove("ground_plane")
    world.run_for(0.1)
    assert world.contacts("cube") == set()
    world.remove("cube")
    with pytest.raises(EntityError, match="cube"):
        world.contacts("cube")


def sprung(height, **spring):
    """A cube with a spring for its skin, above the floor."""
    model = cube("cube", (0.0, 0.0, 0.5 * SIDE + height))
    shape = replace(model.links[0].collisions[0], **spring)
    return replace(model, links=(replace(model.links[0], collisions=(shape,)),))


SPRINGS = {"hard": {}, "stiff": {"stiffness": 1e7, "damping": 1.0}, "soft": {"stiffness": 5e3}}


@cases("spring, depth: [[hard, 0.09], [stiff, 0.001], [soft, 0.09]]")
def test_what_is_put_into_the_floor_comes_out_and_stays(world, spring, depth):
    """As launch files do that leave z at 0, and as often as they do."""
    model = sprung(-depth, **SPRINGS[spring])
    thing = world.add(model)

    def highest():
        heights = []
        for _ in range(600):
            world.run_for(0.001)
            heights.append(thing.pose().position[2])
        return max(heights)

    # Its weight presses a soft one in by 1 to 4 mm; without this, it is thrown up by metres.
    near = pytest.approx(0.5 * SIDE, abs=0.01)
    assert highest() == near
    thing.move(model.pose, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert highest() == near
    world.reset_world()
    assert highest() == near


def test_what_falls_later_bounces_as_it_does(world):
    """Nothing is taken off what falls on a spring."""
    thing = world.add(sprung(0.05, stiffness=1e4, damping=0.0))
    world.run_for(0.3)
    assert abs(thing.bodies["link"].velocity()[0][2]) > 0.1


def test_what_carries_a_model_and_what_is_beside_it(world):
    world.add(Model("wall", (link(2.0, "brick"),), static=True, pose=Pose((0.1999, 0, 0.1))))
    world.add(cube("cube", (0.0, 0.0, 0.5 * SIDE)))
    world.run_for(0.05)
    touches = {(own, other, round(up)) for own, other, _, up in world.touches("cube")}
    assert touches == {("link", "ground_plane", 1), ("link", "wall", 0)}
    assert ("wall", "brick") in {touch[1:3] for touch in world.touches("cube")}
