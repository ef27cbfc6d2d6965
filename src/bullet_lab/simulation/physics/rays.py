"""Rays: how far a sensor sees, and what.

Bullet takes 3 to 10 µs for a ray that hits a box or a cylinder, for it searches the place. Here
the places are computed, for all rays of a scan at once. Only rays near a mesh are left to Bullet.
"""

from __future__ import annotations

from typing import Sequence

import numpy as np

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.physics import pybullet
from bullet_lab.simulation.physics.bodies import ROOT, Body
from bullet_lab.simulation.world.description import Collision
from bullet_lab.simulation.world.shapes import Cylinder, Mesh, Plane, Sphere

# PyBullet's limit of rays in one call.
RAYS_AT_A_TIME = 16_383
# Rays for which NumPy computes at once, not to need too much memory among many shapes.
PART = 4096
# How much larger the boxes of meshes are taken, for the margins of shapes in Bullet, in m.
MARGIN = 1e-3
# Instead of lengths and components of 0, by which one cannot divide.
LEAST = 1e-12
# By how much the cosine of a ray may be rounded.
ROUNDING = 1e-9
# The axes across which a shape is round.
ROUND = {Cylinder: (1.0, 1.0, 0.0), Sphere: (1.0, 1.0, 1.0)}
# A shape as rays see it, lengths in m: what of a box is within a cylinder or ball, or a mesh
# somewhere in the box. Its pose is that in the principal frame of its link.
TARGET = np.dtype(
    [
        ("body", int),
        ("position", float, 3),
        ("rotation", float, (3, 3)),
        # The corners of the box in the shape's frame; that of a plane is flat and endless.
        ("low", float, 3),
        ("high", float, 3),
        # 1 for each axis across which it is round, and how far.
        ("across", float, 3),
        ("radius", float),
        ("is_mesh", bool),
    ]
)


def cast(client: int, starts: Sequence, ends: Sequence) -> list[tuple]:
    """Return PyBullet's hits of rays between points (m), each (body, link, share of the way, …)."""
    found: list[tuple] = []
    for first in range(0, len(starts), RAYS_AT_A_TIME):
        part = slice(first, first + RAYS_AT_A_TIME)
        found += pybullet.rayTestBatch(starts[part], ends[part], physicsClientId=client)
    return found


class RayScene:
    """What rays can hit: the shapes of bodies, where they are at one moment.

    Arrays have a column for each shape. Results come without matrix libraries, which give other
    last bits on other processors.
    """

    def __init__(self, client: int):
        self._client = client
        # For each body, PyBullet's indices of its links with shapes, and these shapes.
        self._bodies: dict[Body, list[tuple[int, np.ndarray]]] = {}
        self._is_whole = self._is_current = False

    def add(self, body: Body) -> None:
        """Let rays see a body; raises LabError if one of its meshes cannot be read."""
        self._bodies[body] = [
            (index, _targets(body, link.shapes, link.mass_properties()[2]))
            for index, link in enumerate(body.bullet_links, ROOT)
            if link.shapes
        ]
        self._is_whole = self._is_current = False

    def remove(self, body: Body) -> None:
        """Let rays see a body no longer."""
        del self._bodies[body]
        self._is_whole = self._is_current = False

    def moved(self) -> None:
        """Look for the bodies' places anew before the next rays."""
        self._is_current = False

    def cast(
        self, origin: np.ndarray, ways: np.ndarray, nearest: float, farthest: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Cast rays from one point; none of them sees a shape that contains its start.

        Args:
            origin: of the rays in the world in m, shape (3,).
            ways: unit vectors of the rays in the world, shape (rays, 3).
            nearest: distance in m from the origin at which the rays start.
            farthest: distance at which they end.

        Returns:
            The distance of what each ray hits from the origin in m, infinite without a hit, and
            the unique id of the body there, -1 without a hit; each of shape (rays,).
        """
        if not self._is_current:
            self._update()
        distances, bodies = np.full(len(ways), np.inf), np.full(len(ways), -1)
        for first in range(0, len(ways), PART):
            some = ways[first : first + PART]
            rays, shapes, start = self._candidates(origin, some, farthest)
            enters, leaves = self._crossings(start[:, shapes], some[rays].T, shapes)
            crossed = (enters <= leaves) & (enters <= farthest) & (leaves >= nearest)
            is_mesh = self._is_mesh[shapes]
            seen = np.flatnonzero(crossed & ~is_mesh & (enters > nearest))
            # From the farthest on, so that the nearest of a ray is written last.
            seen = seen[np.argsort(-enters[seen], kind="stable")]
            distances[first + rays[seen]] = enters[seen]
            bodies[first + rays[seen]] = self._body[shapes[seen]]
            meshed = first + np.unique(rays[crossed & is_mesh])
            starts, ends = (origin + limit * ways[meshed] for limit in (nearest, farthest))
            found = cast(self._client, starts.tolist(), ends.tolist())
            for ray, (body, _, share, *_) in zip(meshed, found):
                distance = nearest + share * (farthest - nearest)
                if body >= 0 and distance < distances[ray]:
                    distances[ray], bodies[ray] = distance, body
        return distances, bodies

    def _candidates(
        self, origin: np.ndarray, ways: np.ndarray, farthest: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pairs of rays and shapes that they may hit, and the origin in the shapes' frames.

        Such a ray is in the cone around the corners of the shape's box.
        """
        origin = origin[:, None]
        start = np.sum(self._rotations * (origin - self._positions)[:, None], axis=0)
        axes = self._middles - origin
        lengths = _norm(axes)
        axes /= np.maximum(lengths, LEAST)
        corners = self._corners - origin[:, None]
        cosines = np.sum(corners * axes[:, None], axis=0) / np.maximum(_norm(corners), LEAST)
        least = np.min(cosines, axis=0) - ROUNDING
        # A cone of more than a half space would not contain the rest of the box.
        least[least <= 0.0] = -2.0
        planes = self._planes
        heights = start[2, planes]
        axes[:, planes] = -np.sign(heights) * self._rotations[:, 2, planes]
        least[planes] = np.abs(heights) / farthest - ROUNDING
        seen = np.flatnonzero((lengths - self._reach <= farthest) & ~self._contain(start))
        rays, places = np.nonzero(ways @ axes[:, seen] >= least[seen])
        return rays, seen[places], start

    def _contain(self, points: np.ndarray) -> np.ndarray:
        """Return which shapes other than meshes contain points in their frames (m), (3, shapes)."""
        inside = np.all((self._low < points) & (points < self._high), axis=0)
        is_round = self._radius > 0.0
        apart = np.sum(self._across * points * points, axis=0)
        return inside & ~self._is_mesh & (~is_round | (apart < self._radius**2))

    def _crossings(
        self, start: np.ndarray, ways: np.ndarray, shapes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances (m) at which rays enter and leave shapes, one shape for each ray.

        A ray that misses its shape enters after it leaves.

        Args:
            start: of each ray in its shape's frame in m, (3, rays).
            ways: of the rays in the world, (3, rays).
            shapes: the shapes' numbers, (rays,).
        """
        local = np.array([sum(self._rotations[:, axis, shapes] * ways) for axis in range(3)])
        divisors = np.where(np.abs(local) < LEAST, LEAST, local)
        # The box is where three slabs meet.
        low = (self._low[:, shapes] - start) / divisors
        high = (self._high[:, shapes] - start) / divisors
        enters, leaves = np.minimum(low, high).max(axis=0), np.maximum(low, high).min(axis=0)
        # The cylinder or ball is where |start + t local|² <= radius², across its axis.
        curved = np.flatnonzero((self._radius[shapes] > 0.0) & (enters <= leaves))
        across, start, local = self._across[:, shapes[curved]], start[:, curved], local[:, curved]
        square = np.maximum(sum(across * local * local), LEAST * LEAST)
        half = sum(across * start * local)
        rest = sum(across * start * start) - self._radius[shapes[curved]] ** 2
        root = half * half - square * rest
        root[root < 0.0] = np.nan
        root = np.sqrt(root)
        enters[curved] = np.maximum(enters[curved], (-half - root) / square)
        leaves[curved] = np.minimum(leaves[curved], (-half + root) / square)
        return enters, leaves

    def _update(self) -> None:
        """Find out where the shapes are now."""
        if not self._is_whole:
            self._join()
        places = [body.link_place(index) for body, index in self._links]
        positions = np.array([position for position, _ in places]).reshape(-1, 3)
        turns = np.array([quaternion for _, quaternion in places]).reshape(-1, 4)
        links = _rotations(turns)[:, :, self._link]
        self._rotations = np.sum(links[:, :, None] * self._turns, axis=1)
        self._positions = positions.T[:, self._link] + _turned(links, self._places)
        self._middles = self._positions + _turned(self._rotations, self._middle)
        corners = np.sum(self._rotations[:, :, None] * self._box_corners, axis=1)
        self._corners = self._positions[:, None] + corners
        self._is_current = True

    def _join(self) -> None:
        """Put the shapes of all bodies into one table."""
        self._links = [(body, index) for body, links in self._bodies.items() for index, _ in links]
        tables = [table for links in self._bodies.values() for _, table in links]
        self._link = np.repeat(np.arange(len(tables)), [len(table) for table in tables])
        shapes = np.concatenate([np.zeros(0, TARGET), *tables])
        columns = {
            name: np.ascontiguousarray(np.moveaxis(shapes[name], 0, -1)) for name in TARGET.names
        }
        self._body, self._is_mesh = columns["body"], columns["is_mesh"]
        self._across, self._radius = columns["across"], columns["radius"]
        self._places, self._turns = columns["position"], columns["rotation"]
        self._low, self._high = low, high = columns["low"], columns["high"]
        self._planes = np.flatnonzero(np.isinf(low[0]))
        ends = np.where(np.isinf((low, high)), 0.0, (low, high))
        self._box_corners = np.array(
            [[ends[pick[axis]][axis] for pick in np.ndindex(2, 2, 2)] for axis in range(3)]
        )
        self._middle = 0.5 * (ends[0] + ends[1])
        self._reach = _norm(high - self._middle)
        self._is_whole = True


def _targets(body: Body, shapes: Sequence[Collision], principal: Pose) -> np.ndarray:
    """Return the shapes of a link with a principal frame as rays see them."""
    found = np.zeros(len(shapes), TARGET)
    found["body"] = body.unique_id
    for target, shape in zip(found, shapes):
        geometry, pose = shape.geometry, principal.inverse() * shape.pose
        low, high = geometry.bounds()
        if isinstance(geometry, Plane):
            pose = pose * _standing(geometry.normal)
            low[2] = high[2] = 0.0
        elif isinstance(geometry, Mesh):
            target["is_mesh"], low, high = True, low - MARGIN, high + MARGIN
        target["position"], target["rotation"] = pose.position, pose.rotation_matrix()
        target["low"], target["high"] = low, high
        target["across"] = ROUND.get(type(geometry), (0.0, 0.0, 0.0))
        target["radius"] = getattr(geometry, "radius", 0.0)
    return found


def _standing(normal: Sequence[float]) -> Pose:
    """Return a frame whose z axis is along a vector."""
    up = np.asarray(normal) / np.linalg.norm(normal)
    side = np.cross(np.eye(3)[np.argmin(np.abs(up))], up)
    side /= np.linalg.norm(side)
    return Pose.from_matrix((0.0, 0.0, 0.0), np.column_stack((side, np.cross(up, side), up)))


def _rotations(quaternions: np.ndarray) -> np.ndarray:
    """Return the rotation matrices (3, 3, n) of unit quaternions x, y, z, w, (n, 4)."""
    x, y, z, w = quaternions.T
    return np.array(
        (
            (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
            (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
            (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
        )
    )


def _turned(rotations: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return vectors (3, n), each turned by its matrix (3, 3, n)."""
    return np.sum(rotations * vectors, axis=1)


def _norm(vectors: np.ndarray) -> np.ndarray:
    """Return the lengths of vectors (3, …)."""
    return np.sqrt(np.sum(vectors * vectors, axis=0))
