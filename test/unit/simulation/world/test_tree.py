import numpy as np
import pytest

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import (
    Box,
    Collision,
    Inertia,
    Joint,
    Link,
    Model,
    Visual,
)
from bullet_lab.simulation.world.tree import (
    check_tree,
    lump_fixed_joints,
    place_links,
    top_down,
)
from bullet_lab.simulation.world.xml import XmlError


def links(names):
    return tuple(Link(name) for name in names)


def joints(*ends):
    return tuple(Joint(f"j{i}", "fixed", *pair) for i, pair in enumerate(ends))


def test_a_tree_passes_and_is_walked_from_the_top():
    check_tree(links("abcd"), joints("ac", "ab", "cd"), "s")
    assert top_down("a", joints("ac", "ab", "cd")) == ["a", "c", "b", "d"]


@pytest.mark.parametrize(
    ("names", "ends", "message"),
    [
        ("", [], "there is no link"),
        ("aab", ["ab"], "link 'a' appears twice"),
        ("abc", ["ac", "bc"], "child link 'c' appears twice"),
        ("ab", ["ax"], "joint 'j0' has an unknown link 'x'"),
        ("ab", ["xb"], "joint 'j0' has an unknown link 'x'"),
        ("ab", [], "several root links: a, b"),
        ("ab", ["ab", "ba"], "a loop of joints at a, b"),
        ("abc", ["bc", "cb"], "a loop of joints at b, c"),
        ("a", ["aa"], "a loop of joints at a"),
    ],
)
def test_what_is_no_tree_is_refused(names, ends, message):
    with pytest.raises(XmlError, match=f"^s: {message}$"):
        check_tree(links(names), joints(*ends), "s")


def test_joint_names_are_not_shared():
    same = (Joint("j", "fixed", "a", "b"), Joint("j", "fixed", "a", "c"))
    with pytest.raises(XmlError, match="joint 'j' appears twice"):
        check_tree(links("abc"), same, "s")


def test_links_are_placed_along_the_joints():
    up, turn = Pose((0, 0, 1)), Pose.from_rpy((1, 0, 0), (0, 0, np.pi / 2))
    chain = (Joint("j", "fixed", "a", "b", turn), Joint("k", "revolute", "b", "c", up * turn))
    placed = {link.name: link.pose for link in place_links(links("cba"), chain)}
    assert placed["a"] == Pose()
    assert placed["b"].position == (1, 0, 0)
    assert placed["c"].position == pytest.approx((1, 1, 1))
    assert placed["c"].yaw == pytest.approx(np.pi)


def test_lumping_moves_shapes_masses_and_joints_to_the_link_that_stays():
    half = Inertia(1.0, (0, 0, 0), np.eye(3))
    shape = (Visual(Box((1, 1, 1)), Pose((0, 0, 0.1))),)
    touch = (Collision(Box((1, 1, 1)), Pose((0, 0, 0.2)), 0.3),)
    parts = (
        Link("base"),
        Link("plate", inertia=half),
        Link("mast", inertia=half, visuals=shape, collisions=touch),
        Link("wheel", inertia=half),
    )
    to_plate, to_mast = Pose((0, 0, 1)), Pose.from_rpy((1, 0, 0), (0, 0, np.pi / 2))
    hung = (
        Joint("a", "fixed", "base", "plate", to_plate),
        Joint("b", "fixed", "plate", "mast", to_mast),
        Joint("c", "revolute", "mast", "wheel", Pose((2, 0, 0)), axis=(0, 1, 0)),
    )
    lumped = lump_fixed_joints(Model("m", parts, hung))
    base, wheel = lumped.links
    assert (base.name, wheel.name) == ("base", "wheel")
    assert base.inertia.mass == 2.0
    assert base.inertia.centre == pytest.approx((0.5, 0, 1))
    assert base.visuals[0].pose.position == pytest.approx((1, 0, 1.1))
    assert base.collisions[0].pose.position == pytest.approx((1, 0, 1.2))
    assert base.collisions[0].friction == 0.3
    (joint,) = lumped.joints
    assert (joint.parent, joint.child, joint.axis) == ("base", "wheel", (0, 1, 0))
    assert joint.pose.position == pytest.approx((1, 2, 1))
    assert lumped.frames["mast"][0] == "base"
    assert lumped.frames["mast"][1].position == pytest.approx((1, 0, 1))
    assert set(lumped.frames) == {"plate", "mast"}


def test_nothing_is_lumped_without_fixed_joints():
    model = Model("m", links("ab"), (Joint("j", "revolute", "a", "b"),))
    assert lump_fixed_joints(model) == model


def test_the_block_robot_becomes_one_body(block_model):
    (link,) = block_model.links
    assert link.name == "base_footprint"
    assert link.inertia.mass == pytest.approx(4.51)
    assert link.inertia.matrix[2, 2] == pytest.approx(7.5125e-3)
    # Block and can on a common axis, 5 cm apart.
    steiner = 4.5 * 0.01 / 4.51 * 0.05**2
    assert link.inertia.matrix[0, 0] == pytest.approx(4.6875e-3 + 8.33e-6 + steiner)
    assert link.inertia.centre == pytest.approx((0, 0, 0.025 + 0.01 / 4.51 * 0.05))
    frames = {name: (root, pose.position) for name, (root, pose) in block_model.frames.items()}
    assert frames == {
        "base_link": ("base_footprint", (0, 0, 0.025)),
        "laser_link": ("base_footprint", pytest.approx((0, 0, 0.075))),
    }
