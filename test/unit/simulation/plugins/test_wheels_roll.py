"""Robots as people bring them drive where they are told, and their odometry knows it."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from shared import cases
from wheeled_robots import Robot, straight, turn

# The fields of robots; friction is as small robots for Gazebo have it.
FIELDS = yaml.safe_load("""
small: &small
  wheel_tags: &soft
    <mu1>0.1</mu1><mu2>0.1</mu2><kp>500000.0</kp><kd>10.0</kd><minDepth>0.001</minDepth><maxVel>0.1</maxVel>
two casters: &two
  {<<: *small, mass: 1.4, separation: 0.29, casters: [[-0.18, 0.064], [-0.18, -0.064]]}
nothing said: {wheel_tags: '', caster_tags: ''}
balls without friction: {balls: true, caster_tags: <mu1>0</mu1><mu2>0</mu2>}
a caster ahead: {casters: [[0.08, 0.0]], centre: [0.005, 0.0, 0.02]}
heavy, very stiff: &heavy
  mass: 60.0
  radius: 0.1
  width: 0.05
  separation: 0.5
  centre: [-0.03, 0.0, 0.1]
  casters: [[-0.3, 0.1], [-0.3, -0.1]]
  wheel_tags: <kp>1e8</kp><kd>1e6</kd>
heavy, soft: {<<: *heavy, wheel_tags: <kp>1e5</kp><kd>1</kd>}
wide wheels: {<<: *small, width: 0.06}
balls for wheels: {wheel: <sphere radius="0.035"/>}
meshes for wheels: {wheel: mesh}
grip along the way: {wheel_tags: <mu1>0.2</mu1><mu2>0.8</mu2><fdir1>0 0 1</fdir1>}
no limit of acceleration: {<<: *small, acceleration: 0.0}
""")
ROBOTS = {name: Robot(**fields) for name, fields in FIELDS.items()}
SMALL, TWO_CASTERS = ROBOTS["small"], ROBOTS["two casters"]
SHORT = ("small", "a caster ahead", "heavy, very stiff", "meshes for wheels")


@pytest.mark.parametrize(
    "name", [n if n in SHORT else pytest.param(n, marks=pytest.mark.long) for n in ROBOTS]
)
def test_a_metre_straight_and_a_turn_on_the_spot(name, tmp_path):
    model = ROBOTS[name].model(tmp_path)
    way = straight(model, 0.25, heading=10.0)
    # Where meshes have corners, they bump. A caster that brakes turns the robot: in Gazebo by 8°.
    bumps = ROBOTS[name].wheel == "mesh" or name == "nothing said"
    assert abs(way.yaw) < (1.0 if bumps else 0.3)
    assert way.x == pytest.approx(way.reckoned_x, rel=0.02)
    assert way.x == pytest.approx(1.0, rel=0.03)
    assert abs(way.y) < 0.01
    spin = turn(model, 1.5)
    assert spin.yaw == pytest.approx(spin.reckoned_yaw, rel=0.02)
    assert spin.yaw == pytest.approx(360.0, rel=0.02)
    assert np.hypot(spin.x, spin.y) < 5e-3


@cases("heading: [0.0, 45.0]")
def test_friction_in_a_direction_comes_and_goes_as_the_wheel_turns(heading):
    """Where it hardly brakes, the robot slides on at its stop: figures of Gazebo 11.1.0."""
    model = replace(SMALL, wheel_tags=f"{SMALL.wheel_tags}<fdir1>1 0 0</fdir1>").model()
    way = straight(model, 0.25, heading=heading)
    assert way.x == pytest.approx(0.978, abs=0.012)
    # There 1.0 and 1.8.
    assert abs(way.yaw) < 1.8
    assert turn(model, 1.5, degrees=361.0, heading=heading).yaw == pytest.approx(375.0, abs=4.0)


@pytest.mark.long
@cases("acceleration: [0.5, 0.0, 2.0]")
def test_the_odometry_of_wheels_over_speeds_headings_and_accelerations(acceleration):
    """Statistics, for a robot whose wheels spin when it starts and slide when it stops."""
    model = replace(TWO_CASTERS, acceleration=acceleration).model()
    ways = [
        straight(model, speed, heading=heading)
        for speed, heading in ((0.1, 0.0), (0.2, 30.0), (0.3, 45.0), (-0.2, 75.0), (0.5, 160.0))
    ]
    turned = np.array([way.yaw for way in ways])
    assert np.abs(turned).max() < 1.0
    assert np.abs(np.mean(turned)) < 0.3
    short = np.array([1.0 - abs(way.x / way.reckoned_x) for way in ways])
    # What slipped at the start, the wheels drove and the robot did not; and the other way round
    # at the stop. With limits below what grips, nothing slips.
    assert np.abs(short).max() < (0.005 if acceleration == 0.5 else 0.02)
    spins = [turn(model, speed, heading=20.0) for speed in (0.5, -1.0, 2.0)]
    errors = np.array([spin.yaw / spin.reckoned_yaw - 1.0 for spin in spins])
    assert np.abs(errors).max() < 0.02


def test_a_rough_floor_does_not_make_casters_brake(tmp_path):
    """Gazebo's own floor has 100."""
    (tmp_path / "rough.world").write_text(
        '<sdf version="1.6"><world name="w"><model name="floor"><static>true</static>'
        '<link name="l"><collision name="c"><geometry><plane/></geometry><surface><friction><ode>'
        "<mu>100</mu><mu2>50</mu2></ode></friction></surface></collision></link></model>"
        "</world></sdf>"
    )
    way = straight(SMALL.model(), 0.25, world=str(tmp_path / "rough.world"))
    # Late by one period; it slides at its stop about as far as it spins at its start.
    assert way.x == pytest.approx(0.995, abs=0.005)
    assert abs(way.yaw) < 0.5
