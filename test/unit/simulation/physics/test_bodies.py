"""What the engine holds is what the description says: masses, frames, joints and every shape."""

import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from alike import assert_alike, assert_as_before, lines_of
from contact_forces import pressures
from heap import bytes_kept
from rovers import even_inertia, wheels
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.physics import PhysicsError, pybullet
from bullet_lab.simulation.physics.physics import MOST_LINKS
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world import shapes
from bullet_lab.simulation.world.description import (
    Box,
    Collision,
    Cylinder,
    Inertia,
    Joint,
    Link,
    Mesh,
    Model,
    Plane,
    Sphere,
    World,
)
from bullet_lab.simulation.world.meshes import MeshError
from bullet_lab.simulation.world.sdf import read_world_file
from bullet_lab.simulation.world.tree import principal_axes

HERE = Path(__file__).parent
UNIT = Inertia(2.0, (0.1, 0.2, 0.3), np.diag([0.1, 0.15, 0.2]))
G = 9.8
PYBULLET_KINDS = {
    "fixed": pybullet.JOINT_FIXED,
    "revolute": pybullet.JOINT_REVOLUTE,
    "continuous": pybullet.JOINT_REVOLUTE,
    "prismatic": pybullet.JOINT_PRISMATIC,
}

KINDS = tuple(PYBULLET_KINDS)


@pytest.fixture
def hall():
    floor = lump((Collision(Plane(), name="ground"),), name="floor", static=True)
    with Simulation(World("hall", (floor,), gravity=(0.0, 0.0, -G))) as simulation:
        yield simulation


# With sides of 1 m, about the origin.
CUBE = """v -.5 -.5 -.5\nv .5 -.5 -.5\nv -.5 .5 -.5\nv .5 .5 -.5
v -.5 -.5 .5\nv .5 -.5 .5\nv -.5 .5 .5\nv .5 .5 .5
f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6
"""
# Two square frames with holes, one 1 m above the other.
FRAME = """v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nv -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1
v -.5 -.5 0\nv .5 -.5 0\nv .5 .5 0\nv -.5 .5 0\nv -.5 -.5 1\nv .5 -.5 1\nv .5 .5 1\nv -.5 .5 1
f 1 2 10 9\nf 2 3 11 10\nf 3 4 12 11\nf 4 1 9 12
f 5 6 14 13\nf 6 7 15 14\nf 7 8 16 15\nf 8 5 13 16
"""


@pytest.fixture
def cube(tmp_path):
    (tmp_path / "cube.obj").write_text(CUBE)
    return Mesh(tmp_path / "cube.obj", "cube.obj")


@pytest.fixture
def frame(tmp_path):
    (tmp_path / "frame.obj").write_text(FRAME)
    return Mesh(tmp_path / "frame.obj", "frame.obj")


def lump(shapes, inertia=UNIT, name="thing", **parts):
    """A model of one link."""
    return Model(name, (Link("l", inertia=inertia, collisions=shapes),), **parts)


def thing(*geometries, **parts):
    """The same of shapes above each other."""
    shapes = (Collision(g, Pose((0.0, 0.0, 3.0 * i))) for i, g in enumerate(geometries))
    return lump(tuple(shapes), **parts)


def hits(space, x, y):
    """The height at which a ray from above meets something, None if it does not."""
    first = pybullet.rayTest((x, y, 50.0), (x, y, -50.0), physicsClientId=space.client)[0]
    return None if first[0] < 0 else first[3][2]


# Random trees


def some_pose(chance, reach):
    """A pose; in a third of all cases it looks straight down."""
    position = tuple(chance.uniform(-reach, reach) for _ in range(3))
    roll, pitch, yaw = (chance.uniform(-1.5, 1.5) for _ in range(3))
    return Pose.from_rpy(position, (roll, chance.choice((pitch, pitch, 0.5 * np.pi)), yaw))


def some_inertia(chance):
    turn = some_pose(chance, 0.3)
    x, y, z = (chance.uniform(0.1, 1.0) for _ in range(3))
    matrix = turn.rotation_matrix() @ np.diag([y + z, x + z, x + y]) @ turn.rotation_matrix().T
    return Inertia(chance.uniform(0.5, 5.0), turn.position, 0.5 * (matrix + matrix.T))


def some_axis(chance):
    axis = np.array([chance.gauss(0.0, 1.0) for _ in range(3)])
    return tuple((axis / np.linalg.norm(axis)).tolist())


def some_shapes(chance, count, cube):
    """Shapes in a row, each 2 m from the next and 0.4 to 1 m high along its own z axis."""
    shapes = []
    for number in range(count):
        size = chance.uniform(0.4, 1.0)
        geometry = chance.choice(
            (
                Box((0.5, 0.6, size)),
                Cylinder(0.3, size),
                Sphere(0.5 * size),
                replace(cube, scale=(size, size, size)),
            )
        )
        turn = some_pose(chance, 0.1)
        pose = Pose((2.0 * number + 2.0, *turn.position[1:]), turn.quaternion)
        shapes.append(Collision(geometry, pose, name=f"shape{number}"))
    return tuple(shapes)


def helpers(shapes):
    meshes = sum(isinstance(shape.geometry, Mesh) for shape in shapes)
    return max(0, -(-(len(shapes) - meshes) // 16) + meshes - 1)


def some_tree(chance, cube, count=0):
    """A tree of up to 60 links with up to 40 shapes each, as far as the engine's links allow."""
    count = count or chance.choice((1, 2, 7, 20, 60))
    spare = MOST_LINKS - (count - 1)
    links, joints = [], []
    for number in range(count):
        shapes = some_shapes(chance, chance.choice((0, 1, 2, 16, 17, 40)), cube)
        if helpers(shapes) > spare:
            shapes = shapes[:1]
        spare -= helpers(shapes)
        name = f"l{number}"
        links.append(Link(name, Pose(), some_inertia(chance), (), shapes))
        if number:
            joints.append(
                Joint(
                    f"j{number}",
                    chance.choice(KINDS),
                    chance.choice(links[:-1]).name,
                    name,
                    # Far from each other, so that the shapes of one do not hide in another's.
                    some_pose(chance, 300.0),
                    some_axis(chance),
                )
            )
    chance.shuffle(joints)
    return Model("tree", tuple(links), tuple(joints), pose=some_pose(chance, 5.0))


def joint_motion(joint, position):
    if joint.kind == "fixed":
        return Pose()
    if joint.kind == "prismatic":
        return Pose(tuple(position * a for a in joint.axis))
    half = 0.5 * position
    return Pose(quaternion=(*(np.sin(half) * a for a in joint.axis), np.cos(half)))


def placed(model, positions):
    """The poses of a tree's links in the world, from the description alone."""
    above = {joint.child: joint for joint in model.joints}

    def pose(name):
        if name not in above:
            return model.pose
        joint = above[name]
        motion = joint_motion(joint, positions.get(joint.name, 0.0))
        return pose(joint.parent) * joint.pose * motion

    return {link.name: pose(link.name) for link in model.links}


@pytest.mark.parametrize("seed", range(6))
def test_random_trees_are_held_as_they_are_described(space, cube, seed):
    chance = random.Random(seed)
    model = some_tree(chance, cube)
    instance = space.add(model)
    (body,) = instance.bodies.values()
    above = {joint.child: joint for joint in model.joints}
    indices = [body.link_index(link.name) for link in model.links]
    assert sorted(indices) == list(range(-1, len(model.links) - 1))
    for index, link in zip(indices, model.links):
        info = pybullet.getDynamicsInfo(body.unique_id, index, space.client)
        moments, centre = principal_axes(link.inertia)
        assert info[0] == pytest.approx(link.inertia.mass, rel=1e-9)
        assert info[2] == pytest.approx(moments, rel=1e-9)
        assert_alike(Pose(*info[3:5]), centre, within=1e-9)
        if index >= 0:
            joint = above[link.name]
            info = pybullet.getJointInfo(body.unique_id, index, space.client)
            assert info[2] == PYBULLET_KINDS[joint.kind]
            assert info[16] == body.link_index(joint.parent)
    movable = {joint.name for joint in model.joints if joint.kind != "fixed"}
    assert set(body.joint_names) == movable
    positions = {name: chance.uniform(-1.0, 1.0) for name in movable}
    instance.configure(positions)
    for name, pose in placed(model, positions).items():
        assert_alike(instance.frame(name).pose(), pose, within=1e-9)


def half_height(geometry):
    if isinstance(geometry, Sphere):
        return geometry.radius
    if isinstance(geometry, Cylinder):
        return 0.5 * geometry.length
    return 0.5 * (geometry.size[2] if isinstance(geometry, Box) else geometry.scale[2])


@cases("seed, static: [[0, true], [1, false], [2, true], [3, false]]")
def test_every_shape_of_random_trees_acts_and_is_named(space, cube, seed, static):
    model = replace(some_tree(random.Random(seed), cube), static=static)
    instance = space.add(model)
    (body,) = instance.bodies.values()
    space.run_for(0.001)
    frames = placed(model, {})
    for link in model.links:
        for shape in link.collisions:
            middle = frames[link.name] * shape.pose
            height = half_height(shape.geometry)
            start, end = ((middle * Pose((0.0, 0.0, z))).position for z in (height + 0.2, 0.0))
            ((unique_id, index, _, place, _),) = pybullet.rayTest(
                start, end, physicsClientId=space.client
            )
            assert unique_id == body.unique_id, (link.name, shape)
            assert shape in body.link_at(index).shapes
            assert space.shape_name(unique_id, index, place) == f"tree::{link.name}::{shape.name}"
            surface = (middle * Pose((0.0, 0.0, height))).position
            assert place == pytest.approx(surface, abs=1e-3)


# Joints, shown by their motion


def jointed(kind="revolute", child=UNIT, **properties):
    """A link on a joint along z, whose inertia is 0.2 kg m² and 2 kg, on a heavy one."""
    part = Link("part", inertia=replace(child, centre=(0, 0, 0.1)))
    links = (Link("base", inertia=even_inertia(1e9, 1e9)), part)
    joint = Joint("j", kind, "base", "part", Pose((0.0, 0.0, 2.0)), (0.0, 0.0, 1.0), **properties)
    return Model("machine", links, (joint,))


def body_of(space, model):
    (body,) = space.add(model).bodies.values()
    return body


def push(space, body, effort, seconds):
    for _ in range(round(seconds * 1000)):
        body.exert("j", effort)
        space.run_for(0.001)
    return body.joint_state("j")


@cases("kind: [revolute, prismatic]")
def test_joints_with_friction_limits_and_motors_move_as_before(space, kind):
    told = []
    for name, case in yaml.safe_load((HERE / "motions.yaml").read_text()).items():
        body = body_of(space, jointed(kind, **case["joint"]))
        for verb, position, most, effort, seconds in case["steps"]:
            if verb:
                getattr(body, verb)("j", position, most)
            state = push(space, body, effort, seconds)
            told += lines_of([state.position, state.velocity], name)
        space.remove("machine")
    assert_as_before(told, HERE / f"motions.{kind}.txt")


@pytest.mark.parametrize("seed", range(10))
def test_a_random_joint_moves_as_it_is_described(space, seed):
    """Effort, inertia about an axis anywhere, damping, friction and limit of effort in one."""
    chance = random.Random(seed)
    kind, axis, child = chance.choice(KINDS[1:]), some_axis(chance), some_inertia(chance)
    inertia = child.mass
    if kind != "prismatic":
        x, centre = np.array(axis), np.array(child.centre)
        arm = centre @ centre - (x @ centre) ** 2
        inertia = float(x @ child.matrix @ x) + child.mass * arm
    most, damping, friction = chance.uniform(2, 3), chance.uniform(0, 1), chance.uniform(0, 1)
    model = jointed(kind)
    joint = replace(model.joints[0], axis=axis, pose=some_pose(chance, 2.0), damping=damping,
                    friction=friction, limits={"effort": most})  # fmt: skip
    links = (model.links[0], replace(model.links[1], inertia=child))
    effort, velocity, position = chance.uniform(2.0, 4.0), 0.0, 0.0
    body, sign = body_of(space, replace(model, links=links, joints=(joint,))), (-1.0) ** seed
    found = push(space, body, sign * effort, 0.2)
    for _ in range(200):
        velocity += 0.001 / inertia * (min(effort, most) - damping * velocity - friction)
        position += 0.001 * velocity
    assert found.velocity == pytest.approx(sign * velocity, rel=1e-6)
    assert found.position == pytest.approx(sign * position, rel=1e-6)


@cases("kind: [revolute, prismatic]")
def test_a_damper_of_any_strength_between_light_links_does_not_swing_up(space, kind):
    """The joint turns about the thin axis of the rod that carries it."""
    rod, ball = (Inertia(1.0, (0, 0, 0), np.diag(d)) for d in ((0.1, 0.1, 1e-3), (0.2, 0.2, 0.2)))
    turned = Pose.from_rpy((0.0, 0.0, 0.1), (0.0, -0.5 * np.pi, 0.0))
    joint = Joint("j", kind, "rod", "ball", turned, (1.0, 0.0, 0.0), damping=1e6)
    model = Model("m", (Link("rod", inertia=rod), Link("ball", inertia=ball)), (joint,))
    body = body_of(space, model)
    body.set_joint("j", 0.0, 2.0)
    space.run_for(0.05)
    assert abs(body.joint_state("j").velocity) < 1e-6


# Any number of shapes


def row(count, cube, every=0):
    """Boxes in a row along x, 2 m apart; each `every`th is a mesh."""
    meshes = [every and number % every == 0 for number in range(count)]
    return tuple(
        Collision(cube if mesh else Box((1.0, 1.0, 1.0)), Pose((2.0 * n, 0.0, 0.0)), name=f"c{n}")
        for n, mesh in enumerate(meshes)
    )


def test_what_never_moves_does_not_touch_what_never_moves(hall, cube):
    hall.add(lump(row(40, cube, 2), name="bench", static=True))
    hall.run_for(0.01)
    assert pybullet.getContactPoints(physicsClientId=hall.client) == ()


def feet(shape, **properties):
    """Sixteen small boxes high up, and one last shape below them that a body stands on."""
    small = tuple(
        Collision(Box((0.01, 0.01, 0.01)), Pose((0.0, 0.05 * n - 0.4, 0.3))) for n in range(16)
    )
    return (*small, Collision(shape, name="foot", **properties))


WIDE = even_inertia(2.0, 0.2)


@cases("""
meshed, friction, others:
  - [false, 0.2, 1.0]
  - [true, 0.5, 0.05]
  - [true, 0.2, 0.2]
""")
def test_a_helper_stands_and_slides_as_its_shape_alone(hall, cube, meshed, friction, others):
    """A body that stands on the seventeenth of its shapes, on a floor with friction 1.

    The friction of that shape counts, not that of the others of its link.
    """
    foot = replace(cube, scale=(1.0, 1.0, 0.2)) if meshed else Box((1.0, 1.0, 0.2))
    *above, last = feet(foot, friction=friction)
    shapes = (*(replace(shape, friction=others) for shape in above), last)
    body = body_of(hall, lump(shapes, WIDE, pose=Pose((0.0, 0.0, 0.1))))
    hall.run_for(0.5)
    assert pressures(hall, "thing")["floor"] == pytest.approx(2 * G, rel=0.02)
    (touching,) = {point[3] for point in body.near_points()}
    assert body.link_at(touching).shapes == (last,)
    # Bullet's skin of 1 mm around meshes is nearly taken off.
    assert body.pose().position[2] == pytest.approx(0.1, abs=1.5e-4)
    body.set_velocity((2.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    hall.run_for(0.2)
    assert body.velocity()[0][0] == pytest.approx(2.0 - friction * G * 0.2, abs=0.02)
    body.remove_sliding_friction()
    # What touches already keeps its friction for a while.
    hall.run_for(0.2)
    body.set_velocity((1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    hall.run_for(0.2)
    assert body.velocity()[0][0] == pytest.approx(1.0, abs=1e-6)


def test_a_helper_is_as_soft_as_its_link(hall):
    shapes = feet(Sphere(0.2), stiffness=4000.0, damping=100.0)
    instance = hall.add(lump(shapes, WIDE, pose=Pose((0.0, 0.0, 0.2))))
    hall.run_for(1.0)
    sag = 0.2 - instance.pose().position[2]
    assert sag == pytest.approx(2.0 * G / 4000.0, rel=0.05)


# The engine's limits


def test_more_links_than_the_engine_holds_are_refused_by_name(hall, cube):
    shapes = row(MOST_LINKS + 2, cube, 1)
    hall.add(lump(shapes[:-1], name="good", pose=Pose((0, 9, 0.5))))
    with pytest.raises(PhysicsError, match="^model 'centipede': .* 128 links .* allows 127$"):
        hall.add(lump(shapes, name="centipede"))
    assert list(hall.models) == ["floor", "good"]
    assert pybullet.getNumBodies(hall.client) == 2


# Links of one body


def spinner(shapes, touchy=()):
    """Links with these shapes in one place, each on a joint to the one before it."""
    links = tuple(
        Link(f"l{n}", Pose(), even_inertia(1.0, 0.1), (), own, n in touchy)
        for n, own in enumerate(shapes)
    )
    joints = tuple(
        Joint(f"j{n}", "prismatic", f"l{n - 1}", f"l{n}", axis=(1.0, 0.0, 0.0))
        for n in range(1, len(links))
    )
    return Model("spinner", links, joints)


def overlapping(count, at=0.0):
    return tuple(Collision(Box((0.2, 0.2, 0.2)), Pose((at, 0.0, 0.0))) for _ in range(count))


def positions(space, model):
    (body,) = space.add(model).bodies.values()
    space.run_for(0.1)
    return [body.joint_state(name).position for name in body.joint_names]


def test_helpers_touch_neither_each_other_nor_their_link_nor_its_neighbours(space):
    shapes = [overlapping(40), overlapping(40)]
    model = spinner(shapes, touchy=(0, 1))
    assert positions(space, model) == [0.0]
    assert space.models["spinner"].pose().position == (0.0, 0.0, 0.0)
    assert pybullet.getContactPoints(physicsClientId=space.client) == ()


def test_helpers_touch_other_links_of_their_body_that_want_it(space):
    far = overlapping(16, at=50.0)
    shapes = [(*far, *overlapping(1)), (), (*far, *overlapping(1, at=0.19))]
    model = spinner(shapes, touchy=(2,))
    apart = positions(space, model)
    assert apart[0] + apart[1] > 1e-3
    # It is not enough that a third link wants it.
    for touchy in ((), (1,)):
        space.remove("spinner")
        assert positions(space, spinner(shapes, touchy)) == [0.0, 0.0]


def test_what_touched_is_not_remembered_of_another_body(space):
    shapes = [overlapping(1), (), overlapping(1, at=0.19), overlapping(1, at=40.0)]
    first = space.add(spinner(shapes, touchy=(3,))).bodies["l0"].unique_id
    space.run_for(0.01)
    space.remove("spinner")
    apart = positions(space, spinner(shapes, touchy=(0,)))
    assert space.models["spinner"].bodies["l0"].unique_id == first
    assert apart[0] + apart[1] > 1e-3


# Shapes are made once


def test_beacons_one_after_another_leave_little_memory_behind(package):
    beacons = read_world_file(package / "worlds" / "beacons.world").models
    beacon = next(model for model in beacons if model.name == "beacon_0")

    def come_and_go():
        space.add(beacon)
        space.remove("beacon_0")

    with Simulation(World("space")) as space:
        # PyBullet keeps 0.9 kB of a body; with its shapes made anew each time, 170 kB.
        assert bytes_kept(come_and_go, 300) < 2000.0


def test_what_was_static_and_is_away_is_nowhere(hall):
    hall.add(thing(Box((2.0, 2.0, 2.0)), static=True))
    ball = hall.add(thing(Sphere(0.1), name="ball"), pose=Pose((0.0, 0.0, 1.09)))
    hall.run_for(0.1)
    assert hall.contacts("ball") == {"thing"}
    hall.remove("thing")
    assert hall.contacts("ball") == set()
    assert hits(hall, 0.5, 0.5) == pytest.approx(0.0)
    hall.run_for(1.0)
    assert ball.pose().position[2] == pytest.approx(0.1, abs=1e-3)


def test_what_was_soft_comes_back_for_no_hard_one(hall):
    shape, cube, sunk = Collision(Box((2.0, 2.0, 0.2))), Collision(Box((0.2, 0.2, 0.2))), []
    even = Inertia(2.0, (0.0, 0.0, 0.0), 0.01 * np.eye(3))
    for one in (replace(shape, stiffness=1e4, damping=1e2), shape):
        hall.add(lump((one,), name="plate", static=True))
        block = hall.add(lump((cube,), even, "block"), pose=Pose((0.0, 0.0, 0.2)))
        hall.run_for(0.5)
        sunk.append(0.2 - block.pose().position[2])
        hall.remove("plate")
        hall.remove("block")
    assert sunk[0] > 4e-4
    assert sunk[1] < 1e-4


@pytest.mark.parametrize("most", [shapes.MOST_CORNERS, 8])
def test_what_is_static_keeps_its_hollows_and_what_moves_is_convex(space, frame, monkeypatch, most):
    """Also of a mesh of more corners than the engine takes at once."""
    monkeypatch.setattr(shapes, "MOST_CORNERS", most)
    space.add(thing(Plane(), frame, static=True))
    assert hits(space, 0.0, 0.0) == pytest.approx(0.0)
    assert hits(space, 0.75, 0.0) == pytest.approx(4.0)
    space.remove("thing")
    space.add(thing(frame))
    assert hits(space, 0.0, 0.0) == pytest.approx(1.0, abs=2e-4)


def test_a_cylinder_is_round(space):
    space.add(thing(Cylinder(0.5, 1.0)))
    for angle in np.linspace(0.0, 2.0 * np.pi, 100):
        x, y = 0.4995 * np.cos(angle), 0.4995 * np.sin(angle)
        assert hits(space, x, y) == pytest.approx(0.5)


def test_a_mesh_file_that_has_changed_is_read_again(space, cube):
    space.add(thing(cube, static=True))
    space.remove("thing")
    cube.path.write_text("v 0 0 x\n")
    with pytest.raises(MeshError):
        cube.bounds()
    cube.path.write_text("v 0 0 7\nv 1 0 7\nv 0 1 7\nf 1 2 3\n")
    assert cube.bounds().tolist() == [[0, 0, 7], [1, 1, 7]]
    space.add(thing(cube, static=True))
    assert hits(space, 0.2, 0.2) == pytest.approx(7.0)


def test_nothing_is_printed(space, frame, capfd):
    space.add(thing(frame, Box((1.0, 1.0, 1.0)), static=True))
    space.add(jointed())
    with pytest.raises(PhysicsError):
        space.add(thing(Sphere(0.0), name="flat"))
    space.run_for(0.01)
    assert capfd.readouterr() == ("", "")


def test_a_cart_on_ball_joints_rolls_every_way(hall):
    """Three balls with friction below a plate: they roll, where held ones would brake."""
    places = [(0.1, 0.0, 0.03), (-0.1, 0.1, 0.03), (-0.1, -0.1, 0.03)]
    links, joints = wheels(
        *places, shape=Collision(Sphere(0.03), friction=0.8), kind="ball", parent="plate"
    )
    balls = [replace(link, inertia=even_inertia(0.05, 2e-5)) for link in links]
    plate = Link("plate", Pose(), replace(UNIT, centre=(0.0, 0.0, 0.06)))
    cart = hall.add(Model("cart", (plate, *balls), tuple(joints)))
    body = cart.bodies["plate"]
    assert body.joint_names == ()
    velocity = (-0.3, 0.3, 0.0)
    hall.run_for(0.2)
    cart.move(Pose(), velocity, (0.0, 0.0, 0.0))
    hall.run_for(0.5)
    # Speeding the balls up takes a part: 3 · 2e-5 / 0.03² of 2.15 kg.
    assert body.velocity()[0] == pytest.approx(0.97 * np.array(velocity), abs=0.03)
    cart.place(Pose())
    hall.run_for(0.2)
    assert np.abs(body.velocity()[0]).max() < 1e-3
    state = cart.state()
    assert state.joints == {}
    cart.restore(state)
