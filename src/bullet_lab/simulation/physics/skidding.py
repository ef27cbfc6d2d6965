"""Which wheels steer a body by slipping, and how easily friction moves them.

Wheels on axles that stay parallel, and are not one axle, cannot all roll where the body turns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.pose import Pose, Vector, cross, subtract
from bullet_lab.simulation.physics.surfaces import ALIGNED, NEAR, axle_of, cosine
from bullet_lab.simulation.world.description import Collision, Joint, Link
from bullet_lab.simulation.world.meshes import hull_corners
from bullet_lab.simulation.world.shapes import Cylinder, Mesh, Sphere

# Cosines of an axis with the vertical: of an axle at most, and of what steers a wheel at least.
LEVEL = 0.3
UPRIGHT = 0.7
# By what share of its radius a mesh may be out of round.
ROUND = 0.05
# A wheel's inertia is at least that of such a share of what it carries, at its rim: friction in
# a single step would set a lighter one spinning.
LEAST_RIM = 0.05
# In m/s²; in m and m/s: how deep and how fast a hard wheel sinks in under its load.
GRAVITY = 9.8
SINKING = 2e-5
SINKING_SPEED = 0.02
UP = np.array((0.0, 0.0, 1.0))


@dataclass(frozen=True)
class SkiddingWheel:
    """A wheel: the name of its link, in that link's axes the axle, and the radius in m."""

    link: str
    axle: Vector
    radius: float


def skidding_wheels(links: Sequence[Link], joints: Sequence[Joint]) -> List[SkiddingWheel]:
    """Return the wheels of a body that slip sideways as it turns, in the order of its links.

    Those are wheels that nothing steers, on level axles that are parallel and apart.

    Args:
        links: of the body, with their poses in a frame whose z axis points up.
        joints: between them.
    """
    above = {joint.child: joint for joint in joints}
    poses = {link.name: link.pose for link in links}
    found = []
    for link in links:
        joint = above.get(link.name)
        if joint is None or not _turns_freely(joint) or _steered(joint, above, poses):
            continue
        radius = max((_radius(shape, joint) for shape in link.collisions), default=0.0)
        axle = link.pose.rotate(joint.axis)
        if radius > 0.0 and abs(axle[2]) < LEVEL:
            hub = (link.pose * Pose(joint.anchor)).position
            found.append((hub, axle, SkiddingWheel(link.name, joint.axis, radius)))
    apart = {
        wheel
        for (place, one, first), (other_place, other, second) in combinations(found, 2)
        if abs(cosine(one, other)) > ALIGNED
        and math.hypot(*cross(subtract(other_place, place), one)) > NEAR
        for wheel in (first, second)
    }
    return [wheel for _, _, wheel in found if wheel in apart]


def _turns_freely(joint: Joint) -> bool:
    if axle_of(joint) is None:
        return False
    least, most = joint.limits.get("lower", -math.inf), joint.limits.get("upper", math.inf)
    return joint.kind == "continuous" or not 0.0 <= most - least <= math.tau


def _steered(joint: Joint, above: Dict[str, Joint], poses: Dict[str, Pose]) -> bool:
    """Return whether what carries a joint can turn about the vertical."""
    while joint.parent in above:
        joint = above[joint.parent]
        axis = poses[joint.child].rotate(joint.axis)
        if joint.kind == "ball" or (axle_of(joint) and abs(axis[2]) > UPRIGHT):
            return True
    return False


def _radius(shape: Collision, joint: Joint) -> float:
    """Return the radius of a shape that is round about a joint's axis; 0 for one that is not."""
    geometry, axis = shape.geometry, joint.axis
    if isinstance(geometry, Mesh):
        return _radius_of_mesh(geometry, shape.pose, joint)
    if not isinstance(geometry, (Cylinder, Sphere)):
        return 0.0
    off = math.hypot(*cross(subtract(shape.pose.position, joint.anchor), axis))
    aslant = abs(cosine(shape.pose.rotate((0.0, 0.0, 1.0)), axis)) < ALIGNED
    return 0.0 if off > NEAR or (aslant and isinstance(geometry, Cylinder)) else geometry.radius


def _radius_of_mesh(mesh: Mesh, pose: Pose, joint: Joint) -> float:
    corners = hull_corners(mesh) @ pose.rotation_matrix().T
    _, _, (_, *across) = np.linalg.svd(np.array([joint.axis]))
    places = (corners + np.subtract(pose.position, joint.anchor)) @ np.transpose(across)
    reaches = np.abs([places.min(axis=0), places.max(axis=0)])
    return float(reaches.max()) if np.ptp(reaches) < ROUND * reaches.max() else 0.0


def fit_for_skidding(links: Sequence[Link], wheels: Sequence[SkiddingWheel]) -> List[Link]:
    """Return links whose wheels are no lighter than LEAST_RIM says, and none is hard.

    How hard wheels share the load of a body is undetermined, and left to the engine's solver; on
    springs, what each carries follows from where it is.
    """
    load = sum(link.inertia.mass for link in links if link.inertia is not None) / len(wheels)
    spring = {"stiffness": load * GRAVITY / SINKING, "damping": load * GRAVITY / SINKING_SPEED}
    by_name = {wheel.link: wheel for wheel in wheels}

    def fit(link: Link) -> Link:
        wheel = by_name.get(link.name)
        if wheel is None or link.inertia is None:
            return link
        lacking = LEAST_RIM * load * wheel.radius**2 - wheel.axle @ link.inertia.matrix @ wheel.axle
        matrix = link.inertia.matrix + max(0.0, lacking) * np.eye(3)
        shapes = tuple(
            replace(shape, **spring) if shape.stiffness is shape.damping is None else shape
            for shape in link.collisions
        )
        inertia = replace(link.inertia, matrix=matrix)
        return replace(link, inertia=inertia, collisions=shapes)

    return [fit(link) for link in links]


def wheel_mobility(
    links: Sequence[Link], joints: Sequence[Joint], wheels: Sequence[SkiddingWheel]
) -> np.ndarray:
    """Return how easily friction moves the points where wheels touch the floor.

    The matrix J M⁻¹ Jᵀ, of shape (2n, 2n) and in 1/kg, takes impulses along the way and along the
    axle of each wheel to the changes of velocity there. The body, of inertia M, is free in space
    and its joints, which are at zero, are loose.
    """
    poses = {link.name: link.pose for link in links}
    columns, count = _columns(links, joints)
    inertia = np.zeros((count, count))
    for link in links:
        if link.inertia is not None:
            centre = np.array((link.pose * Pose(link.inertia.centre)).position)
            linear, angular = _jacobian(centre, columns[link.name], count)
            turn = link.pose.rotation_matrix().T @ angular
            inertia += link.inertia.mass * linear.T @ linear + turn.T @ link.inertia.matrix @ turn
    rows = []
    for wheel in wheels:
        axle = np.array(poses[wheel.link].rotate(wheel.axle))
        way = np.cross(axle, UP) / np.linalg.norm(np.cross(axle, UP))
        hub = next(place for _, axis, place in reversed(columns[wheel.link]) if place is not None)
        linear, _ = _jacobian(hub - wheel.radius * np.cross(way, axle), columns[wheel.link], count)
        rows += [way @ linear, axle @ linear]
    touch = np.array(rows)
    # Parts without inertia of their own make no difference to what carries them.
    return touch @ np.linalg.pinv(inertia, hermitian=True) @ touch.T


# A joint's motions: a column of a Jacobian, the axis, and a place on it where it turns.
Columns = List[Tuple[int, np.ndarray, Optional[np.ndarray]]]


def _columns(links: Sequence[Link], joints: Sequence[Joint]) -> Tuple[Dict[str, Columns], int]:
    """Return the motions that move each link, and how many there are with the six of the root."""
    above = {joint.child: joint for joint in joints}
    columns: Dict[str, Columns] = {}
    count = 6
    for link in links:
        joint = above.get(link.name)
        if joint is None:
            columns[link.name] = []
            continue
        place = np.array((link.pose * Pose(joint.anchor)).position)
        turn = link.pose.rotation_matrix()
        axes = {"ball": turn.T, "fixed": ()}.get(joint.kind, [turn @ joint.axis])
        at = None if joint.kind == "prismatic" else place
        own = [(count + number, axis, at) for number, axis in enumerate(axes)]
        columns[link.name] = columns[joint.parent] + own
        count += len(own)
    return columns, count


def _jacobian(place: np.ndarray, columns: Columns, count: int) -> Tuple[np.ndarray, np.ndarray]:
    """Return what motions do to a place of a link: matrices (3, count), linear and angular."""
    linear, angular = np.zeros((3, count)), np.zeros((3, count))
    linear[:, :3] = angular[:, 3:6] = np.eye(3)
    linear[:, 3:6] = np.cross(np.eye(3), place).T
    for number, axis, at in columns:
        linear[:, number] = axis if at is None else np.cross(axis, place - at)
        if at is not None:
            angular[:, number] = axis
    return linear, angular
