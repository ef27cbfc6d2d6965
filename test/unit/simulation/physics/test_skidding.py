"""Which wheels skid, and how easily friction moves them."""

from dataclasses import replace

import numpy as np
import pytest
from rovers import LYING, ROUND, Rover, Y, wheels
from wheeled_robots import Robot, wheel_mesh

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.physics.surfaces import (
    skidding_wheels,
)
from bullet_lab.simulation.physics.traction import wheel_mobility
from bullet_lab.simulation.world.description import (
    Box,
    Collision,
    Cylinder,
    Inertia,
    Joint,
    Link,
    Mesh,
    Sphere,
)
from bullet_lab.simulation.world.tree import place_links

Z = (0.0, 0.0, 1.0)
CORNERS = [(x, y, 0.1) for x in (0.2, -0.2) for y in (0.25, -0.25)]


def skidding(*groups):
    links = [Link("base"), *(link for links, _ in groups for link in links)]
    joints = [joint for _, joints in groups for joint in joints]
    return [wheel.link for wheel in skidding_wheels(place_links(tuple(links), joints), joints)]


def test_wheels_on_axles_apart_skid_and_on_one_axle_they_do_not():
    assert skidding(wheels(*CORNERS)) == ["base_w0", "base_w1", "base_w2", "base_w3"]
    assert not skidding(wheels(*CORNERS[:2]))
    model = Robot().model()
    assert not skidding_wheels(model.links, model.joints)


def test_what_is_steered_does_not_skid():
    front, back = wheels(*CORNERS[:2]), wheels(*CORNERS[2:], parent="swivel")
    swivel = [Link("swivel")], [Joint("s", "revolute", "base", "swivel", Pose(), Z)]
    assert not skidding(front, swivel, back)
    # On what is not steered there may be wheels that do.
    rear = wheels((-0.4, 0.0, 0.1), parent="tail")
    tail = [Link("tail")], [Joint("t", "prismatic", "base", "tail", Pose(), Z)]
    assert skidding(front, tail, rear, swivel, back) == ["base_w0", "base_w1", "tail_w0"]


def test_wheels_on_rockers_skid():
    """Those turn about an axis across, or along, and leave the wheels' heading as it is."""
    for axis in (Y, (1.0, 0.0, 0.0)):
        rocker = [Link("rocker")], [Joint("r", "revolute", "base", "rocker", Pose(), axis)]
        front = wheels(*CORNERS[:2], parent="rocker")
        assert len(skidding(rocker, front, wheels(*CORNERS[2:]))) == 4


@pytest.mark.parametrize(
    ("count", "other"),
    [
        (0, {"shape": Collision(Box((0.2, 0.05, 0.2)))}),
        (0, {"shape": Collision(Cylinder(0.1, 0.05))}),
        (0, {"shape": replace(ROUND, pose=Pose((0.05, 0.0, 0.0), LYING.quaternion))}),
        (0, {"kind": "revolute", "limits": {"lower": -1.0, "upper": 1.0}}),
        (0, {"kind": "prismatic"}),
        (0, {"axis": Z, "shape": Collision(Cylinder(0.1, 0.05))}),
        (4, {"shape": Collision(Sphere(0.1))}),
        (4, {"kind": "revolute", "limits": {"lower": -1e16, "upper": 1e16}}),
        (4, {"kind": "revolute"}),
        (4, {"shape": replace(ROUND, pose=Pose((0.0, 0.03, 0.0), LYING.quaternion))}),
        (4, {"axis": (0.0, -1.0, 0.0)}),
    ],
)
def test_what_is_no_wheel_does_not_skid(count, other):
    assert len(skidding(wheels(*CORNERS, **other))) == count


def test_wheels_of_meshes(tmp_path):
    wheel_mesh(tmp_path / "wheel.stl", 0.1, 0.05)
    mesh = Mesh(tmp_path / "wheel.stl", "wheel.stl")
    links, joints = wheels(*CORNERS, shape=Collision(mesh, LYING))
    found = skidding_wheels(place_links((Link("base"), *links), joints), joints)
    assert [round(wheel.radius, 4) for wheel in found] == 4 * [0.1]
    assert not skidding(wheels(*CORNERS, shape=Collision(mesh)))


# Mobility


def test_the_mobility_is_that_of_the_closed_form():
    """Of a base with wheels that have nothing but an inertia about their axles."""
    mass, spin, radius, centre = 5.0, 0.004, 0.1, np.array((0.05, -0.02, 0.3))
    moments = np.diag((0.1, 0.2, 0.3))
    links, joints = wheels(*CORNERS)
    light = Inertia(1e-9, (0.0, 0.0, 0.0), np.diag((1e-9, spin, 1e-9)))
    base = Link("base", Pose(), Inertia(mass, tuple(centre), moments))
    placed = place_links((base, *(replace(link, inertia=light) for link in links)), joints)
    told = skidding_wheels(placed, joints)
    mobility = wheel_mobility(placed, joints, told)
    for n, place in enumerate(CORNERS):
        hub = np.array(place) - centre
        # Along the way the wheel gives way, and what it holds on to is its hub.
        along = np.cross(hub, (1.0, 0.0, 0.0))
        wanted = 1.0 / mass + along @ np.linalg.solve(moments, along) + radius**2 / spin
        assert mobility[2 * n, 2 * n] == pytest.approx(wanted, rel=1e-4)
        across = np.cross(hub - (0.0, 0.0, radius), Y)
        wanted = 1.0 / mass + across @ np.linalg.solve(moments, across)
        assert mobility[2 * n + 1, 2 * n + 1] == pytest.approx(wanted, rel=1e-4)


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "ball"])
def test_what_hangs_on_a_joint_adds_less_than_what_is_fixed(kind):
    rover = Rover().model()
    load = Link("load", Pose((0.1, 0.0, 0.3)), Inertia(3.0, (0.1, 0.0, 0.1), 0.1 * np.eye(3)))
    links = (*rover.links, load)
    hinge = Joint("hinge", kind, "base", "load", load.pose, Y)
    told = skidding_wheels(rover.links, rover.joints)
    bare = wheel_mobility(rover.links, rover.joints, told)
    loose = wheel_mobility(links, (*rover.joints, hinge), told)
    fixed = wheel_mobility(links, (*rover.joints, replace(hinge, kind="fixed")), told)
    for more, less in ((bare, loose), (loose, fixed)):
        assert np.linalg.eigvalsh(more - less).min() > -1e-9
