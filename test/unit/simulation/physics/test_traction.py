"""Robots that steer by slipping turn as Coulomb's law says, at any heading and on any floor."""

import math

import numpy as np
import pytest
from contact_forces import pressures
from rovers import Drive, G, Rover, coulomb_twist, even_inertia
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.models import change_link, find_link
from bullet_lab.simulation.world.description import Box, Collision, Link, Model

# Turning


def expected(drive, left, right, **more):
    return coulomb_twist(drive.rover.places(), drive.loads(), left, right, **more)


@pytest.mark.parametrize(
    "seed", [*range(8), *(pytest.param(n, marks=pytest.mark.long) for n in range(8, 25))]
)
def test_rovers_of_all_kinds_turn_as_the_quasi_static_law_says(seed):
    """Slow, so that nothing but friction counts."""
    random = np.random.default_rng(seed)
    length, x, y = random.uniform((0.1, -0.2, -0.1), (0.8, 0.2, 0.1))
    stiffness = 10.0 ** random.uniform(4.0, 7.0)
    rover = Rover(
        length=length,
        rows=int(random.integers(2, 6)),
        radius=random.uniform(0.05, 0.1),
        centre=(x * length, y, 0.1),
        wheel_mass=10.0 ** random.uniform(-2.0, 0.5),
        wheel={
            "friction": random.uniform(0.3, 1.0),
            "stiffness": stiffness,
            "damping": 1e-2 * stiffness,
        },
    )
    left, right = random.uniform(-0.2, 0.2, 2)
    with Drive(rover, random.uniform(-math.pi, math.pi)) as drive:
        twist = drive.steady_twist(left, right)
        law = expected(drive, left, right)
    assert twist == pytest.approx(law, abs=0.01 * max(abs(left), abs(right)))
    assert twist[2] == pytest.approx(law[2], rel=0.02)


def test_what_is_fast_is_also_kept_on_its_arc():
    rover = Rover(centre=(0.0625, 0.0375, 0.1))
    with Drive(rover, 0.5) as drive:
        drive.go(-0.5, 0.5, 0.8)
        twist, loads = drive.twist(), drive.loads()
    # By the twist at the centre of mass of all, whose acceleration is ω × v.
    mass, (x, y) = 10.0, (0.05, 0.03)
    law = np.zeros(3)
    for _ in range(30):
        pull = (mass * law[1] * law[2], -mass * law[0] * law[2])
        law += coulomb_twist(rover.places() - (x, y), loads, -0.5, 0.5, pull=pull)
        law *= 0.5
    assert twist == pytest.approx(law + law[2] * np.array((y, -x, 0.0)), rel=0.01, abs=2e-3)


@cases("one, other, rolled: [[0.4, 1.0, 0.7], [0.8, 0, 2]]")
def test_with_other_friction_along_than_across(one, other, rolled):
    """The second direction of a wheel whose first turns with it is along its axle."""
    directed = {"friction": one, "cross_friction": other, "direction": (1.0, 0.0, 0.0)}
    rover = Rover(wheel=directed, centre=(0.04, 0.0, 0.1))
    with Drive(rover, 0.5) as drive:
        for name in drive.body.joint_names:
            drive.body.set_joint(name, rolled)
        twist = drive.steady_twist(-0.2, 0.2)
        law = expected(drive, -0.2, 0.2, coefficients=(one, max(other, 1e-6)))
    assert twist[2] == pytest.approx(law[2], rel=0.01)


# Slopes


@pytest.mark.parametrize(("heading", "towards"), [(0.9, 0.8), (math.pi / 2, 0.3)])
def test_on_a_slope_it_stands_and_drives_straight(heading, towards):
    with Drive(Rover(), heading, 0.2, towards) as drive:
        drive.go(0.0, 0.0, 0.5)
        start = drive.robot.pose()
        drive.go(0.0, 0.0, 0.5)
        assert math.dist(drive.robot.pose().position, start.position) < 1e-6
        drive.go(0.25, 0.25, 1.0)
        x, y, _ = (start.inverse() * drive.robot.pose()).position
        # Less what it slips as it starts, v²/2a.
        assert x == pytest.approx(0.25, abs=6e-3)
        assert abs(y) < 1e-3


def test_the_twist_on_a_slope_is_that_of_the_law_with_gravity():
    slope, rover = 0.25, Rover(centre=(0.0, 0.0, 0.0))
    with Drive(rover, 0.6, slope, 0.4) as drive:
        drive.go(-0.2, 0.2, 0.4)
        heading = (drive.tilt.inverse() * drive.robot.pose()).yaw
        weight = (rover.mass + 4 * rover.wheel_mass) * G * math.sin(slope)
        pull = (-weight * math.cos(heading), weight * math.sin(heading))
        law = expected(drive, -0.2, 0.2, pull=pull)
        assert drive.twist() == pytest.approx(law, rel=0.02, abs=5e-3)


def test_on_too_steep_a_slope_it_slides_as_a_block_does():
    with Drive(Rover(wheel={"friction": 0.3}), 0.7, 0.5) as drive:
        before = drive.body.velocity()[0]
        drive.go(0.0, 0.0, 0.2)
        gained = np.subtract(drive.body.velocity()[0], before)
    wanted = 0.2 * G * (math.sin(0.5) - 0.3 * math.cos(0.5))
    assert np.linalg.norm(gained) == pytest.approx(wanted, rel=0.03)


# What it meets


def thing(mass, size, pose, friction):
    shape = Collision(Box(size), friction=friction)
    link = Link("l", inertia=even_inertia(mass, 0.1 * mass), collisions=(shape,))
    return Model("thing", (link,), pose=pose, static=not mass)


def test_against_a_wall_it_pushes_with_its_torque_and_stays():
    wall = thing(0.0, (0.2, 4.0, 0.4), Pose((0.5, 0.0, 0.2)), friction=0.0)
    with Drive(Rover(torque=0.5), models=[wall]) as drive:
        drive.go(0.3, 0.3, 1.5)
        place = drive.robot.pose().position
        drive.go(0.3, 0.3, 0.5)
        assert math.dist(drive.robot.pose().position, place) < 1e-5
        pressing = pressures(drive.simulation, "rover")["thing"]
    # Without friction on the wall, the floor has all of it.
    assert pressing == pytest.approx(4 * 0.5 / 0.1, rel=0.02)


@cases("mass: [0.3, 30.0]")
def test_what_it_stands_on_gets_the_opposite_of_its_friction(mass):
    plate = thing(mass, (2.0, 2.0, 0.02), Pose((0.0, 0.0, 0.01)), friction=1.0)
    with Drive(Rover(), models=[plate], friction=0.0) as drive:
        drive.robot.place(Pose((0.0, 0.0, 0.02)))
        drive.go(0.0, 0.0, 0.2)
        drive.go(0.2, 0.2, 0.6)
        under = drive.simulation.models["thing"].bodies["l"]
        own, other = drive.body.origin_velocity()[0][0], under.velocity()[0][0]
    # On ice, both together stay where they are.
    assert 10.0 * own + mass * other == pytest.approx(0.0, abs=0.02 * 10.0 * 0.2)
    assert own - other == pytest.approx(0.2, rel=0.02)


def test_little_torque_accelerates_as_newton_says():
    with Drive(Rover(torque=0.1)) as drive:
        drive.go(2.0, 2.0, 0.5)
        mass = 10.0 + 4 * 0.5 * 0.5
        assert drive.twist()[0] == pytest.approx(4 * 0.1 / 0.1 / mass * 0.5, rel=0.02)


def test_a_base_that_becomes_heavier_is_stopped_by_more_friction():
    heavy = Rover(mass=40.0, wheel_mass=2.0)
    with Drive(heavy) as wanted, Drive(Rover(wheel_mass=2.0)) as drive:
        base = heavy.model().links[0].inertia
        change_link(find_link(drive.simulation.models, "base"), base, gravity=True)
        gains = [
            [wheel.gains for wheel in one.body.traction.owners.values()] for one in (drive, wanted)
        ]
    assert gains[0] == gains[1]


# Beginning anew


def test_a_reset_gives_the_same_again():
    with Drive(Rover(centre=(0.05, 0.02, 0.1)), 0.4) as drive:
        poses = []
        for _ in range(2):
            drive.go(-0.1, 0.3, 0.3)
            poses.append(drive.robot.pose())
            drive.simulation.reset_simulation()
            for wheel in drive.wheels:
                wheel.stop()
            drive.go(0.0, 0.0, 0.2)
        assert poses[0] == poses[1]


def test_a_wheel_in_the_air_does_not_rub():
    with Drive(Rover()) as drive:
        drive.robot.place(Pose((0.0, 0.0, 1.0)))
        drive.go(0.2, -0.2, 0.3)
        assert drive.twist() == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
