import math

import numpy as np

from bullet_lab.core import se2


def random_poses(*shape):
    return np.random.default_rng(3).uniform(-3.0, 3.0, (*shape, 3))


def matrix(pose):
    x, y, yaw = pose
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.array([[cos, -sin, x], [sin, cos, y], [0.0, 0.0, 1.0]])


def test_compose_is_the_product_of_the_matrices():
    for a, b in random_poses(20, 2):
        np.testing.assert_allclose(matrix(se2.compose(a, b)), matrix(a) @ matrix(b), atol=1e-12)


def test_between_undoes_compose():
    a, b = random_poses(2, 50)
    np.testing.assert_allclose(se2.between(a, se2.compose(a, b)), b, atol=1e-12)


def test_inverse_leads_back_to_the_origin():
    poses = random_poses(50)
    np.testing.assert_allclose(se2.compose(poses, se2.inverse(poses)), 0.0, atol=1e-12)


def test_yaw_is_wrapped():
    assert se2.compose([0, 0, 3.0], [0, 0, 3.0])[2] == 6.0 - 2 * math.pi
    assert se2.between([0, 0, -3.0], [0, 0, 3.0])[2] == 6.0 - 2 * math.pi


def test_leading_axes_broadcast():
    paths = random_poses(4, 7)
    moved = se2.compose([1.0, 2.0, 0.5], paths)
    assert moved.shape == (4, 7, 3)
    np.testing.assert_allclose(moved[2, 3], se2.compose([1.0, 2.0, 0.5], paths[2, 3]))
    assert se2.compose(paths, [1.0, 0.0, 0.0]).shape == (4, 7, 3)


def test_steps_lead_along_the_path():
    paths = random_poses(4, 7)
    moves = se2.steps(paths)
    assert moves.shape == (4, 6, 3)
    np.testing.assert_allclose(se2.compose(paths[:, :-1], moves), paths[:, 1:], atol=1e-12)
