"""The tricycle drive, on a tricycle written anew."""

import math
from dataclasses import replace

import pytest
from sensor_worlds import drive, record
from shared import cases

from bullet_lab.simulation.world.urdf import read_urdf_file

LENGTH = 0.6


@pytest.fixture
def tricycle(world, package):
    """Put the tricycle with some tags changed into the world."""
    model = read_urdf_file(package / "test/drives/tricycle.urdf")

    def add(**tags):
        (plugin,) = model.plugins
        robot = world.add(replace(model, plugins=(replace(plugin, tags={**plugin.tags, **tags}),)))
        world.run_for(0.2)
        return robot

    return add


@cases("source: [encoder, world]")
def test_it_drives_a_metre(world, tricycle, source):
    robot = tricycle(odometrySource=source)
    odometry = record(robot, "odom")
    driven = drive(world, robot, 4.0, 0.25)
    # The grip of the front wheel, with a third of the load, speeds it up.
    assert driven.position[:2] == pytest.approx((1.0, 0.0), abs=0.02)
    assert odometry[-1].pose.position[:2] == pytest.approx(driven.position[:2], abs=3e-3)
    assert odometry[-1].velocity.vx == pytest.approx(0.25, rel=0.02)
    assert (odometry[-1].frame, odometry[-1].child_frame) == ("odom", "base_link")
    assert odometry[-1].pose_variances == (1e-5, 1e-5, 1e12, 1e12, 1e12, 1e-3)


@cases("angle: [-0.5, 0.2, 0.9]")
def test_the_radius_of_the_circle_is_that_of_the_steering_angle(world, tricycle, angle):
    robot = tricycle()
    odometry = record(robot, "odom")
    driven = drive(world, robot, 3.0, 0.2, angle)
    x, y, _ = driven.position
    # The front wheel has the commanded speed; the middle of the rear axle is slower.
    radius = math.hypot(x, y) / (2.0 * math.sin(0.5 * driven.yaw))
    assert radius == pytest.approx(LENGTH / math.tan(angle), rel=0.02)
    assert radius * driven.yaw == pytest.approx(0.6 * math.cos(angle), rel=0.03)
    assert odometry[-1].pose.position[:2] == pytest.approx((x, y), abs=0.01)
    assert odometry[-1].pose.yaw == pytest.approx(driven.yaw, rel=0.03)
