import math
from dataclasses import replace

import pytest

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import (
    Box,
    Collision,
    Link,
    Model,
    Sphere,
    World,
    footprints,
)

HERE = Pose()


def world_of(*collisions, pose=HERE, static=True):
    return World(
        "w", (Model("thing", (Link("link", collisions=collisions),), pose=pose, static=static),)
    )


def box(size=(2.0, 1.0, 0.5), pose=HERE):
    return Collision(Box(size), pose)


def test_a_box_is_where_model_and_shape_put_it():
    pose = Pose.from_rpy((1.0, 2.0, 0.0), (0.0, 0.0, math.pi / 2))
    (found,) = footprints(world_of(box(pose=Pose((0.5, 0.0, 0.25))), pose=pose))
    assert found.name == "thing"
    assert found.centre == pytest.approx((1.0, 2.5))
    corners = sorted((round(x, 9), round(y, 9)) for x, y in found.corners())
    assert corners == [(0.5, 1.5), (0.5, 3.5), (1.5, 1.5), (1.5, 3.5)]


@pytest.mark.parametrize(
    ("point", "distance"),
    [
        ((0.0, 0.0), 0.0),
        ((1.5, 0.0), 0.5),
        ((0.3, -0.9), 0.4),
        ((1.3, 0.9), 0.5),
    ],
)
def test_distance_to_a_turned_and_moved_box(point, distance):
    pose = Pose.from_rpy((3.0, -1.0, 0.0), (0.0, 0.0, 0.7))
    (found,) = footprints(world_of(box(), pose=pose))
    x, y, _ = (pose * Pose((*point, 0.0))).position
    assert found.distance((x, y)) == pytest.approx(distance, abs=1e-12)


LEANING = Pose.from_rpy((0.0, 0.0, 0.0), (0.1, 0.0, 0.0))


@pytest.mark.parametrize(
    ("world", "below", "count"),
    [
        (world_of(box(), box()), 1.0, 2),
        (world_of(box(pose=Pose((0.0, 0.0, 2.0)))), 1.75, 0),
        (world_of(box(pose=Pose((0.0, 0.0, 2.0)))), 1.8, 1),
        (world_of(Collision(Sphere(1.0))), 1.0, 0),
        (world_of(box(), static=False), 1.0, 0),
        (world_of(box(), pose=LEANING), 1.0, 0),
    ],
)
def test_all_upright_boxes_of_what_stands_still_and_not_above(world, below, count):
    twice = replace(world, models=2 * world.models)
    assert len(footprints(twice, below=below)) == 2 * count
