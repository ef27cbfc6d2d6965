"""Systematic errors that differ from path to path, and their covariance."""

import numpy as np
import pytest

from bullet_lab.noise.systematic import (
    SpreadPath,
    SystematicErrors,
    SystematicPath,
    SystematicSpread,
    chords,
)

ERRORS = SystematicErrors(0.01, -0.02, 0.005, 0.01, 0.4, 0.05)
SPREAD = SystematicSpread(0.01, 0.02, 0.004, 0.01, 0.02)


def bend():
    """A quarter of a circle."""
    arcs = chords(np.tile([0.1, 0.0, 0.05], (30, 1)))
    poses = [(0.0, 0.0, 0.0)]
    for dx, dy, turn in arcs.tolist():
        x, y, yaw = poses[-1]
        cos, sin = np.cos(yaw), np.sin(yaw)
        poses.append((x + cos * dx - sin * dy, y + sin * dx + cos * dy, yaw + turn))
    return poses


def end(path):
    path.restart()
    for pose in bend():
        step = path.update(*pose)
    return step.pose


def test_the_covariance_is_that_of_many_paths():
    path = SpreadPath(ERRORS, SPREAD, seed=3)
    ends = np.array([end(path) for _ in range(1500)])
    seen, said = np.cov(ends.T), path.covariance
    scale = np.sqrt(np.diagonal(said))
    # 1500 paths determine a variance to 3.7 %.
    size = np.outer(scale, scale)
    np.testing.assert_allclose(seen / size, said / size, atol=0.15)
    np.testing.assert_allclose(ends.mean(axis=0), end(SystematicPath(ERRORS)), atol=0.15)


def test_without_spread_it_is_the_systematic_path_bit_for_bit():
    path = SpreadPath(ERRORS, SystematicSpread(), seed=3)
    assert end(path) == end(SystematicPath(ERRORS))
    assert not path.covariance.any()


@pytest.mark.parametrize("seeds, same", [((4, 4), True), ((4, 5), False)])
def test_the_seed_decides_the_errors(seeds, same):
    one, other = (end(SpreadPath(ERRORS, SPREAD, seed)) for seed in seeds)
    assert (one == other) is same
