import math
from dataclasses import replace

import numpy as np
import pytest
from sensor_worlds import box, record, thing
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import Box, Collision, Mesh
from bullet_lab.simulation.world.urdf import read_urdf

MASS, G = 2.0, 9.8
UPRIGHT = Pose((0, 0, 0.1))


def bumper(collisions=(), tags="", rate=100, link="base", name="crate"):
    """A crate of 0.2 m with a small nose on a merged link, ahead."""
    watched = "".join(f"<collision>{name}</collision>" for name in collisions)
    return read_urdf(
        f'<robot name="{name}"><link name="base"><inertial><mass value="{MASS}"/>'
        '<inertia ixx="0.0133" iyy="0.0133" izz="0.0133"/></inertial>'
        '<collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>'
        '<link name="nose"><collision><geometry><sphere radius="0.02"/></geometry></collision>'
        '</link><joint name="j" type="fixed"><parent link="base"/><child link="nose"/>'
        f'<origin xyz="0.12 0 0"/></joint>'
        f'<gazebo reference="{link}"><sensor type="contact" name="bumper">'
        f"<update_rate>{rate}</update_rate><contact>{watched}</contact>"
        f'<plugin name="bumper" filename="libgazebo_ros_bumper.so">{tags}</plugin>'
        "</sensor></gazebo></robot>",
        "crate",
    )


def run(world, model, seconds=0.2, topic="bumper_states", pose=UPRIGHT, **options):
    """Return what the bumper of a robot on the floor says, and the robot."""
    robot = world.add(model, pose=pose, **options)
    samples = record(robot, topic)
    world.run_for(seconds)
    return samples, robot


def slide(world, robot, velocity, steps=100):
    for _ in range(steps):
        robot.bodies["base"].set_velocity(velocity, (0, 0, 0))
        world.run_for(1e-3)


def of_last_step(sample):
    return [contact for contact in sample.contacts if contact.step == sample.step]


def hit_by(sample, name):
    (contact,) = (c for c in of_last_step(sample) if c.second.startswith(name))
    return contact


def total(vectors):
    return np.sum(vectors, axis=0)


def test_a_crate_on_the_floor_is_carried_by_it(world):
    sample = run(world, bumper(), 0.5)[0][-1]
    (contact,) = of_last_step(sample)
    assert contact.first == "crate::base::base_collision"
    assert contact.second == "ground_plane::link::collision"
    assert total(contact.forces) == pytest.approx((0, 0, MASS * G), rel=1e-3, abs=1e-2)
    # The nose, which weighs nothing, moves no mass: the middle is the crate's.
    assert total(contact.torques) == pytest.approx((0, 0, 0), abs=1e-2)
    # Two corners at least carry it.
    assert 2 <= len(contact.positions) == len(contact.normals) == len(contact.depths)
    for position, normal, depth in zip(contact.positions, contact.normals, contact.depths):
        assert np.abs(position) == pytest.approx((0.1, 0.1, 0), abs=1e-3)
        assert normal == pytest.approx((0, 0, 1), abs=1e-6)
        assert 0.0 < depth < 1e-4
    assert sample.frame == "world"


def test_shapes_beyond_what_the_engine_takes_at_once_are_felt(world):
    """The crate's floor is the last of twenty shapes; the others are in the air."""
    model = bumper()
    (link,) = model.links
    small = tuple(
        Collision(Box((0.01, 0.01, 0.01)), Pose((0.0, 0.01 * n - 0.1, 0.0)), name=f"c{n}")
        for n in range(19)
    )
    bottom = Collision(Box((0.2, 0.2, 0.02)), Pose((0.0, 0.0, -0.09)), name="bottom")
    model = replace(model, links=(replace(link, collisions=(*small, bottom)),))
    (contact,) = of_last_step(run(world, model)[0][-1])
    assert contact.first == "crate::base::bottom"


@cases("height, near: [[0.1005, true], [1.0, false]]")
def test_what_is_merely_near_is_not_touched(world, height, near):
    # Bullet knows of the floor 0.5 mm below.
    samples, robot = run(world, bumper(rate=1000), 0.001, pose=Pose((0, 0, height)))
    assert bool(robot.bodies["base"].near_points()) == near
    assert samples[-1].contacts == ()


def test_shapes_of_one_link_are_told_apart(world):
    # The crate slides into a wall with its nose.
    world.add(box("1 1 1", "0.641 0 0.5 0 0 0", "wall"))
    samples, robot = run(world, bumper(), 0.1)
    slide(world, robot, (0.1, 0, 0))
    nose = "crate::base::base_fixed_joint_lump__nose_collision_1"
    assert {(c.first, c.second) for c in of_last_step(samples[-1])} == {
        ("crate::base::base_collision", "ground_plane::link::collision"),
        (nose, "wall::l::c"),
    }
    hit = hit_by(samples[-1], "wall")
    assert total(hit.forces)[0] < -1.0
    assert hit.normals[0] == pytest.approx((-1, 0, 0), abs=1e-3)
    assert hit.positions[0] == pytest.approx((0.141, 0, 0.1), abs=3e-3)


@cases("""
name, watched:
  - [base_fixed_joint_lump__nose_collision_1, false]
  - [nose_collision, false]
  - [nose, false]
  - [base_collision, true]
  - [base, true]
""")
def test_only_the_named_shapes_are_watched(world, name, watched, caplog):
    assert bool(run(world, bumper([name]))[0][-1].contacts) == watched
    # Of the others, Gazebo would report nothing.
    is_gazebos = name in ("base_fixed_joint_lump__nose_collision_1", "base_collision")
    assert caplog.text.count(f"has no shape '{name}'") == (not is_gazebos)


def test_friction_is_part_of_the_force_whoever_bullet_puts_first(world):
    # Two crates, one on the other, pushed apart sideways: each feels what the other does not.
    lower, _ = run(world, bumper(name="lower"), 0.0)
    model = bumper(name="upper", tags="<bumperTopicName>upper</bumperTopicName>")
    upper, robot = run(world, model, 0.3, "upper", Pose((0, 0, 0.3)))
    slide(world, robot, (0.5, 0, 0), 1)
    world.run_for(0.01)
    force = total(hit_by(upper[-1], "lower").forces)
    assert force == pytest.approx(-total(hit_by(lower[-1], "upper").forces))
    # The upper one is slowed down, with all the friction there is.
    assert force[0] == pytest.approx(-force[2], rel=0.05)
    assert force[0] < -10.0


def test_vectors_are_in_the_world_whatever_the_frame(world):
    start = Pose.from_rpy((1, 2, 0.1), (0, 0, math.radians(90)))
    world.add(box("1 1 1", "1 2.641 0.5 0 0 0", "wall"))
    # A sensor on a merged link is on the one that stays.
    model = bumper(tags="<frameName>nose</frameName>", link="nose")
    samples, robot = run(world, model, 0.1, pose=start)
    slide(world, robot, (0, 0.1, 0))
    hit = hit_by(samples[-1], "wall")
    assert samples[-1].frame == "nose"
    assert hit.positions[0] == pytest.approx((1, 2.141, 0.1), abs=3e-3)
    assert hit.normals[0] == pytest.approx((0, -1, 0), abs=1e-3)
    assert total(hit.forces)[1] < -1.0


def test_a_sample_has_the_contacts_of_each_step_since_the_last_one(world):
    robot = world.add(bumper(rate=4), pose=UPRIGHT)
    world.run_for(0.5)
    assert not robot.plugins[0]._steps
    samples = record(robot, "bumper_states")
    world.run_for(0.5)
    # Of the first sample, nothing was kept: nobody listened. A memory has an end, as in Gazebo.
    assert [[c.step for c in s.contacts] for s in samples] == [[750], list(range(901, 1001))]
    world.run_for(0.01)
    world.reset_simulation()
    world.run_for(0.25)
    assert [c.step for c in samples[-1].contacts] == [250]


def test_the_torque_is_about_the_centre_of_mass(world):
    world.add(thing("<sphere><radius>0.05</radius></sphere>", "0.1495 0.08 0.1 0 0 0", "post"))
    samples, robot = run(world, bumper(), 0.0)
    slide(world, robot, (0.1, 0, 0), 10)
    hit = hit_by(samples[-1], "post")
    for force, torque, position in zip(hit.forces, hit.torques, hit.positions):
        arm = np.subtract(position, (0.0, 0.0, 0.1))
        assert torque == pytest.approx(tuple(np.cross(arm, force)), rel=0.05, abs=0.05)
    # The post, ahead and to the left, pushes back: the crate is turned to the left.
    assert total(hit.forces)[0] < 0.0
    assert total(hit.torques)[2] > 0.0


def test_a_mesh_is_taken_for_the_box_around_it(package):
    beacon = Mesh(package / "meshes" / "beacon.dae", "", (0.1, 0.1, 0.1))
    _, (x, y, z) = beacon.bounds()
    assert beacon.distance((x + 3.0, y, z)) == pytest.approx(3.0)
