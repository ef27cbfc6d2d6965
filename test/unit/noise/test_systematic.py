"""Systematic errors: those of wheels that are not what the odometry believes, and their spread."""

import math

import numpy as np
import pytest
from noise_paths import drive, line, played, reported, wandering
from numpy.testing import assert_allclose
from shared import cases

from bullet_lab.core import se2
from bullet_lab.core.se2 import wrap
from bullet_lab.noise.systematic import (
    SpreadPath,
    SystematicErrors,
    SystematicPath,
    SystematicSpread,
    chords,
    end_of,
)
from bullet_lab.simulation.plugins.wheel_drives import DeadReckoning

BASE = 0.38
ALL = SystematicErrors(0.02, -0.03, 0.01, 0.004, BASE, 0.05)


def reckoned(angles, left, right, base):
    """Poses by the angles (rad) of wheels with these radii (m), shape (n, 3)."""
    reckoning = DeadReckoning(base, 1.0)
    poses = [reckoning.pose]
    for angle_left, angle_right in angles:
        reckoning.advance(left * angle_left, right * angle_right)
        poses.append(reckoning.pose)
    return np.array(poses)


@cases("ticks: [0.0, 90.0, 5000.0]")
@cases("scale, base, diameter: [[0.0, 0.01, 0.002], [-0.02, -0.03, -0.01]]")
def test_they_are_what_encoder_odometry_makes_of_wrong_wheels(scale, base, diameter, ticks):
    angles = np.cumsum(np.random.default_rng(1).normal(0.3, 1.0, (300, 2)), axis=0)
    radius = 0.14
    mean = radius * (1.0 + scale)
    left, right = mean / (1.0 + 0.5 * diameter), mean * (1.0 + diameter) / (1.0 + 0.5 * diameter)
    true = reckoned(angles, left, right, BASE * (1.0 + base))
    counted = np.floor(radius * angles * ticks) / (radius * ticks) if ticks else angles
    believed = reckoned(counted, radius, radius, BASE)
    errors = SystematicErrors(scale, base, diameter, wheel_base=BASE, ticks_per_metre=ticks)
    difference = errors.path(true) - believed
    assert np.abs(difference[:, :2]).max() < 1e-11
    assert np.abs(wrap(difference[:, 2])).max() < 1e-11


def test_a_gyro_drifts_on_either_way():
    there = line(4.0, 80)
    poses = np.concatenate((there, there[-2::-1]))
    made = SystematicErrors(gyro_bias_per_metre=0.01).path(poses)
    assert made[-1, 2] == pytest.approx(0.08)


def test_without_errors_a_path_comes_back_to_the_bit():
    poses = wandering()
    poses[5, 2] = math.pi
    assert np.array_equal(SystematicErrors().path(poses), poses)


def test_whole_paths_and_pose_by_pose_agree():
    poses, path = wandering(), SystematicPath(ALL)
    first, steps = [], []
    for every in (first, steps):
        path.restart()
        every += played(path, poses)
    assert steps == first
    assert np.array_equal(ALL.path(poses), reported(steps))
    true, made = se2.steps(poses), ALL.steps(se2.steps(poses))
    errors = [step.motion_error for step in steps[1:]]
    assert_allclose(made - true, errors, rtol=0.0, atol=1e-14)
    composed = se2.compose(poses[0], end_of(made))
    assert_allclose(composed[:2], steps[-1].pose[:2], rtol=0.0, atol=1e-12)


SPREAD = SystematicSpread(0.01, 0.02, 0.004, 0.01, 0.02)
# A quarter of a circle.
BEND = drive((0.0, 0.0, 0.0), (10, chords((0.3, 0.0, 0.15))))


def end(path):
    path.restart()
    return played(path, BEND)[-1].pose


def test_the_covariance_is_that_of_many_paths():
    path = SpreadPath(ALL, SPREAD, seed=3)
    ends = np.array([end(path) for _ in range(1500)])
    scale = np.sqrt(np.diagonal(path.covariance))
    # 1500 paths determine a variance to 3.7 %.
    size = np.outer(scale, scale)
    assert_allclose(np.cov(ends.T) / size, path.covariance / size, atol=0.15)
    assert_allclose(ends.mean(axis=0), end(SystematicPath(ALL)), atol=0.15)


def test_without_spread_it_is_the_systematic_path_bit_for_bit():
    path = SpreadPath(ALL, SystematicSpread(), seed=3)
    assert end(path) == end(SystematicPath(ALL))
    assert not path.covariance.any()
