import math

import numpy as np
import pytest
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import (
    Inertia,
    Joint,
    Link,
    Model,
)
from bullet_lab.simulation.world.tree import (
    check_tree,
    combine,
    principal_axes,
    top_down,
    usable,
)
from bullet_lab.simulation.world.xml import XmlError


def links(names):
    return tuple(Link(name) for name in names)


def joints(*ends):
    return tuple(Joint(f"j{i}", "fixed", *pair) for i, pair in enumerate(ends))


def test_a_tree_passes_and_is_walked_from_the_top():
    check_tree(links("abcd"), joints("ac", "ab", "cd"), "s")
    assert top_down("a", joints("ac", "ab", "cd")) == ["a", "c", "b", "d"]


@cases("""
names, ends, message:
  - ['', [], there is no link]
  - [aab, [ab], link 'a' appears twice]
  - [abc, [ac, bc], child link 'c' appears twice]
  - [ab, [ax], joint 'j0' has an unknown link 'x']
  - [ab, [xb], joint 'j0' has an unknown link 'x']
  - [ab, [], 'several root links: a, b']
  - [ab, [ab, ba], 'a loop of joints at a, b']
  - [abc, [bc, cb], 'a loop of joints at b, c']
  - [a, [aa], a loop of joints at a]
""")
def test_what_is_no_tree_is_refused(names, ends, message):
    with pytest.raises(XmlError, match=f"^s: {message}$"):
        check_tree(links(names), joints(*ends), "s")


def test_joint_names_are_not_shared():
    with pytest.raises(XmlError, match="joint 'j0' appears twice"):
        check_tree(links("abc"), joints("ab") + joints("ac"), "s")


def test_what_has_no_mass_is_left_out_once_with_all_that_hangs_on_it(caplog):
    bodies = [Link(name, inertia=box(1.0, 1, 1, 1) if name.isupper() else None) for name in "AbcDE"]
    parts = (*bodies, Link("post", anchored=True)), joints("Ab", "bc", "cD", "AE")
    found = usable(Model("m", *parts))
    assert [part.name for part in (*found.links, *found.joints)] == ["A", "E", "post", "j3"]
    what = "moves and has no mass; it is left out, and with it c, D"
    assert caplog.messages == [f"model 'm': link 'b' {what}"]


def box(mass, x, y, z, centre=(0.0, 0.0, 0.0)):
    squares = (y * y + z * z, x * x + z * z, x * x + y * y)
    return Inertia(mass, centre, mass / 12.0 * np.diag(squares))


def test_unequal_parts_of_a_turned_box():
    # A box of 0.6 x 0.2 x 0.1 m, cut at a third of its length, and turned as a whole; each
    # part's centre of mass lies off the origin of its frame. What has no mass counts for nothing.
    turned = Pose.from_rpy((1.0, 2.0, 3.0), (0.3, -0.4, 0.5))
    short = box(1.0, 0.2, 0.2, 0.1, centre=(0.1, 0.0, 0.0))
    long = box(2.0, 0.4, 0.2, 0.1, centre=(0.2, 0.0, 0.0))
    nothing = Inertia(0.0, (9.0, 9.0, 9.0), np.zeros((3, 3)))
    parts = [(short, turned), (long, turned * Pose((0.2, 0.0, 0.0))), (nothing, Pose())]
    whole = combine(parts)
    turn = turned.rotation_matrix()
    assert combine(2 * parts[2:]).centre == (9.0, 9.0, 9.0)
    assert whole.mass == 3.0
    assert whole.centre == pytest.approx((turned * Pose((0.3, 0.0, 0.0))).position)
    assert whole.matrix == pytest.approx(turn @ box(3.0, 0.6, 0.2, 0.1).matrix @ turn.T)


@cases("angles: [[0.2, 0.7, -1.0], [1.3, -0.4, 0.5], [-2.0, 0.1, 0.9], [0.4, 1.2, 2.5]]")
@cases("mass: [3.0e-7, 3.0e+7]")
def test_principal_axes_of_a_turned_box(angles, mass):
    turn = Pose.from_rpy((0, 0, 0), angles).rotation_matrix()
    straight = box(mass, 0.6, 0.2, 0.1).matrix
    moments, frame = principal_axes(Inertia(mass, (1.0, 2.0, 3.0), turn @ straight @ turn.T))
    assert sorted(moments) == pytest.approx(sorted(np.diag(straight)))
    assert frame.position == (1.0, 2.0, 3.0)
    axes = frame.rotation_matrix()
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes @ np.diag(moments) @ axes.T == pytest.approx(turn @ straight @ turn.T)


def test_a_diagonal_inertia_keeps_its_axes():
    moments, frame = principal_axes(box(1.0, 0.1, 0.3, 0.2))
    assert moments == tuple(np.diag(box(1.0, 0.1, 0.3, 0.2).matrix))
    assert frame == Pose()
    assert math.hypot(*frame.quaternion) == 1.0
