import numpy as np
import pytest
from sensor_worlds import box
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.physics.rays import Fan
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Collision, Link, Model
from bullet_lab.simulation.world.shapes import Box, Cylinder, Mesh, Plane, Sphere

FARTHEST = 8.0


def some_pose(random, spread):
    quaternion = random.normal(size=4)
    quaternion /= np.linalg.norm(quaternion)
    return Pose(tuple(random.uniform(-spread, spread, 3)), tuple(quaternion))


def some_shape(random):
    x, y, z = random.uniform(0.1, 3.0, 3)
    plane = Plane(tuple(random.normal(size=3)))
    kinds = Box((x, y, z)), Cylinder(0.5 * x, y), Sphere(0.5 * x), plane
    return kinds[random.choice(4, p=(0.4, 0.3, 0.25, 0.05))]


def some_ways(random, number):
    ways = random.normal(size=(number, 3))
    return ways / np.linalg.norm(ways, axis=1)[:, None]


def inside(shape, frame, point):
    """Return whether a point of the world is within a shape; for a plane, below it."""
    return max(shape._gaps((frame * Pose(tuple(point))).position)) < 0.0


@cases("nearest: [0.0, 0.5]")
@pytest.mark.parametrize("seed", range(8))
def test_a_ray_ends_at_the_first_surface_that_it_meets(seed, nearest):
    random = np.random.default_rng(seed)
    origin, ways = random.uniform(-3.0, 3.0, 3), some_ways(random, 60)
    with Simulation() as world:
        things = {}
        for number in range(10):
            shape, place = some_shape(random), some_pose(random, 0.3)
            link = Link("link", collisions=(Collision(shape, place, name="c"),))
            model = Model(f"m{number}", (link,), static=True, pose=some_pose(random, 3.0))
            (body,) = world.add(model).bodies.values()
            things[body.unique_id] = shape, (model.pose * place).inverse()
        ((distances, bodies),) = world.rays.cast([Fan(origin, ways.T, nearest, FARTHEST)])
    assert np.isfinite(distances).sum() >= 3
    for way, distance, body in zip(ways, distances, bodies):
        assert np.isinf(distance) == (body == -1)
        if body >= 0:
            shape, frame = things[body]
            place = frame * Pose(tuple(origin + distance * way))
            assert shape.distance(place.position) == pytest.approx(0.0, abs=1e-9)
            assert nearest < distance <= FARTHEST
        start = origin + nearest * way
        around = [one for one in things.values() if inside(*one, start)]
        way_before = np.linspace(nearest, min(distance, FARTHEST), 100)[:-1]
        for shape, frame in things.values():
            if (shape, frame) in around and not isinstance(shape, Plane):
                continue
            was = inside(shape, frame, start)
            assert all(inside(shape, frame, origin + t * way) == was for t in way_before)


# Bullet is asked of few rays.
@cases("repeat: [1, 10]")
def test_what_is_nearer_is_seen_of_a_mesh_and_a_box(tmp_path, repeat):
    path = tmp_path / "roof.obj"
    # A roof along y, its ridge 1 m above its eaves, over x from -1 to 1.
    corners = "".join(f"v {x} {y} {z}\n" for y in (-2, 2) for x, z in ((-1, 0), (0, 1), (1, 0)))
    path.write_text(corners + "f 1 2 5\nf 1 5 4\nf 2 3 6\nf 2 6 5\n")
    ways = np.repeat([(1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)], repeat, axis=0)
    roof = Link("roof", collisions=(Collision(Mesh(path, str(path)), name="c"),))
    with Simulation() as world:
        world.add(Model("roof", (roof,), static=True, pose=Pose((3.0, 0.0, 0.0))))

        def seen():
            fan = Fan(np.array((0.0, 0.0, 0.5)), ways.T, 0.0, FARTHEST)
            ((distances, bodies),) = world.rays.cast([fan])
            names = [world._bodies[body].model if body >= 0 else "" for body in bodies]
            return names[::repeat], distances[::repeat].tolist()

        assert seen() == (["roof", "", ""], pytest.approx([2.5, np.inf, np.inf], abs=2e-3))
        world.add(box("0.2 1 2", "2 0 0 0 0 0", "wall"))
        assert seen() == (["wall", "", ""], pytest.approx([1.9, np.inf, np.inf]))
        world.models["wall"].place(Pose((4.0, 0.0, 0.0)))
        world.run_for(0.001)
        assert seen()[0] == ["roof", "", ""]
        world.remove("roof")
        assert seen() == (["wall", "", ""], pytest.approx([3.9, np.inf, np.inf]))
        world.remove("wall")
        assert seen()[0] == ["", "", ""]


def test_rays_hit_the_same_alone_and_beside_others():
    random = np.random.default_rng(2)
    with Simulation() as world:
        for number in range(5):
            link = Link("link", collisions=(Collision(some_shape(random), name="c"),))
            world.add(Model(f"m{number}", (link,), static=True, pose=some_pose(random, 2.0)))
        fans = [
            Fan(random.uniform(-1.0, 1.0, 3), some_ways(random, number).T, 0.1, FARTHEST)
            for number in (50, 12, 80)
        ]
        together, alone = world.rays.cast(fans), [world.rays.cast([fan])[0] for fan in fans]
    for one, other in zip(together, alone):
        assert np.array_equal(one, other)
        assert np.isfinite(one[0]).any()


def test_a_wide_wall_is_seen_from_close_by():
    angles = np.radians(np.linspace(-89.0, 89.0, 60))
    ways = np.stack((np.cos(angles), np.sin(angles), np.zeros(60)), axis=1)
    with Simulation() as world:
        world.add(box("0.2 100 100", "0.2 20 0 0 0 0", "wall"))
        ((distances, _),) = world.rays.cast([Fan(np.zeros(3), ways.T, 0.0, FARTHEST)])
    assert distances == pytest.approx(0.1 / np.cos(angles))
