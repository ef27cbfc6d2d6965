"""Mass, centre of mass and inertia of rigid bodies."""

from __future__ import annotations

from typing import Sequence, Tuple

import numpy as np

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.world.description import Inertia
from bullet_lab.simulation.world.xml import XmlError

# Rounded figures in a file miss the limits of what is physical by this much at most.
RELATIVE_TOLERANCE = 1e-3


class InertiaError(XmlError):
    """No rigid body has such a mass or inertia."""


def matrix_from_elements(
    ixx: float, iyy: float, izz: float, ixy: float = 0.0, ixz: float = 0.0, iyz: float = 0.0
) -> np.ndarray:
    """Return the 3x3 inertia matrix in kg m²."""
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]], dtype=float)


def check_inertia(inertia: Inertia, where: str) -> None:
    """Refuse what no rigid body can have.

    Principal moments are positive and none exceeds the sum of the other two (each is an
    integral of two squared coordinates). A mass of zero is allowed: it means "no inertia".

    Raises:
        InertiaError: negative mass or an impossible inertia; `where` names the link.
    """
    if inertia.mass < 0.0:
        raise InertiaError(f"{where}: the mass {inertia.mass:g} kg is negative")
    if inertia.mass == 0.0:
        return
    low, middle, high = np.linalg.eigvalsh(inertia.matrix)
    if low <= 0.0 or high > (low + middle) * (1.0 + RELATIVE_TOLERANCE):
        moments = ", ".join(f"{value:.3g}" for value in (low, middle, high))
        raise InertiaError(f"{where}: no body has the principal moments {moments} kg m²")


def combine(parts: Sequence[Tuple[Inertia, Pose]]) -> Inertia:
    """Return the inertia of several bodies that are fixed to each other.

    Args:
        parts: each body's inertia and the pose of its frame in the common one.

    Uses the parallel axis theorem about the common centre of mass.
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

    Args:
        inertia: of the body, with a mass.
        axis: a unit vector in the axes of the inertia.
        turning: whether it is a torque.
    """
    if not turning:
        return 1.0 / inertia.mass
    return float(np.dot(axis, np.linalg.solve(inertia.matrix, axis)))


def principal_axes(inertia: Inertia) -> Tuple[Tuple[float, float, float], Pose]:
    """Return the principal moments and the pose of the principal frame in the link's frame.

    An inertia that is diagonal already keeps the axes of the link.
    """
    matrix = inertia.matrix
    off_diagonal = matrix - np.diag(np.diag(matrix))
    if np.abs(off_diagonal).max() <= 1e-9 * np.abs(matrix).max():
        return tuple(float(value) for value in np.diag(matrix)), Pose(inertia.centre)
    moments, axes = np.linalg.eigh(matrix)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    return tuple(float(value) for value in moments), Pose.from_matrix(inertia.centre, axes)
