"""Frames that are fixed to a link of a body: their pose, velocity and rays."""

from __future__ import annotations

from copy import copy
from typing import Iterable, Tuple

import numpy as np

from bullet_lab.core.pose import Pose, Vector, add, cross
from bullet_lab.simulation.physics import pybullet
from bullet_lab.simulation.physics.physics import Body
from bullet_lab.simulation.world.description import Model
from bullet_lab.simulation.world.tree import principal_axes

ORIGIN = Pose()
# PyBullet's limit of rays in one call.
RAYS_AT_A_TIME = 16_383


class AttachedFrame:
    """A frame at a pose `offset` in a link of a body; raises KeyError for an unknown link.

    Attributes:
        index: PyBullet's index of the link.
    """

    def __init__(self, body: Body, link: str, offset: Pose = ORIGIN):
        self.body = body
        self.link = link
        self.index = body.link_index(link)
        inertia = {one.name: one.inertia for one in body.links}[link]
        principal = ORIGIN if inertia is None else principal_axes(inertia)[1]
        # PyBullet gives the pose of a link's principal frame.
        self._in_principal = principal.inverse() * offset

    @classmethod
    def of(
        cls, model: Model, bodies: Iterable[Body], link: str, offset: Pose = ORIGIN
    ) -> AttachedFrame:
        """Return a frame at an offset in a link of a model, which may be merged into another.

        Raises:
            KeyError: there is no such link.
        """
        carrier, pose = model.frames.get(link, (link, ORIGIN))
        for body in bodies:
            if any(one.name == carrier for one in body.links):
                return cls(body, carrier, pose * offset)
        raise KeyError(link)

    def pose(self) -> Pose:
        """Return the frame's pose in the world."""
        return self._principal_pose() * self._in_principal

    def velocity(self) -> Tuple[Vector, Vector]:
        """Return linear (m/s, of the frame's origin) and angular (rad/s) velocity, in the world."""
        if self.index < 0:
            linear, angular = self.body.velocity()
        else:
            state = pybullet.getLinkState(self.body.unique_id, self.index, 1, 1, self.body.client)
            linear, angular = state[6:8]
        arm = self._principal_pose().rotate(self._in_principal.position)
        return add(linear, cross(angular, arm)), angular

    def centre_of_mass(self) -> Vector:
        """Return the position of the link's centre of mass in the world, in m."""
        return self._principal_pose().position

    def rays(self, directions: np.ndarray) -> Rays:
        """Return rays from the frame's origin along unit vectors in the frame, shape (n, 3)."""
        return Rays(self.body, self.index, self._in_principal, directions)

    def _principal_pose(self) -> Pose:
        if self.index < 0:
            return self.body.com_pose()
        # The last argument lets PyBullet compute the pose anew: its copy may be out of date.
        state = pybullet.getLinkState(self.body.unique_id, self.index, 0, 1, self.body.client)
        return Pose(*state[:2])


class Rays:
    """Rays that start in one point of a link and move with it.

    A ray does not see a shape that contains its start.
    """

    def __init__(self, body: Body, index: int, frame: Pose, directions: np.ndarray):
        self._body = body
        self._index = index
        self._origin = np.array(frame.position)
        self._directions = directions @ frame.rotation_matrix().T
        self._limits: Tuple[float, ...] = ()

    def __len__(self) -> int:
        return len(self._directions)

    def select(self, chosen: np.ndarray) -> Rays:
        """Return the chosen rays: an array of indices, or of bool."""
        rays = copy(self)
        rays._directions, rays._limits = self._directions[chosen], ()
        return rays

    def cast(self, start: float, end: float) -> Tuple[np.ndarray, np.ndarray]:
        """Cast the rays between two distances (m) from their origin.

        Returns:
            Distances in m, `end` without a hit, and unique ids of the bodies that were hit, -1
            without a hit; each of shape (n,).
        """
        if (start, end) != self._limits:
            self._limits = (start, end)
            self._starts = (self._origin + start * self._directions).tolist()
            self._ends = (self._origin + end * self._directions).tolist()
        hits: list = []
        for first in range(0, len(self), RAYS_AT_A_TIME):
            part = slice(first, first + RAYS_AT_A_TIME)
            hits += pybullet.rayTestBatch(
                self._starts[part],
                self._ends[part],
                numThreads=1,
                parentObjectUniqueId=self._body.unique_id,
                parentLinkIndex=self._index,
                physicsClientId=self._body.client,
            )
        fractions = np.array([hit[2] for hit in hits])
        return start + (end - start) * fractions, np.array([hit[0] for hit in hits])
