"""Which wheels skid, which directions turn with them, and all surfaces are as before.

A change that means to find others renews the text: see `assert_as_before`.
"""

import math
from pathlib import Path

import numpy as np
from alike import assert_as_before, lines_of

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.physics.surfaces import (
    ContactSurface,
    axle_of,
    directed_wheels,
    heavy_enough,
    is_wheel,
    load_of,
    on_treads,
    skidding_wheels,
)
from bullet_lab.simulation.physics.traction import (
    limit_directed,
    limit_friction,
    wheel_mobility,
)
from bullet_lab.simulation.world.sdf import read_world_file

HERE = Path(__file__).parent


def surfaces_of(model):
    """Yield what is found out about a model, as lines."""
    links, joints = model.links, model.joints
    skidding = skidding_wheels(links, joints)
    names = {wheel.link for wheel in skidding}
    yield from lines_of((*skidding, *directed_wheels(links, joints)), model.name)
    axles = {joint.child: axle_of(joint) for joint in joints}
    load = load_of(links)
    if skidding:
        yield from lines_of(wheel_mobility(links, joints, skidding), model.name)
    for link in heavy_enough(links, skidding) if skidding else links:
        name, axle = f"{model.name}.{link.name}", axles.get(link.name)
        yield from lines_of(link.inertia and link.inertia.matrix, name)
        rolls = is_wheel(link.collisions, axle) and link.name not in names
        for shape in on_treads(link.collisions, axle, link.name in names):
            surface = ContactSurface.of(shape, axle, load, rolls)
            yield from lines_of((shape.geometry, shape.pose), name)
            yield from lines_of(surface.properties(Pose(), model.static), name)


def limits_of(seed):
    """Yield the friction on a wheel that wants some, as lines."""
    chance = np.random.default_rng(seed)
    pairs = [tuple(pair) for pair in chance.uniform((-3.0, -3.0), (3.0, 3.0), (3, 2)).tolist()]
    positive = [tuple(map(abs, pair)) for pair in pairs]
    turn = chance.uniform(-3.0, 3.0)
    angle = math.cos(turn), math.sin(turn)
    yield from lines_of(limit_friction(pairs[0], *positive[1:]), "limited")
    yield from lines_of(limit_directed(*pairs[:1], positive[1], 2.0, *angle), "directed")


def test_surfaces_are_as_before():
    models = read_world_file(HERE / "wheels.world").models
    told = [line for model in models for line in surfaces_of(model)]
    told += [line for seed in range(40) for line in limits_of(seed)]
    assert_as_before(told, HERE / "wheels.txt")
