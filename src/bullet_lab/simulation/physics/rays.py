"""Rays: how far a sensor sees, and what.

Bullet takes 3 to 10 µs for a ray that hits a box or a cylinder, for it searches the place. Here
the places are computed, for all rays of a scan at once. Only rays near a mesh are left to Bullet.
"""

from __future__ import annotations

from typing import Any, Callable, NamedTuple, Sequence, Tuple

import numpy as np
from numpy import ndarray

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.physics import pybullet
from bullet_lab.simulation.physics.bodies import ROOT, Body, BulletLink
from bullet_lab.simulation.world.shapes import Box, Cylinder, Plane, Sphere

# PyBullet's limit of rays in one call.
RAYS_AT_A_TIME = 16_383
# Rays for which NumPy computes at once, not to need too much memory among many shapes.
PART = 4096
# Of so few rays, Bullet finds faster what they hit.
FEW = 16
# Of the rays of a fan: the distance (m) of what each hits from the origin, infinite without a hit,
# and the unique id of the body there, -1 without a hit; both of shape (rays,).
Hits = Tuple[ndarray, ndarray]
# How much larger the boxes of meshes are taken, for the margins of shapes in Bullet, in m.
MARGIN = 1e-3
# Instead of lengths and components of 0, by which one cannot divide.
LEAST = 1e-12
# By how much the cosine of a ray may be rounded.
ROUNDING = 1e-9
# The axes across which a shape is round, of shapes that are not left to Bullet.
ANGULAR = (0.0, 0.0, 0.0)
COMPUTED = {
    Box: ANGULAR,
    Plane: ANGULAR,
    Cylinder: (1.0, 1.0, 0.0),
    Sphere: (1.0, 1.0, 1.0),
}
# A shape as rays see it, lengths in m: what of a box is within a cylinder or ball, or a shape
# somewhere in the box that is left to Bullet. Its pose is in the principal frame of its link.
TARGET = np.dtype(
    [
        ("body", int),
        ("position", float, 3),
        ("rotation", float, (3, 3)),
        # The corners of the box in the shape's frame; that of a plane is flat and endless.
        ("low", float, 3),
        ("high", float, 3),
        # 1 for each axis across which it is round, and how far; infinite if it is not round.
        ("across", float, 3),
        ("radius", float),
        ("by_bullet", bool),
    ]
)


def cast(client: int, starts: Sequence, ends: Sequence) -> list[tuple]:
    """Return PyBullet's hits of rays between points (m), each (body, link, share of the way, …)."""
    found: list[tuple] = []
    for first in range(0, len(starts), RAYS_AT_A_TIME):
        part = slice(first, first + RAYS_AT_A_TIME)
        found += pybullet.rayTestBatch(starts[part], ends[part], physicsClientId=client)
    return found


class Fan(NamedTuple):
    """Rays from one point; none of them sees a shape that contains its start.

    Attributes:
        origin: of the rays in the world in m, shape (3,).
        ways: unit vectors of the rays in the world, shape (3, rays).
        nearest: distance in m from the origin at which the rays start.
        farthest: distance at which they end.
    """

    origin: ndarray
    ways: ndarray
    nearest: float
    farthest: float


class RayScene:
    """What rays can hit: the shapes of bodies, where they are at one moment.

    Arrays end with a column for each shape. Results come without matrix libraries, which give
    other last bits on other processors.
    """

    def __init__(self, client: int):
        self._client = client
        # For each body, PyBullet's indices of its links with shapes, and rows of TARGET.
        self._bodies: dict[Body, list[tuple[int, list[tuple]]]] = {}
        self._is_whole = self._is_current = False
        # What was asked for by somebody, and is known.
        self._asked: dict[Any, Fan] = {}
        self._answers: dict[Any, Hits] = {}

    def add(self, body: Body) -> None:
        """Let rays see a body; raises LabError if one of its meshes cannot be read."""
        self._bodies[body] = [
            (index, _targets(body, link))
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
        self._asked.clear()
        self._answers.clear()

    def ask(self, who: Any, fan: Fan) -> None:
        """Cast a fan of rays for somebody together with others, when the first wants to know."""
        self._asked[who] = fan

    def answer(self, who: Any, fan: Callable[[], Fan]) -> Hits:
        """Return what `cast` says of the fan that somebody asked for, or asks for now."""
        if who not in self._answers:
            self._asked[who] = self._asked.get(who) or fan()
            self._answers.update(zip(self._asked, self.cast(list(self._asked.values()))))
            self._asked.clear()
        return self._answers.pop(who)

    def cast(self, fans: Sequence[Fan]) -> list[Hits]:
        """Cast fans of rays; many at once take little longer than one."""
        found = iter(self._compute([fan for fan in fans if fan.ways.shape[1] > FEW]))
        return [
            next(found) if fan.ways.shape[1] > FEW else self._look(fan.origin[:, None], *fan[1:])
            for fan in fans
        ]

    def _look(self, origins: ndarray, ways: ndarray, nearest: Any, farthest: Any) -> Hits:
        """Return what rays hit as Bullet finds it; arguments are as in `Fan`, for each ray."""
        ends = (origins + limit * ways for limit in (nearest, farthest))
        found = cast(self._client, *(points.T.tolist() for points in ends))
        bodies = np.array([hit[0] for hit in found], dtype=int)
        shares = np.array([hit[2] for hit in found], dtype=float)
        distances = nearest + shares * (farthest - nearest)
        return np.where(bodies < 0, np.inf, distances), bodies

    def _compute(self, fans: Sequence[Fan]) -> list[Hits]:
        """Return what the rays of fans hit, as `cast`; what is near a mesh is left to Bullet."""
        if not fans:
            return []
        if not self._is_current:
            self._update()
        ways = np.concatenate([fan.ways for fan in fans], axis=1)
        counts = [fan.ways.shape[1] for fan in fans]
        fan_of = np.repeat(np.arange(len(fans)), counts)
        origins = np.array([fan.origin for fan in fans]).T
        limits = np.array([(fan.nearest, fan.farthest) for fan in fans]).T
        # The origins in the frames of the shapes, (3, fans, shapes).
        away = origins[:, :, None] - self._positions[:, None]
        starts = np.sum(self._rotations[:, :, None] * away[:, None], axis=0)
        rays, shapes = self._candidates(fans, origins, starts)
        enters, leaves = self._crossings(starts[:, fan_of[rays], shapes], ways[:, rays], shapes)
        nearest, farthest = limits[:, fan_of[rays]]
        crossed = (enters <= leaves) & (enters <= farthest) & (leaves >= nearest)
        by_bullet = self._by_bullet[shapes]
        seen = np.flatnonzero(crossed & ~by_bullet & (enters > nearest))
        # From the farthest on, so that the nearest of a ray is written last.
        seen = seen[np.argsort(-enters[seen], kind="stable")]
        distances, bodies = np.full(len(fan_of), np.inf), np.full(len(fan_of), -1)
        distances[rays[seen]] = enters[seen]
        bodies[rays[seen]] = self._body[shapes[seen]]
        left = rays[crossed & by_bullet]
        if len(left):
            left = np.unique(left)
            fan = fan_of[left]
            found, whose = self._look(origins[:, fan], ways[:, left], *limits[:, fan])
            nearer = found < distances[left]
            distances[left[nearer]], bodies[left[nearer]] = found[nearer], whose[nearer]
        last = np.cumsum(counts)[:-1]
        return list(zip(np.split(distances, last), np.split(bodies, last)))

    def _candidates(
        self, fans: Sequence[Fan], origins: ndarray, starts: ndarray
    ) -> tuple[ndarray, ndarray]:
        """Return pairs of rays and shapes that they may hit.

        Such a ray is in the cone around the corners of the shape's box.

        Args:
            fans: of the rays, which are counted through all of them.
            origins: of the fans in the world in m, (3, fans).
            starts: the same in the frames of the shapes, (3, fans, shapes).
        """
        axes = self._middles[:, None] - origins[:, :, None]
        lengths = _norm(axes)
        axes /= np.maximum(lengths, LEAST)
        corners = self._corners[:, :, None] - origins[:, None, :, None]
        cosines = np.sum(corners * axes[:, None], axis=0) / np.maximum(_norm(corners), LEAST)
        least = np.min(cosines, axis=0) - ROUNDING
        # A cone of more than a half space would not contain the rest of the box.
        least[least <= 0.0] = -2.0
        farthest = np.array([fan.farthest for fan in fans])[:, None]
        planes = self._planes
        heights = starts[2, :, planes].T
        axes[:, :, planes] = -np.sign(heights) * self._rotations[:, 2][:, None, planes]
        least[:, planes] = np.abs(heights) / farthest - ROUNDING
        near = (lengths - self._reach <= farthest) & ~self._contain(starts)
        pairs, first = [], 0
        for number, fan in enumerate(fans):
            seen = np.flatnonzero(near[number])
            cones, widths = axes[:, number, seen], least[number, seen]
            for start in range(0, fan.ways.shape[1], PART):
                near_cones = fan.ways[:, start : start + PART].T @ cones >= widths
                # In one dimension, this is faster than np.nonzero in two.
                rays, places = np.divmod(np.flatnonzero(near_cones), len(seen))
                pairs.append((first + start + rays, seen[places]))
            first += fan.ways.shape[1]
        rays, shapes = (np.concatenate(column) for column in zip(*pairs))
        return rays, shapes

    def _contain(self, points: ndarray) -> ndarray:
        """Return which of the computed shapes contain points in their frames in m.

        The points are of shape (3, points, shapes), the result is of (points, shapes).
        """
        low, high, across = (one[:, None] for one in (self._low, self._high, self._across))
        inside = np.all((low < points) & (points < high), axis=0)
        apart = np.sum(across * points * points, axis=0)
        return inside & ~self._by_bullet & (apart < self._radius**2)

    def _crossings(self, start: ndarray, ways: ndarray, shapes: ndarray) -> tuple[ndarray, ndarray]:
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
        curved = np.flatnonzero(np.isfinite(self._radius[shapes]) & (enters <= leaves))
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
        shapes = np.array([row for table in tables for row in table], TARGET)
        columns = {
            name: np.ascontiguousarray(np.moveaxis(shapes[name], 0, -1)) for name in TARGET.names
        }
        self._body, self._by_bullet = columns["body"], columns["by_bullet"]
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


def _targets(body: Body, link: BulletLink) -> list[tuple]:
    """Return the shapes of a link as rows of TARGET."""
    found, inverse = [], link.mass_properties()[2].inverse()
    for shape in link.shapes:
        geometry, pose = shape.geometry, inverse * shape.pose
        low, high = geometry.bounds()
        by_bullet = type(geometry) not in COMPUTED
        if by_bullet:
            low, high = low - MARGIN, high + MARGIN
        if isinstance(geometry, Plane):
            pose = pose * _standing(geometry.normal)
            low[2] = high[2] = 0.0
        place = body.unique_id, pose.position, pose.rotation_matrix()
        across = COMPUTED.get(type(geometry), ANGULAR)
        found.append((*place, low, high, across, getattr(geometry, "radius", np.inf), by_bullet))
    return found


def _standing(normal: Sequence[float]) -> Pose:
    """Return a frame whose z axis is along a vector."""
    up = np.asarray(normal) / np.linalg.norm(normal)
    side = np.cross(np.eye(3)[np.argmin(np.abs(up))], up)
    side /= np.linalg.norm(side)
    return Pose.from_matrix((0.0, 0.0, 0.0), np.column_stack((side, np.cross(up, side), up)))


def _rotations(quaternions: ndarray) -> ndarray:
    """Return the rotation matrices (3, 3, n) of unit quaternions x, y, z, w, (n, 4)."""
    x, y, z, w = quaternions.T
    return np.array(
        (
            (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
            (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
            (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
        )
    )


def _turned(rotations: ndarray, vectors: ndarray) -> ndarray:
    """Return vectors (3, n), each turned by its matrix (3, 3, n)."""
    return np.sum(rotations * vectors, axis=1)


def _norm(vectors: ndarray) -> ndarray:
    """Return the lengths of vectors (3, …)."""
    return np.sqrt(np.sum(vectors * vectors, axis=0))
