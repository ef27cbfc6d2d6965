import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import complains
from sensor_worlds import box, record, thing

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.physics.attached_frame import nearest_shape
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Box, Collision, Cylinder, Plane, Sphere
from bullet_lab.simulation.world.urdf import read_urdf

FLOOR = "package://bullet_lab/worlds/empty.world"
MASS, G = 2.0, 9.8


def bumper(collisions=(), tags="", rate=100, link="base", extra="", name="crate"):
    """A crate of 0.2 m with a small nose on a merged link, ahead."""
    watched = "".join(f"<collision>{name}</collision>" for name in collisions)
    return read_urdf(
        f'<robot name="{name}"><link name="base"><inertial><mass value="{MASS}"/>'
        '<inertia ixx="0.0133" iyy="0.0133" izz="0.0133"/></inertial>'
        '<collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>'
        '<link name="nose"><collision><geometry><sphere radius="0.02"/></geometry></collision>'
        '</link><joint name="j" type="fixed"><parent link="base"/><child link="nose"/>'
        f'<origin xyz="0.12 0 0"/></joint>{extra}'
        f'<gazebo reference="{link}"><sensor type="contact" name="bumper">'
        f"<update_rate>{rate}</update_rate><contact>{watched}</contact>"
        f'<plugin name="bumper" filename="libgazebo_ros_bumper.so">{tags}</plugin>'
        "</sensor></gazebo></robot>",
        "crate",
    )


def run(model, seconds=0.5, things=(), pose=None, topic="bumper_states", world=FLOOR, **options):
    pose = pose or Pose((0, 0, 0.1))
    with Simulation.of(world) as simulation:
        for other in things:
            simulation.add(other)
        robot = simulation.add(model, pose=pose, **options)
        samples = record(robot, topic)
        simulation.run_for(seconds)
    return samples


def total(vectors):
    return np.sum(vectors, axis=0)


def test_a_crate_on_the_floor_is_carried_by_it():
    sample = run(bumper())[-1]
    (contact,) = sample.contacts
    assert contact.first == "crate::base::base_collision"
    assert contact.second == "ground_plane::link::collision"
    assert total(contact.forces) == pytest.approx((0, 0, MASS * G), rel=1e-3, abs=1e-2)
    # The nose, which weighs nothing, moves no mass: the middle is the crate's.
    assert total(contact.torques) == pytest.approx((0, 0, 0), abs=1e-2)
    # Two corners at least carry it.
    assert 2 <= len(contact.positions) == len(contact.normals) == len(contact.depths) <= 4
    for position, normal, depth in zip(contact.positions, contact.normals, contact.depths):
        assert np.abs(position) == pytest.approx((0.1, 0.1, 0), abs=1e-3)
        assert normal == pytest.approx((0, 0, 1), abs=1e-6)
        assert 0.0 < depth < 1e-4
    assert sample.frame == "world"


def test_shapes_beyond_what_the_engine_takes_at_once_are_felt():
    """The crate's floor is the last of twenty shapes; the others are in the air."""
    model = bumper()
    (link,) = model.links
    small = tuple(
        Collision(Box((0.01, 0.01, 0.01)), Pose((0.0, 0.01 * n - 0.1, 0.0)), name=f"c{n}")
        for n in range(19)
    )
    bottom = Collision(Box((0.2, 0.2, 0.02)), Pose((0.0, 0.0, -0.09)), name="bottom")
    model = replace(model, links=(replace(link, collisions=(*small, bottom)),))
    (contact,) = run(model)[-1].contacts
    assert contact.first == "crate::base::bottom"
    assert total(contact.forces) == pytest.approx((0, 0, MASS * G), rel=1e-3, abs=1e-2)


def test_in_the_air_it_touches_nothing():
    samples = run(bumper(), 0.1, pose=Pose((0, 0, 1)))
    assert len(samples) == 10
    assert not any(sample.contacts for sample in samples)


def test_what_is_merely_near_is_not_touched():
    # Bullet knows of the floor 0.5 mm below.
    with Simulation.of(FLOOR) as simulation:
        robot = simulation.add(bumper(rate=1000), pose=Pose((0, 0, 0.1005)))
        samples = record(robot, "bumper_states")
        simulation.run_for(0.001)
        assert robot.bodies["base"].near_points()
    assert samples[-1].contacts == ()


def test_shapes_of_one_link_are_told_apart():
    # The crate slides into a wall with its nose.
    wall = box("1 1 1", "0.641 0 0.5 0 0 0", "wall")
    with Simulation.of(FLOOR) as simulation:
        simulation.add(wall)
        robot = simulation.add(bumper(), pose=Pose((0, 0, 0.1)))
        samples = record(robot, "bumper_states")
        simulation.run_for(0.1)
        for _ in range(100):
            robot.bodies["base"].set_velocity((0.1, 0, 0), (0, 0, 0))
            simulation.run_for(1e-3)
    pairs = {(c.first, c.second): c for c in samples[-1].contacts}
    nose = "crate::base::base_fixed_joint_lump__nose_collision_1"
    assert set(pairs) == {
        ("crate::base::base_collision", "ground_plane::link::collision"),
        (nose, "wall::l::c"),
    }
    hit = pairs[nose, "wall::l::c"]
    assert total(hit.forces)[0] < -1.0
    assert hit.normals[0] == pytest.approx((-1, 0, 0), abs=1e-3)
    assert hit.positions[0] == pytest.approx((0.141, 0, 0.1), abs=3e-3)


@pytest.mark.parametrize(
    "name", ["base_fixed_joint_lump__nose_collision_1", "base_fixed_joint_lump__nose_collision",
             "nose_collision", "nose"]
)
def test_only_the_named_shapes_are_watched(name):
    assert not any(sample.contacts for sample in run(bumper([name]), 0.2))


@pytest.mark.parametrize("name", ["base_collision", "base"])
def test_the_named_shape_is_watched(name):
    assert all(sample.contacts for sample in run(bumper([name]))[-10:])


def test_a_sensor_on_the_merged_link_is_on_the_one_that_stays():
    assert run(bumper(link="nose"))[-1].contacts


def test_friction_is_part_of_the_force_whoever_bullet_puts_first():
    # Two crates, one on the other, pushed apart sideways: each feels what the other does not.
    with Simulation.of(FLOOR) as simulation:
        names = ("lower", "upper")
        robots = [
            simulation.add(bumper(name=name), pose=Pose((0, 0, height)), namespace=name)
            for name, height in zip(names, (0.1, 0.3))
        ]
        samples = [record(r, f"/{n}/bumper_states") for n, r in zip(names, robots)]
        simulation.run_for(0.3)
        robots[1].bodies["base"].set_velocity((0.5, 0, 0), (0, 0, 0))
        simulation.run_for(0.01)
    forces = {}
    for (sample,) in (seen[-1:] for seen in samples):
        for contact in sample.contacts:
            first, second = (name.split("::")[0] for name in (contact.first, contact.second))
            forces[first, second] = total(contact.forces)
    assert forces["upper", "lower"] == pytest.approx(-forces["lower", "upper"])
    # The upper one is slowed down, with all the friction there is.
    assert forces["upper", "lower"][0] == pytest.approx(-forces["upper", "lower"][2], rel=0.05)
    assert forces["upper", "lower"][0] < -10.0


def test_vectors_are_given_in_a_link_of_the_model():
    start = Pose.from_rpy((1, 2, 0.1), (0, 0, math.radians(90)))
    wall = box("1 1 1", "1 2.641 0.5 0 0 0", "wall")
    with Simulation.of(FLOOR) as simulation:
        simulation.add(wall)
        robot = simulation.add(bumper(tags="<frameName>nose</frameName>"), pose=start)
        samples = record(robot, "bumper_states")
        simulation.run_for(0.1)
        for _ in range(100):
            robot.bodies["base"].set_velocity((0, 0.1, 0), (0, 0, 0))
            simulation.run_for(1e-3)
    hit = next(c for c in samples[-1].contacts if c.second.startswith("wall"))
    assert samples[-1].frame == "nose"
    assert hit.positions[0] == pytest.approx((0.02, 0, 0), abs=3e-3)
    assert hit.normals[0] == pytest.approx((-1, 0, 0), abs=1e-3)
    assert total(hit.forces)[0] < -1.0


def test_the_torque_is_about_the_centre_of_mass():
    post = thing("<sphere><radius>0.05</radius></sphere>", "0.1495 0.08 0.1 0 0 0", "post")
    with Simulation.of(FLOOR) as simulation:
        robot = simulation.add(bumper(), pose=Pose((0, 0, 0.1)))
        simulation.add(post)
        samples = record(robot, "bumper_states")
        for _ in range(10):
            robot.bodies["base"].set_velocity((0.1, 0, 0), (0, 0, 0))
            simulation.run_for(1e-3)
    hit = next(c for c in samples[-1].contacts if c.second.startswith("post"))
    for force, torque, position in zip(hit.forces, hit.torques, hit.positions):
        arm = np.subtract(position, (0.0, 0.0, 0.1))
        assert torque == pytest.approx(tuple(np.cross(arm, force)), rel=0.05, abs=0.05)
    # The post, ahead and to the left, pushes back: the crate is turned to the left.
    assert total(hit.forces)[0] < 0.0
    assert total(hit.torques)[2] > 0.0


@pytest.mark.parametrize("rate", [100, 30])
def test_the_mean_rate_is_exact(rate):
    assert len(run(bumper(rate=rate), 2.0)) == 2 * rate


def test_names():
    tags = "<bumperTopicName>front</bumperTopicName><frameName>/map</frameName>"
    samples = run(bumper(tags=tags), 0.1, topic="/ns/front", namespace="ns", tf_prefix="robot")
    assert samples[-1].frame == "map"


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (lambda: bumper(["tail"]), "link 'base' has no shape 'tail'; its shapes: base_collision"),
        (lambda: bumper(rate=-1), "<update_rate>: a rate of -1 Hz"),
    ],
)
def test_refusals(model, message):
    with Simulation.of(FLOOR) as simulation, complains(message):
        simulation.add(model())


@pytest.mark.parametrize(
    ("geometry", "point", "distance"),
    [
        (Sphere(0.5), (0, 0.3, 0.4), 0.0),
        (Sphere(0.5), (0, 0, 0.2), 0.3),
        (Box((2, 4, 6)), (1, 0, 0), 0.0),
        (Box((2, 4, 6)), (0, 0, 0), 1.0),
        (Box((2, 4, 6)), (4, 6, 3), 5.0),
        (Box((2, 4, 6)), (0.9, 1.5, 0), 0.1),
        (Cylinder(1.0, 2.0), (0, 0, 0.9), 0.1),
        (Cylinder(1.0, 2.0), (3, 4, 0), 4.0),
        (Cylinder(1.0, 2.0), (4, 0, 5), 5.0),
        (Plane(), (3, 2, -0.5), 0.5),
        (Plane((2.0, 0.0, 0.0)), (3, 2, -0.5), 3.0),
    ],
)
def test_distances_from_surfaces(geometry, point, distance):
    assert geometry.distance(point) == pytest.approx(distance)


def test_a_mesh_is_taken_for_the_box_around_it(block_model, package):
    with Simulation.of("package://bullet_lab/worlds/beacons.world") as simulation:
        beacon = next(m for n, m in simulation.models.items() if "beacon" in n).model
    (shape,) = beacon.links[0].collisions
    near = shape.pose * Pose((0.0, 0.0, 0.0))
    low = shape.geometry.distance(near.position)
    far = shape.geometry.distance((100.0, 0.0, 0.0))
    assert low < 1.0
    assert 99.0 < far < 100.0


def test_the_nearest_shape_is_found_by_its_pose():
    left = Collision(Sphere(0.1), Pose((0, 1, 0)), name="left")
    right = Collision(Sphere(0.1), Pose((0, -1, 0)), name="right")
    assert nearest_shape((left, right), (0, -0.9, 0)).name == "right"
    assert nearest_shape((left, right), (0, 0.5, 0)).name == "left"
