"""The physics engine: bodies in PyBullet, in a session of their own.

Everything that calls PyBullet stands here and in `view.py`. One `Physics` is one PyBullet
client, so several simulations can live in one process.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Dict, List, Tuple

from bullet_lab.errors import LabError
from bullet_lab.simulation.bullet_urdf import body_urdf
from bullet_lab.simulation.description import Joint, Link, Model
from bullet_lab.simulation.engine import pybullet
from bullet_lab.simulation.inertia import principal_axes
from bullet_lab.simulation.native_output import hidden_native_output
from bullet_lab.simulation.pose import Pose, Vector
from bullet_lab.simulation.tree import top_down

STEP_SECONDS = 1e-3


class PhysicsError(LabError):
    """PyBullet refused something."""


@dataclass(frozen=True)
class JointState:
    """Position (rad or m), velocity (rad/s or m/s) and effort (N m or N) of one joint."""

    position: float
    velocity: float
    effort: float


class Body:
    """One tree of links in the engine.

    The pose of a body is that of its root link's frame in the world; velocities are those of
    its centre of mass. `com_place()` returns the position and quaternion of `com_pose` as
    plain tuples, and `set_velocity(linear, angular)` sets the root link's velocity in m/s and
    rad/s in the world, both without a detour, for the inner loop.
    """

    def __init__(self, client: int, unique_id: int, links: List[Link], joints: List[Joint]):
        self.unique_id = unique_id
        self.links = tuple(links)
        self._client = client
        # Called at every step: bound once, in C.
        self.com_place = partial(pybullet.getBasePositionAndOrientation, unique_id, client)
        self.set_velocity = partial(
            pybullet.resetBaseVelocity, unique_id, physicsClientId=client
        )
        root = links[0].inertia
        self._com = Pose() if root is None else principal_axes(root)[1]
        self._com_inverse = self._com.inverse()
        self._joints = {
            pybullet.getJointInfo(unique_id, index, client)[1].decode(): index
            for index in range(pybullet.getNumJoints(unique_id, client))
        }
        self._free_the_joints()
        for link in links:
            self._set_friction(link)

    @property
    def joint_names(self) -> Tuple[str, ...]:
        """Names of the movable joints."""
        return tuple(self._joints)

    @property
    def turned_inertia(self) -> bool:
        """Whether the principal axes of the root link are turned against its frame."""
        return self._com.quaternion != (0.0, 0.0, 0.0, 1.0)

    def pose(self) -> Pose:
        """Return the pose of the root link's frame in the world."""
        return self.com_pose() * self._com_inverse

    def com_pose(self) -> Pose:
        """Return the pose of the root link's principal frame in the world."""
        return Pose(*self.com_place())

    def velocity(self) -> Tuple[Vector, Vector]:
        """Return linear (m/s, of the centre of mass) and angular (rad/s) velocity, in the world."""
        return pybullet.getBaseVelocity(self.unique_id, self._client)

    def place(self, pose: Pose) -> None:
        """Put the body somewhere, at rest, its joints at zero."""
        com = pose * self._com
        pybullet.resetBasePositionAndOrientation(
            self.unique_id, com.position, com.quaternion, self._client
        )
        self.set_velocity((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        for index in self._joints.values():
            pybullet.resetJointState(self.unique_id, index, 0.0, 0.0, self._client)

    def joint_state(self, name: str) -> JointState:
        """Return the state of a joint; raises KeyError for an unknown name."""
        position, velocity, _, effort = pybullet.getJointState(
            self.unique_id, self._joints[name], self._client
        )
        return JointState(position, velocity, effort)

    def set_joint(self, name: str, position: float, velocity: float = 0.0) -> None:
        """Put a joint somewhere (rad or m); raises KeyError for an unknown name."""
        index = self._joints[name]
        pybullet.resetJointState(self.unique_id, index, position, velocity, self._client)

    def remove_sliding_friction(self) -> None:
        """Let the body slide freely, for a device that models its friction itself."""
        for index in range(-1, len(self._joints)):
            pybullet.changeDynamics(
                self.unique_id, index, lateralFriction=0.0, physicsClientId=self._client
            )

    def _free_the_joints(self) -> None:
        # PyBullet holds every joint still with a motor until told otherwise.
        for index in self._joints.values():
            pybullet.setJointMotorControl2(
                self.unique_id,
                index,
                pybullet.VELOCITY_CONTROL,
                force=0.0,
                physicsClientId=self._client,
            )

    def _set_friction(self, link: Link) -> None:
        friction = max((c.friction for c in link.collisions), default=1.0)
        pybullet.changeDynamics(
            self.unique_id,
            self._link_index(link.name),
            lateralFriction=friction,
            linearDamping=0.0,
            angularDamping=0.0,
            physicsClientId=self._client,
        )

    def _link_index(self, name: str) -> int:
        for index in self._joints.values():
            if pybullet.getJointInfo(self.unique_id, index, self._client)[12].decode() == name:
                return index
        return -1


class Physics:
    """A PyBullet world, headless; `step()` advances it by 1 ms."""

    def __init__(self, gravity: Vector):
        self.gravity = gravity
        self.client = pybullet.connect(pybullet.DIRECT)
        self.step = partial(pybullet.stepSimulation, self.client)
        pybullet.setGravity(*gravity, physicsClientId=self.client)
        pybullet.setTimeStep(STEP_SECONDS, self.client)
        pybullet.setPhysicsEngineParameter(
            # The cache goes by file name and would give one body the shape of another.
            deterministicOverlappingPairs=1, enableFileCaching=0, physicsClientId=self.client
        )

    def close(self) -> None:
        """Give everything back; the object is of no use afterwards."""
        if self.client >= 0:
            pybullet.disconnect(self.client)
            self.client = -1

    def add(self, model: Model) -> Dict[str, Body]:
        """Load a model at its pose and return its bodies by the name of their root link.

        Raises:
            PhysicsError: a movable root without mass, or PyBullet's refusal.
            MeshError: a mesh is not usable.
        """
        bodies: Dict[str, Body] = {}
        by_name = model.links_by_name()
        try:
            for root in model.root_links():
                names = top_down(root.name, model.joints)
                links = [by_name[name] for name in names]
                joints = [joint for joint in model.joints if joint.parent in names]
                if model.static:
                    # Without a centre of mass, the body's frame is that of its root link.
                    links = [replace(link, inertia=None) for link in links]
                else:
                    _check_masses(links, model.name)
                bodies[root.name] = self._load(links, joints, model, model.pose * root.pose)
        except LabError:
            self.remove(bodies)
            raise
        return bodies

    def remove(self, bodies: Dict[str, Body]) -> None:
        """Take the bodies of a model out of the world."""
        for body in bodies.values():
            pybullet.removeBody(body.unique_id, self.client)

    def _load(self, links: List[Link], joints: List[Joint], model: Model, pose: Pose) -> Body:
        # PyBullet reads files only, and only while it loads.
        with tempfile.TemporaryDirectory(prefix="bullet_lab_") as name:
            path = Path(name, "body.urdf")
            text = body_urdf(links, joints, model.static, path.parent)
            path.write_text(text, encoding="utf-8")
            unique_id = self._load_file(path, model, pose)
        body = Body(self.client, unique_id, links, joints)
        body.place(pose)
        return body

    def _load_file(self, path: Path, model: Model, pose: Pose) -> int:
        with hidden_native_output():
            try:
                return pybullet.loadURDF(
                    str(path),
                    pose.position,
                    pose.quaternion,
                    useFixedBase=model.static,
                    flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                    physicsClientId=self.client,
                )
            except pybullet.error as error:
                raise PhysicsError(f"PyBullet cannot load '{model.name}': {error}") from error


def _check_masses(links: List[Link], model: str) -> None:
    for link in links:
        if link.inertia is None or link.inertia.mass == 0.0:
            raise PhysicsError(f"model '{model}': link '{link.name}' moves and has no mass")
