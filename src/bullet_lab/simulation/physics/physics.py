"""The physics engine: a PyBullet client with its bodies.

Each `Physics` has a client of its own, so several simulations can live in one process.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from bullet_lab.core.pose import Pose, Vector, add, cross
from bullet_lab.errors import LabError
from bullet_lab.simulation.physics import PhysicsError, is_contact, pybullet
from bullet_lab.simulation.physics.bodies import (
    HELPER_JOINT,
    ROOT,
    BodyMaker,
    BulletLink,
    allowed_effort,
    joint_properties,
    net_motor,
)
from bullet_lab.simulation.physics.surfaces import (
    fit_for_skidding,
    skidding_wheels,
    wants_friction_pyramid,
)
from bullet_lab.simulation.physics.traction import Traction
from bullet_lab.simulation.world.description import Inertia, Joint, Link, Model
from bullet_lab.simulation.world.tree import principal_axes, top_down

STEP_SECONDS = 1e-3
# Share of the distance from its held position that a joint is moved back in one step.
HOLDING_GAIN = 0.1
# Rounding error (m, and of a quaternion's components) of a pose that did not change.
NEARLY = 1e-6
# A body that was placed into another one is pushed out at once. For this many steps it does not
# keep the speed of that, ...
SETTLING_STEPS = 1000
# ... if it overlaps by more than this (m) ...
DEEP = 2e-4
# ... and leaves faster than this (m/s).
SLOW = 0.1
ZERO: Vector = (0.0, 0.0, 0.0)
NO_TURN = (0.0, 0.0, 0.0, 1.0)
# Bullet's collision group and mask of bodies that move: they collide with everything.
MOVING_FILTER = (1, -1)


@dataclass(frozen=True)
class JointState:
    """Position (rad or m), velocity (rad/s or m/s) and effort (N m or N) of one joint."""

    position: float
    velocity: float
    effort: float


class Body:
    """A tree of links in the engine.

    The pose of a body is that of its root link's frame in the world; velocities are those of
    its centre of mass.

    Three attributes are PyBullet's functions with this body bound, for the inner loop:
    `com_place()` returns position and quaternion of `com_pose` as plain tuples;
    `set_velocity(linear, angular)` sets the root link's velocity in the world (m/s, rad/s);
    `near_points()` returns PyBullet's tuples of contact points.

    Attributes:
        client: its PyBullet client.
        unique_id: PyBullet's id of it.
        bullet_links: PyBullet's links of it, in order; the first is the root, with index -1.
        links: of the description, the root first.
        joint_names: of the movable joints, less ball joints, which have no single position.
        turned_inertia: whether the root's principal axes differ from its frame's.
        weightless: PyBullet's index and the mass (kg) of the links that gravity does not pull.
        moves: whether its root can move.
        weight: the share of its mass that gravity pulls.
        settling: the number of steps for which `settle` still limits its speed.
        traction: the friction of its skidding wheels, if it has any.
    """

    traction: Optional[Traction] = None

    def __init__(self, client: int, unique_id: int, bullet_links: Sequence[BulletLink]):
        self.client = client
        self.unique_id = unique_id
        self.bullet_links = tuple(bullet_links)
        self.links = tuple(one.link for one in bullet_links if one.joint is not HELPER_JOINT)
        self.com_place = partial(pybullet.getBasePositionAndOrientation, unique_id, client)
        self.set_velocity = partial(pybullet.resetBaseVelocity, unique_id, physicsClientId=client)
        self.near_points = partial(pybullet.getContactPoints, unique_id, physicsClientId=client)
        mass, _, self._com = bullet_links[0].mass_properties()
        self.moves = mass > 0.0
        self._com_inverse = self._com.inverse()
        self.turned_inertia = self._com.quaternion != NO_TURN
        self.settling = 0
        # The normal of the deepest contact since the body was placed.
        self._way_out = ZERO
        self._placed_velocity = (ZERO, ZERO)
        self._indices: Dict[str, Tuple[int, ...]] = {}
        self._joints: Dict[str, int] = {}
        self._balls: List[int] = []
        for index, one in enumerate(bullet_links, start=ROOT):
            self._indices[one.link.name] = (*self._indices.get(one.link.name, ()), index)
            if one.joint and one.joint.kind == "ball":
                self._balls.append(index)
                # PyBullet holds every joint still with a motor until told otherwise.
                free = {"targetPosition": NO_TURN, "positionGain": 0.0, "force": ZERO}
                mode = pybullet.POSITION_CONTROL
                self._call(pybullet.setJointMotorControlMultiDof, index, mode, **free)
            elif one.joint and one.joint.kind != "fixed":
                self._joints[one.joint.name] = index
                self.drive_joint(one.joint.name, 0.0, 0.0)
        self.joint_names = tuple(self._joints)
        self._weigh()

    def pose(self) -> Pose:
        """Return the pose of the root link's frame in the world."""
        return self.com_pose() * self._com_inverse

    def com_pose(self) -> Pose:
        """Return the pose of the root link's principal frame in the world."""
        return Pose(*self.com_place())

    def velocity(self) -> Tuple[Vector, Vector]:
        """Return linear (m/s, of the centre of mass) and angular (rad/s) velocity, in the world."""
        return pybullet.getBaseVelocity(self.unique_id, self.client)

    def origin_velocity(self) -> Tuple[Vector, Vector]:
        """Return linear (m/s, of the root frame's origin) and angular (rad/s) velocity."""
        (vx, vy, vz), (wx, wy, wz) = self.velocity()
        x, y, z = self.com_pose().rotate(self._com_inverse.position)
        linear = (vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x)
        return linear, (wx, wy, wz)

    def is_finite(self) -> bool:
        """Return whether its pose and its joints' positions are finite."""
        joints = (self.joint_state(name).position for name in self._joints)
        position, quaternion = self.com_place()
        return math.isfinite(sum(position) + sum(quaternion) + sum(joints))

    def place(self, pose: Pose) -> None:
        """Place the body at rest, its joints at zero."""
        self._put(pose, ZERO, ZERO)
        for name in self._joints:
            self.set_joint(name, 0.0)
        for index in self._balls:
            self._call(pybullet.resetJointStateMultiDof, index, NO_TURN, ZERO)

    def move(self, pose: Pose, linear: Vector, angular: Vector) -> None:
        """Place the body in motion; its joints keep their positions and stand still.

        The velocities, in m/s and rad/s in the world, are those of the root link's frame.
        """
        arm = pose.rotate(self._com.position)
        self._put(pose, add(linear, cross(angular, arm)), angular)
        for name in self._joints:
            self.set_joint(name, self.joint_state(name).position)
        for index in self._balls:
            turn = pybullet.getJointStateMultiDof(self.unique_id, index, self.client)[0]
            self._call(pybullet.resetJointStateMultiDof, index, turn, ZERO)

    def push(self, link: str, force: Vector, torque: Vector, point: Vector) -> None:
        """Apply a force (N, at a point in m) and a torque (N m) to a link in the coming step.

        All vectors are in the world.
        """
        index, world = self.link_index(link), pybullet.WORLD_FRAME
        self._call(pybullet.applyExternalForce, index, force, point, world)
        self._call(pybullet.applyExternalTorque, index, torque, world)

    def exert(self, joint: str, effort: float) -> None:
        """Apply an effort (N m or N) to a joint in the coming step, in addition to its motor.

        The joint's limits of effort and velocity hold.
        """
        described = self._joint(joint)
        velocity = self.joint_state(joint).velocity if "velocity" in described.limits else 0.0
        allowed = allowed_effort(described, effort, velocity)
        self._control(joint, pybullet.TORQUE_CONTROL, force=allowed)

    def cancel_gravity(self, gravity: Vector) -> None:
        """Hold up the links without gravity (m/s²) in the coming step."""
        for index, mass in self.weightless:
            if index == ROOT:
                place, _ = self.com_place()
            else:
                place = pybullet.getLinkState(self.unique_id, index, 0, 1, self.client)[0]
            lift = tuple(-mass * value for value in gravity)
            self._call(pybullet.applyExternalForce, index, lift, place, pybullet.WORLD_FRAME)

    def joint_state(self, name: str) -> JointState:
        """Return the state of a joint; raises KeyError for an unknown name."""
        index = self._joints[name]
        position, velocity, _, effort = pybullet.getJointState(self.unique_id, index, self.client)
        return JointState(position, velocity, effort)

    def set_joint(self, name: str, position: float, velocity: float = 0.0) -> None:
        """Place a joint (rad or m); raises KeyError for an unknown name."""
        self._call(pybullet.resetJointState, self._joints[name], position, velocity)

    def drive_joint(self, name: str, velocity: float, effort: float) -> None:
        """Drive a joint at a velocity (rad/s or m/s) from now on, with at most `effort` (N m, N).

        Raises:
            KeyError: an unknown name.
        """
        velocity, effort = net_motor(self._joint(name), velocity, effort)
        self._control(name, pybullet.VELOCITY_CONTROL, targetVelocity=velocity, force=effort)

    def hold_joint(
        self, name: str, position: float, effort: float, gain: float = HOLDING_GAIN
    ) -> None:
        """Hold a joint at a position (rad or m) from now on, with at most `effort` (N m or N).

        `gain` is the share of its distance that the joint is moved back in one step.
        """
        self._control(
            name,
            pybullet.POSITION_CONTROL,
            targetPosition=position,
            targetVelocity=0.0,
            force=net_motor(self._joint(name), 0.0, effort)[1],
            positionGain=gain,
            velocityGain=1.0,
        )

    def set_sticking(self, name: str, sticking: bool) -> None:
        """Let the link below a joint stick to the surface it touches, or roll and slide again.

        Bullet's friction stops velocities up to its solver's tolerance, so a standing robot
        creeps. A contact point that sticks is pulled back to its first place, by a force within
        the limits of friction. Do not use it on rolling wheels: they would bump.
        """
        for index in self._indices[self.link_at(self._joints[name]).link.name]:
            if self.traction is not None and self.traction.acts_on(index):
                continue
            self._call(pybullet.changeDynamics, index, frictionAnchor=int(sticking))
            if sticking:
                # Only new points stick; setting the unchanged filter drops the old ones.
                self._call(pybullet.setCollisionFilterGroupMask, index, *MOVING_FILTER)

    def remove_sliding_friction(self) -> None:
        """Let the body slide freely, for a plugin that computes its friction itself."""
        for index in range(ROOT, len(self.bullet_links) - 1):
            self._call(pybullet.changeDynamics, index, lateralFriction=0.0)
        self.bullet_links = tuple(
            replace(one, surface=replace(one.surface, friction=0.0)) for one in self.bullet_links
        )
        self.traction = None

    def link_index(self, name: str) -> int:
        """Return PyBullet's index of a link, -1 for the root."""
        return self.link_indices(name)[0]

    def link_indices(self, name: str) -> Tuple[int, ...]:
        """Return PyBullet's indices of a link and of its helper links."""
        return self._indices.get(name, (ROOT,))

    def link_at(self, index: int) -> BulletLink:
        """Return the link with PyBullet's index."""
        return self.bullet_links[index - ROOT]

    def touching_points(self) -> List[tuple]:
        """Return PyBullet's points where the body touches another; the body itself comes first."""
        return [point for point in self.near_points() if is_contact(point)]

    def change_joint(self, joint: Joint) -> None:
        """Change limits and damping of the joint of that name; raises KeyError."""
        index = self._joints[joint.name]
        changed = self._replace_link(index, joint=joint)
        parent = self.bullet_links[changed.parent].link
        properties = joint_properties(joint, parent, changed.link)
        self._call(pybullet.changeDynamics, index, **properties)

    def change_link(self, name: str, inertia: Inertia, gravity: bool) -> None:
        """Change mass and moments of a link, and whether gravity pulls it.

        Raises:
            PhysicsError: a mass or moment is not positive, or the principal frame would move.
        """
        index = self.link_index(name)
        moments, frame = principal_axes(inertia)
        if inertia.mass <= 0.0 or min(moments) <= 0.0:
            raise PhysicsError(f"link '{name}': its mass and its moments must be positive")
        before = self.link_at(index).mass_properties()[2]
        shift = frame.inverse() * before
        if max(map(abs, (*shift.position, *shift.quaternion[:3]))) >= NEARLY:
            what = "its centre of mass and its principal axes"
            raise PhysicsError(f"link '{name}': {what} cannot be changed in a running simulation")
        link = replace(self.link_at(index).link, inertia=inertia, gravity=gravity)
        self._replace_link(index, link=link)
        properties = {"mass": inertia.mass, "localInertiaDiagonal": moments}
        self._call(pybullet.changeDynamics, index, **properties)
        if self.traction is not None:
            self.traction.update_gains()

    def _weigh(self) -> None:
        """Note which links gravity does not pull."""
        masses = [one.mass_properties()[0] for one in self.bullet_links]
        total = sum(masses)
        self.weightless = tuple(
            (index, mass)
            for index, (mass, one) in enumerate(zip(masses, self.bullet_links), ROOT)
            if mass and not one.link.gravity
        )
        self.weight = 1.0 - sum(mass for _, mass in self.weightless) / total if total else 1.0

    def _replace_link(self, index: int, **changes: Any) -> BulletLink:
        links = list(self.bullet_links)
        links[index - ROOT] = replace(links[index - ROOT], **changes)
        self.bullet_links = tuple(links)
        self._weigh()
        return self.link_at(index)

    def _joint(self, name: str) -> Joint:
        return self.link_at(self._joints[name]).joint

    def settle(self, _step: int) -> None:
        """Take off, before a step, the speed at which the body is thrown out of an overlap.

        Gazebo lets no contact push faster than its maxVel. Bullet pushes as fast as it needs to
        end the overlap: a robot that is placed 0.1 m into the floor would fly up by 100 m.
        """
        if not self.settling:
            return
        self.settling -= 1
        if self.settling == SETTLING_STEPS - 1:
            # The engine's contact points are still those of the place before.
            return
        deepest = min(self.near_points(), key=lambda point: point[8], default=None)
        deep = deepest is not None and deepest[8] < -DEEP
        if deep:
            self._way_out = deepest[7]
        if self._way_out != ZERO:
            linear, _ = self.velocity()
            if sum(v * n for v, n in zip(linear, self._way_out)) > SLOW:
                self.set_velocity(*self._placed_velocity)
        if not deep:
            self.settling = 0

    def _put(self, pose: Pose, linear: Vector, angular: Vector) -> None:
        com = pose * self._com
        self._call(pybullet.resetBasePositionAndOrientation, com.position, com.quaternion)
        self.set_velocity(linear, angular)
        self._placed_velocity = (linear, angular)
        self._way_out = ZERO
        self.settling = SETTLING_STEPS
        if self.traction is not None:
            self.traction.reset()

    def _control(self, joint: str, mode: int, **targets: float) -> None:
        self._call(pybullet.setJointMotorControl2, self._joints[joint], mode, **targets)

    def _call(self, function: Callable[..., Any], *arguments: Any, **more: Any) -> None:
        function(self.unique_id, *arguments, physicsClientId=self.client, **more)


class Physics:
    """A PyBullet world, headless; `step()` advances it by 1 ms."""

    def __init__(self, gravity: Vector):
        self.client = pybullet.connect(pybullet.DIRECT)
        self.step = partial(pybullet.stepSimulation, self.client)
        self.set_gravity(gravity)
        pybullet.setTimeStep(STEP_SECONDS, self.client)
        pybullet.setPhysicsEngineParameter(
            deterministicOverlappingPairs=1, physicsClientId=self.client
        )
        self._maker = BodyMaker(self.client)
        self._bodies: Dict[int, Body] = {}

    def close(self) -> None:
        """Disconnect from PyBullet; the object cannot be used afterwards."""
        if self.client >= 0:
            pybullet.disconnect(self.client)
            self.client = -1

    def set_gravity(self, gravity: Vector) -> None:
        """Change gravity, in m/s²."""
        self.gravity = gravity
        pybullet.setGravity(*gravity, physicsClientId=self.client)

    def add(self, model: Model) -> Dict[str, Body]:
        """Make the bodies of a model at its pose; return them by the names of their root links.

        Raises:
            PhysicsError: a moving link has no mass, a body has too many links, or PyBullet
                refuses it.
            MeshError: a mesh is not usable.
        """
        bodies: Dict[str, Body] = {}
        try:
            for root in model.root_links():
                bodies[root.name] = self._add_tree(model, root)
        except LabError as error:
            self.remove(bodies)
            if isinstance(error, PhysicsError):
                raise PhysicsError(f"model '{model.name}': {error}") from error
            raise
        return bodies

    def _add_tree(self, model: Model, root: Link) -> Body:
        by_name = model.links_by_name()
        names = top_down(root.name, model.joints)
        links = [by_name[name] for name in names]
        joints = [joint for joint in model.joints if joint.parent in names]
        # Without a mass, a body's root never moves; without a centre of mass, the body's frame
        # is that of its root link.
        held = len(links) if model.static else int(root.anchored)
        links[:held] = [replace(link, inertia=None) for link in links[:held]]
        for link in links[held:]:
            if link.inertia is None or link.inertia.mass == 0.0:
                raise PhysicsError(f"link '{link.name}' moves and has no mass")
        pose = model.pose * root.pose
        skidding = [] if held else skidding_wheels(links, joints)
        if skidding:
            links = fit_for_skidding(links, skidding)
        body = Body(self.client, *self._maker.make(links, joints, model.static, pose))
        self._bodies[body.unique_id] = body
        if skidding:
            body.traction = Traction(body, skidding, self._bodies)
        if any(link.self_collide for link in links):
            _set_self_collisions(body)
        body.place(pose)
        names = [wheel.link for wheel in skidding]
        rest = [link for link in links if link.name not in names]
        if not model.static and wants_friction_pyramid(rest, joints):
            self._use_friction_pyramid()
        return body

    def _use_friction_pyramid(self) -> None:
        """Limit friction along each of two directions alone, in the whole world.

        ODE, Gazebo's engine, does so by default. Bullet's default, a cone, solves the directions
        together, and wheels that slip sideways while they are driven then hardly push.
        """
        pybullet.setPhysicsEngineParameter(enableConeFriction=0, physicsClientId=self.client)

    def remove(self, bodies: Mapping[str, Body]) -> None:
        """Take the bodies of a model out of the world."""
        for body in bodies.values():
            self._maker.remove(body.unique_id)
            del self._bodies[body.unique_id]
        for body in self._bodies.values():
            if body.traction is not None:
                body.traction.forget_others()


def _set_self_collisions(body: Body) -> None:
    """Set which links of a body touch each other.

    As in Gazebo, two links touch if one of them has `self_collide`, but never over a joint.
    """
    joined = {(one.joint.parent, one.link.name) for one in body.bullet_links if one.joint}
    for (first, one), (second, other) in combinations(enumerate(body.bullet_links, ROOT), 2):
        names = (one.link.name, other.link.name)
        apart = names[0] == names[1] or names in joined or names[::-1] in joined
        collide = (one.link.self_collide or other.link.self_collide) and not apart
        # For every pair: PyBullet remembers the pairs of a removed body that had this id.
        pair = (body.unique_id, body.unique_id, first, second)
        pybullet.setCollisionFilterPair(*pair, int(collide), physicsClientId=body.client)
