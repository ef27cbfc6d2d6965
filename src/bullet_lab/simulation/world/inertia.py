"""Compute masses and inertias of rigid bodies."""

from __future__ import annotations

from typing import Sequence, Tuple

import numpy as np

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.world.description import Inertia

INERTIA_KEYS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
# The limits of simulated models: m.
FARTHEST = 1e6
# m/s and rad/s.
FASTEST = 1e6
# kg.
HEAVIEST = 1e12


def matrix_from_elements(
    ixx: float, iyy: float, izz: float, ixy: float = 0.0, ixz: float = 0.0, iyz: float = 0.0
) -> np.ndarray:
    """Return the 3x3 inertia matrix in kg m².

    >>> matrix_from_elements(1.0, 2.0, 3.0, ixy=0.5).tolist()
    [[1.0, 0.5, 0.0], [0.5, 2.0, 0.0], [0.0, 0.0, 3.0]]
    """
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]], dtype=float)


def inertia_at(pose: Pose, mass: float, elements: Sequence[float]) -> Inertia:
    """Return the inertia of a link from that in another frame.

    Args:
        pose: of that frame in the link's frame; its origin is the centre of mass.
        mass: kg.
        elements: in kg m², in the order of INERTIA_KEYS.
    """
    turn = pose.rotation_matrix()
    return Inertia(mass, pose.position, turn @ matrix_from_elements(*elements) @ turn.T)


def combine(parts: Sequence[Tuple[Inertia, Pose]]) -> Inertia:
    """Return the inertia of bodies fixed to each other, by the parallel axis theorem.

    `parts` holds each body's inertia and the pose of its frame in the common one.

    >>> ball = Inertia(1.0, (0.0, 0.0, 0.0), np.eye(3))
    >>> both = combine([(ball, Pose((-2.0, 0.0, 0.0))), (ball, Pose((2.0, 0.0, 0.0)))])
    >>> both.mass, both.centre, both.matrix.diagonal().tolist()
    (2.0, (0.0, 0.0, 0.0), [2.0, 10.0, 10.0])
    """
    mass = sum(inertia.mass for inertia, _ in parts)
    centres = [np.array((pose * Pose(inertia.centre)).position) for inertia, pose in parts]
    weights = [inertia.mass for inertia, _ in parts]
    centre = np.average(centres, axis=0, weights=weights) if mass > 0.0 else np.mean(centres, 0)
    matrix = np.zeros((3, 3))
    for (inertia, pose), own_centre in zip(parts, centres):
        turn = pose.rotation_matrix()
        arm = own_centre - centre
        steiner = inertia.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        matrix += turn @ inertia.matrix @ turn.T + steiner
    return Inertia(float(mass), tuple(float(value) for value in centre), matrix)


def mobility(inertia: Inertia, axis: Vector, turning: bool) -> float:
    """Return the acceleration of a free body per torque about an axis, or per force along it.

    The axis is a unit vector in the axes of the inertia, which has a mass.
    """
    if not turning:
        return 1.0 / inertia.mass
    return float(np.dot(axis, np.linalg.solve(inertia.matrix, axis)))


def principal_axes(inertia: Inertia) -> Tuple[Tuple[float, float, float], Pose]:
    """Return the principal moments and the pose of the principal frame in the link's frame.

    A diagonal inertia keeps the axes of the link.
    """
    matrix = inertia.matrix
    off_diagonal = matrix - np.diag(np.diag(matrix))
    if np.abs(off_diagonal).max() <= 1e-9 * np.abs(matrix).max():
        return tuple(float(value) for value in np.diag(matrix)), Pose(inertia.centre)
    moments, axes = np.linalg.eigh(matrix)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    return tuple(float(value) for value in moments), Pose.from_matrix(inertia.centre, axes)
