"""The physics engine: bodies in PyBullet, in a session of their own.

One `Physics` is one PyBullet client, so several simulations can live in one process.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from bullet_lab.core.pose import Pose, Vector, add, cross
from bullet_lab.errors import LabError
from bullet_lab.simulation.physics.bodies import (
    HELPER_JOINT,
    ROOT,
    BodyMaker,
    Part,
    allowed_effort,
    joint_properties,
    net_motor,
)
from bullet_lab.simulation.physics.engine import PhysicsError, pybullet
from bullet_lab.simulation.physics.skidding import fit_for_skidding, skidding_wheels
from bullet_lab.simulation.physics.surfaces import wants_friction_pyramid
from bullet_lab.simulation.physics.traction import Traction
from bullet_lab.simulation.world.description import Inertia, Joint, Model
from bullet_lab.simulation.world.inertia import principal_axes
from bullet_lab.simulation.world.tree import top_down

__all__ = ["STEP_SECONDS", "Body", "JointState", "Physics", "PhysicsError"]

STEP_SECONDS = 1e-3
# What part of its distance from the held position a joint is brought back in one step.
HOLDING_GAIN = 0.1
# In m, and of a quaternion: what rounding leaves of a pose that did not change.
NEARLY = 1e-6
# A body that was put into another is pushed out at once, and may not keep the speed of that: for
# so many steps, from so deep in m, and faster than that in m/s.
SETTLING_STEPS = 1000
DEEP = 2e-4
SLOW = 0.1
NOWHERE = (0.0, 0.0, 0.0)
NO_TURN = (0.0, 0.0, 0.0, 1.0)
# Bullet's collision group and mask of all that moves: it collides with everything.
FREE_BODY_FILTER = (1, -1)


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
    rad/s in the world; `near_points()` returns PyBullet's tuples of contact points. All three
    go without a detour, for the inner loop.

    Attributes:
        client: the PyBullet client that it lives in.
        unique_id: PyBullet's number of it.
        parts: what is a link to PyBullet, in its order; its index of the first, the root, is -1.
        links: of the description, the root first.
        joint_names: of the movable joints; balls, which have no single position, are not named.
        turned_inertia: whether the root's principal axes are turned against its frame.
        floats: whether there are links that gravity does not pull, which `bear` holds up.
        moves: whether its root can move.
        weight: the share of its mass that gravity pulls.
        settling: in how many steps at most `settle` is still needed, since it was put somewhere.
        traction: the friction of wheels that steer it by slipping, if it has such.
    """

    traction: Optional[Traction] = None

    def __init__(self, client: int, unique_id: int, parts: Sequence[Part]):
        self.unique_id = unique_id
        self.parts = tuple(parts)
        self.links = tuple(part.link for part in parts if part.joint is not HELPER_JOINT)
        self.client = client
        # Called at every step: bound once, in C.
        self.com_place = partial(pybullet.getBasePositionAndOrientation, unique_id, client)
        self.set_velocity = partial(pybullet.resetBaseVelocity, unique_id, physicsClientId=client)
        self.near_points = partial(pybullet.getContactPoints, unique_id, physicsClientId=client)
        self._com = self.parts[0].mass_properties()[2]
        self._com_inverse = self._com.inverse()
        self.turned_inertia = self._com.quaternion != (0.0, 0.0, 0.0, 1.0)
        self.settling = 0
        self._way_out = NOWHERE
        self._given = (NOWHERE, NOWHERE)
        self._links: Dict[str, Tuple[int, ...]] = {}
        self._joints: Dict[str, int] = {}
        self._balls: List[int] = []
        for index, part in enumerate(parts, start=ROOT):
            self._links[part.link.name] = (*self._links.get(part.link.name, ()), index)
            if part.joint and part.joint.kind == "ball":
                self._balls.append(index)
                # As the others, held by a motor.
                free = {"targetPosition": NO_TURN, "positionGain": 0.0, "force": NOWHERE}
                mode = pybullet.POSITION_CONTROL
                self._call(pybullet.setJointMotorControlMultiDof, index, mode, **free)
            elif part.joint and part.joint.kind != "fixed":
                self._joints[part.joint.name] = index
                # PyBullet holds every joint still with a motor until told otherwise.
                self.drive_joint(part.joint.name, 0.0, 0.0)
        self.joint_names = tuple(self._joints)
        self._weigh()
        self.moves = self.parts[0].mass_properties()[0] > 0.0

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
        """Return whether all of its poses are numbers still."""
        joints = (self.joint_state(name).position for name in self._joints)
        position, quaternion = self.com_place()
        return math.isfinite(sum(position) + sum(quaternion) + sum(joints))

    def place(self, pose: Pose) -> None:
        """Put the body somewhere, at rest, its joints at zero."""
        self._put(pose, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        for name in self._joints:
            self.set_joint(name, 0.0)
        for index in self._balls:
            self._call(pybullet.resetJointStateMultiDof, index, NO_TURN, NOWHERE)

    def move(self, pose: Pose, linear: Vector, angular: Vector) -> None:
        """Put the body somewhere in motion; its joints keep their positions and stand still.

        The velocities, in m/s and rad/s in the world, are those of the root link's frame.
        """
        arm = pose.rotate(self._com.position)
        self._put(pose, add(linear, cross(angular, arm)), angular)
        for name in self._joints:
            self.set_joint(name, self.joint_state(name).position)
        for index in self._balls:
            turn = pybullet.getJointStateMultiDof(self.unique_id, index, self.client)[0]
            self._call(pybullet.resetJointStateMultiDof, index, turn, NOWHERE)

    def push(self, link: str, force: Vector, torque: Vector, point: Vector) -> None:
        """Push (N, at a point) and turn (N m) a link in the coming step, all in the world."""
        index, world = self.link_index(link), pybullet.WORLD_FRAME
        self._call(pybullet.applyExternalForce, index, force, point, world)
        self._call(pybullet.applyExternalTorque, index, torque, world)

    def exert(self, joint: str, effort: float) -> None:
        """Turn (N m) or push (N) a joint in the coming step, whatever its motor does besides.

        As far as the joint's limits of effort and velocity allow.
        """
        described = self._joint(joint)
        velocity = self.joint_state(joint).velocity if "velocity" in described.limits else 0.0
        allowed = allowed_effort(described, effort, velocity)
        self._control(joint, pybullet.TORQUE_CONTROL, force=allowed)

    def bear(self, gravity: Vector) -> None:
        """Hold up, in the coming step, the links that gravity (m/s²) does not pull."""
        for index, mass in self._afloat:
            if index == ROOT:
                place, _ = self.com_place()
            else:
                place = pybullet.getLinkState(self.unique_id, index, 0, 1, self.client)[0]
            lift = tuple(-mass * part for part in gravity)
            self._call(pybullet.applyExternalForce, index, lift, place, pybullet.WORLD_FRAME)

    def joint_state(self, name: str) -> JointState:
        """Return the state of a joint; raises KeyError for an unknown name."""
        index = self._joints[name]
        position, velocity, _, effort = pybullet.getJointState(self.unique_id, index, self.client)
        return JointState(position, velocity, effort)

    def set_joint(self, name: str, position: float, velocity: float = 0.0) -> None:
        """Put a joint somewhere (rad or m); raises KeyError for an unknown name."""
        self._call(pybullet.resetJointState, self._joints[name], position, velocity)

    def drive_joint(self, name: str, velocity: float, effort: float) -> None:
        """Let a motor turn a joint from now on; raises KeyError for an unknown name.

        It tries to reach a velocity (rad/s or m/s) and exerts an effort (N m or N) at most.
        """
        velocity, effort = net_motor(self._joint(name), velocity, effort)
        self._control(name, pybullet.VELOCITY_CONTROL, targetVelocity=velocity, force=effort)

    def hold_joint(
        self, name: str, position: float, effort: float, gain: float = HOLDING_GAIN
    ) -> None:
        """Let a motor hold a joint at a position (rad or m) with at most `effort` (N m or N).

        `gain` is what part of its distance from there it is brought back in one step.
        """
        gains = {"positionGain": gain, "velocityGain": 1.0}
        force = net_motor(self._joint(name), 0.0, effort)[1]
        target = {"targetPosition": position, "targetVelocity": 0.0, "force": force}
        self._control(name, pybullet.POSITION_CONTROL, **target, **gains)

    def set_sticking(self, name: str, sticking: bool) -> None:
        """Let the link below a joint stick to what it touches, or roll and slide again.

        Bullet's friction stops velocities up to its solver's tolerance, so what stands still
        creeps. A point that sticks is pulled back to where it first touched, by a force within
        the limits of friction. Not for wheels that roll: they would bump.
        """
        for index in self._links[self.part_at(self._joints[name]).link.name]:
            if self.traction is not None and self.traction.rubs(index):
                continue
            self._call(pybullet.changeDynamics, index, frictionAnchor=int(sticking))
            if sticking:
                # Only new points stick: setting the filter, to what it is, drops the old.
                self._call(pybullet.setCollisionFilterGroupMask, index, *FREE_BODY_FILTER)

    def remove_sliding_friction(self) -> None:
        """Let the body slide freely, for a device that models its friction itself."""
        for index in range(ROOT, len(self.parts) - 1):
            self._call(pybullet.changeDynamics, index, lateralFriction=0.0)
        slick = (replace(part, surface=replace(part.surface, friction=0.0)) for part in self.parts)
        self.parts = tuple(slick)
        self.traction = None

    def link_index(self, name: str) -> int:
        """Return PyBullet's index of a link, -1 for the root."""
        return self.link_indices(name)[0]

    def link_indices(self, name: str) -> Tuple[int, ...]:
        """Return PyBullet's indices of a link and of the helpers that carry its other shapes."""
        return self._links.get(name, (ROOT,))

    def part_at(self, index: int) -> Part:
        """Return the part that has an index of PyBullet's."""
        return self.parts[index - ROOT]

    def change_joint(self, joint: Joint) -> None:
        """Let the joint of that name allow and resist something else; raises KeyError."""
        index = self._joints[joint.name]
        part = self._replace_part(index, joint=joint)
        properties = joint_properties(joint, self.parts[part.parent].link, part.link)
        self._call(pybullet.changeDynamics, index, **properties)

    def change_inertia(self, link: str, inertia: Inertia) -> None:
        """Change mass and moments of a link.

        Raises:
            PhysicsError: no body has such, or its principal frame would lie elsewhere.
        """
        index = self.link_index(link)
        moments, frame = principal_axes(inertia)
        before = self.part_at(index).mass_properties()[2]
        if inertia.mass <= 0.0 or min(moments) <= 0.0:
            raise PhysicsError(f"link '{link}': no body has such a mass and inertia")
        if not same_place(frame, before):
            where = "its centre of mass and principal axes stay where they are"
            raise PhysicsError(f"link '{link}': {where}, once it is there")
        self._replace_part(index, link=replace(self.part_at(index).link, inertia=inertia))
        properties = {"mass": inertia.mass, "localInertiaDiagonal": moments}
        self._call(pybullet.changeDynamics, index, **properties)
        if self.traction is not None:
            self.traction.tune()

    def change_gravity(self, link: str, pulls: bool) -> None:
        """Let gravity pull a link, or not."""
        index = self.link_index(link)
        self._replace_part(index, link=replace(self.part_at(index).link, gravity=pulls))

    def _weigh(self) -> None:
        """Take note of what gravity pulls."""
        masses = [(index, part.mass_properties()[0]) for index, part in enumerate(self.parts, ROOT)]
        total = sum(mass for _, mass in masses)
        floating = [(i, mass) for i, mass in masses if mass and not self.part_at(i).link.gravity]
        self._afloat, self.floats = tuple(floating), bool(floating)
        self.weight = 1.0 - sum(mass for _, mass in floating) / total if total else 1.0

    def _replace_part(self, index: int, **changes: Any) -> Part:
        parts = list(self.parts)
        parts[index - ROOT] = replace(parts[index - ROOT], **changes)
        self.parts = tuple(parts)
        self._weigh()
        return parts[index - ROOT]

    def _joint(self, name: str) -> Joint:
        return self.part_at(self._joints[name]).joint

    def settle(self) -> None:
        """Take off, before a step, what threw the body out of what it was put into.

        Gazebo lets no contact push faster than its maxVel. Here it pushes as fast as it needs to
        end the overlap, which would throw a robot that is put 0.1 m into the floor up by 100 m.
        """
        first = self.settling == SETTLING_STEPS
        self.settling -= 1
        if first:
            # Nothing is known yet of what it touches there.
            return
        deepest = min(self.near_points(), key=lambda point: point[8], default=None)
        deep = deepest is not None and deepest[8] < -DEEP
        if deep:
            self._way_out = deepest[7]
        if self._way_out != NOWHERE:
            (linear, _), out = self.velocity(), self._way_out
            if sum(v * n for v, n in zip(linear, out)) > SLOW:
                self.set_velocity(*self._given)
        if not deep:
            self.settling = 0

    def _put(self, pose: Pose, linear: Vector, angular: Vector) -> None:
        com = pose * self._com
        self._call(pybullet.resetBasePositionAndOrientation, com.position, com.quaternion)
        self.set_velocity(linear, angular)
        self._given = (linear, angular)
        self._way_out, self.settling = NOWHERE, SETTLING_STEPS
        if self.traction is not None:
            self.traction.forget()

    def _control(self, joint: str, mode: int, **targets: float) -> None:
        self._call(pybullet.setJointMotorControl2, self._joints[joint], mode, **targets)

    def _call(self, function: Callable[..., Any], *arguments: Any, **more: Any) -> None:
        function(self.unique_id, *arguments, physicsClientId=self.client, **more)


class Physics:
    """A PyBullet world, headless; `step()` advances it by 1 ms."""

    def __init__(self, gravity: Vector):
        self.gravity = gravity
        self.client = pybullet.connect(pybullet.DIRECT)
        self.step = partial(pybullet.stepSimulation, self.client)
        pybullet.setGravity(*gravity, physicsClientId=self.client)
        pybullet.setTimeStep(STEP_SECONDS, self.client)
        pybullet.setPhysicsEngineParameter(
            deterministicOverlappingPairs=1, physicsClientId=self.client
        )
        self._maker = BodyMaker(self.client)
        self._bodies: Dict[int, Body] = {}

    def close(self) -> None:
        """Give everything back; the object is of no use afterwards."""
        if self.client >= 0:
            pybullet.disconnect(self.client)
            self.client = -1

    def set_gravity(self, gravity: Vector) -> None:
        """Change gravity, in m/s²."""
        self.gravity = gravity
        pybullet.setGravity(*gravity, physicsClientId=self.client)

    def add(self, model: Model) -> Dict[str, Body]:
        """Load a model at its pose and return its bodies by the name of their root link.

        Raises:
            PhysicsError: a link that moves has no mass, there are too many, or PyBullet's refusal.
            MeshError: a mesh is not usable.
        """
        bodies: Dict[str, Body] = {}
        by_name = model.links_by_name()
        try:
            for root in model.root_links():
                names = top_down(root.name, model.joints)
                links = [by_name[name] for name in names]
                joints = [joint for joint in model.joints if joint.parent in names]
                # Without a mass, a body's root never moves; without a centre of mass, the body's
                # frame is that of its root link.
                held = len(links) if model.static else int(root.anchored)
                links[:held] = [replace(link, inertia=None) for link in links[:held]]
                for link in links[held:]:
                    if link.inertia is None or link.inertia.mass == 0.0:
                        raise PhysicsError(f"link '{link.name}' moves and has no mass")
                place = model.pose * root.pose
                skidding = [] if held else skidding_wheels(links, joints)
                if skidding:
                    links = fit_for_skidding(links, skidding)
                body = Body(self.client, *self._maker.make(links, joints, model.static, place))
                bodies[root.name] = self._bodies[body.unique_id] = body
                if skidding:
                    body.traction = Traction(body, skidding, self._bodies)
                if any(link.self_collide for link in links):
                    part_the_links(body)
                body.place(place)
                names = [wheel.link for wheel in skidding]
                rest = [link for link in links if link.name not in names]
                if not model.static and wants_friction_pyramid(rest, joints):
                    self._use_friction_pyramid()
        except LabError as error:
            self.remove(bodies)
            if isinstance(error, PhysicsError):
                raise PhysicsError(f"model '{model.name}': {error}") from error
            raise
        return bodies

    def _use_friction_pyramid(self) -> None:
        """Limit friction along two directions each for itself, in the whole world.

        ODE, Gazebo's engine, does so by default. Bullet's default, a cone, solves the directions
        together, and wheels that slip sideways while they are driven then hardly push.
        """
        pybullet.setPhysicsEngineParameter(enableConeFriction=0, physicsClientId=self.client)

    def remove(self, bodies: Dict[str, Body]) -> None:
        """Take the bodies of a model out of the world."""
        for body in bodies.values():
            self._maker.take_away(body.unique_id)
            del self._bodies[body.unique_id]
        for body in self._bodies.values():
            if body.traction is not None:
                body.traction.forget_others()


def same_place(one: Pose, other: Pose) -> bool:
    """Return whether two poses are the same, but for rounding."""
    way = one.inverse() * other
    return max(map(abs, (*way.position, *way.quaternion[:3]))) < NEARLY


def part_the_links(body: Body) -> None:
    """Say which links of a self-colliding body touch each other, and which do not.

    As in Gazebo, two links touch if one of them says so, but never over a joint.
    """
    joined = {(part.joint.parent, part.link.name) for part in body.parts if part.joint}
    for (first, one), (second, other) in combinations(enumerate(body.parts, start=-1), 2):
        names = (one.link.name, other.link.name)
        apart = names[0] == names[1] or names in joined or names[::-1] in joined
        touchy = one.link.self_collide or other.link.self_collide
        # Of every pair: PyBullet remembers what was said of a body that had this id before.
        ends = (body.unique_id, body.unique_id, first, second)
        together = int(touchy and not apart)
        pybullet.setCollisionFilterPair(*ends, together, physicsClientId=body.client)
