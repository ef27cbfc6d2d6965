import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from alike import assert_as_before, lines_of
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import (
    Box,
    Collision,
    FrameState,
    Inertia,
    Joint,
    Light,
    Link,
    Mesh,
    Model,
    ModelState,
    Plane,
    PluginTag,
    Sphere,
    Texture,
    Visual,
    World,
    footprints,
)

HERE = Pose()
PLAIN = (
    Texture(Path()),
    Visual(Plane()),
    Collision(Mesh(Path(), "")),
    Inertia(1.0, (0.0, 0.0, 0.0), np.eye(3)),
    Joint("joint", "fixed", "parent", "child"),
    PluginTag("file", "plugin", {}),
    Model("model", (Link("link"),)),
    Light("light", "spot", HERE),
    FrameState(HERE),
    ModelState(HERE),
    World("world"),
)


def test_what_is_not_said_is_as_before():
    assert_as_before(lines_of(PLAIN, "plain"), Path(__file__).with_name("plain.txt"))


def world_of(*collisions, pose=HERE, static=True):
    return World(
        "w", (Model("thing", (Link("link", collisions=collisions),), pose=pose, static=static),)
    )


def box(size=(2.0, 1.0, 0.5), pose=HERE):
    return Collision(Box(size), pose)


def test_a_box_is_where_model_and_shape_put_it():
    pose = Pose.from_rpy((1.0, 2.0, 0.0), (0.0, 0.0, 0.5))
    (found,) = footprints(world_of(box(pose=Pose((0.5, 0.0, 0.25))), pose=pose), 1.0)
    assert found.name == "thing"
    places = [pose.inverse() * Pose((*corner, 0.0)) for corner in found.corners()]
    wanted = [(1.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (1.5, -0.5)]
    assert np.array([place.position[:2] for place in places]) == pytest.approx(np.array(wanted))
    distances = {(0.5, 0.0): 0.0, (2.0, 0.0): 0.5, (0.8, -0.9): 0.4, (1.8, 0.9): 0.5}
    for point, distance in distances.items():
        x, y, _ = (pose * Pose((*point, 0.0))).position
        assert found.distance((x, y)) == pytest.approx(distance, abs=1e-12)


def test_a_picture_is_scaled_scrolled_and_turned():
    """About its middle, in OGRE's order, with the origin at the upper left."""
    texture = Texture(Path(), (2.0, 0.5), (0.1, 0.3), math.radians(30.0))
    found = texture.coordinates(np.array([[0.5, 0.5], [0.9, 0.4]]))
    wanted = np.array([[0.436603, 0.190192], [0.509808, -0.083013]])
    assert found == pytest.approx(wanted, abs=1e-5)


@cases("""
count, kind, z, lean, static, below, found:
  # How many boxes or balls at which height (m), leaning by how much (rad), whether they stand
  # still, below which height footprints are looked for, and how many there are.
  - [2, box, 0, 0, true, 1.0, 2]
  - [1, box, 2.0, 0, true, 1.75, 0]
  - [1, box, 2.0, 0, true, 1.8, 1]
  - [1, ball, 0, 0, true, 1.0, 0]
  - [1, box, 0, 0, false, 1.0, 0]
  - [1, box, 0, 0.1, true, 1.0, 0]
""")
def test_all_upright_boxes_of_what_stands_still_and_not_above(
    count, kind, z, lean, static, below, found
):
    shape = box(pose=Pose((0.0, 0.0, z))) if kind == "box" else Collision(Sphere(1.0))
    leaning = Pose.from_rpy((0.0, 0.0, 0.0), (lean, 0.0, 0.0))
    world = world_of(*[shape] * count, pose=leaning, static=static)
    twice = replace(world, models=2 * world.models)
    assert len(footprints(twice, below)) == 2 * found
