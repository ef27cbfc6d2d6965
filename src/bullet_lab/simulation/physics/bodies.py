"""Bodies in the engine: their places, velocities, joints and links."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Callable, Sequence

from bullet_lab.core.pose import Pose, Vector, add, cross, dot
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.physics import PhysicsError, pybullet
from bullet_lab.simulation.physics.surfaces import ContactSurface
from bullet_lab.simulation.world.description import (
    NO_LIMIT,
    Collision,
    Inertia,
    Joint,
    Link,
)
from bullet_lab.simulation.world.tree import mobility, principal_axes

# PyBullet's index of the root link.
ROOT = -1
# PyBullet's id of no shape.
NO_SHAPE = -1
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
# The joint that fixes a helper link.
HELPER_JOINT = Joint("", "fixed", "", "")


def is_contact(point: tuple) -> bool:
    """Return whether one of PyBullet's contact points is a contact.

    PyBullet also lists points that are merely near. Shapes that come apart overlap without force.
    """
    distance, force = point[8], point[9]
    return force > 0.0 or distance < 0.0


@dataclass(frozen=True)
class JointState:
    """Position (rad or m), velocity (rad/s or m/s) and effort (N m or N) of one joint."""

    position: float
    velocity: float
    effort: float


@dataclass(frozen=True)
class BulletLink:
    """One of PyBullet's links: a link of the description, or a helper link fixed to one.

    Attributes:
        link: of the description.
        joint: that it hangs on; None for the root.
        parent: place of its parent in the list of links.
        shapes: that it carries.
        shape: PyBullet's id of those shapes.
        surface: of those shapes.
        origin: PyBullet's origin of the link, where its joint is, in the frame of the link (m).
    """

    link: Link
    joint: Joint | None
    parent: int
    shapes: tuple[Collision, ...] = ()
    shape: int = NO_SHAPE
    surface: ContactSurface = ContactSurface()
    origin: Vector = ZERO

    def mass_properties(self) -> tuple[float, Vector, Pose]:
        """Return mass in kg, principal moments in kg m², and the pose of the principal frame."""
        if self.joint is HELPER_JOINT or self.link.inertia is None:
            return 0.0, ZERO, Pose()
        return (self.link.inertia.mass, *self._principal_axes)

    @cached_property
    def _principal_axes(self) -> tuple[Vector, Pose]:
        # Each name of a contact's shape needs them.
        return principal_axes(self.link.inertia)

    def joint_properties(self, parent: Link) -> dict[str, float]:
        """Return damping and limits of its joint to a parent, as PyBullet's properties of it.

        PyBullet computes the damping in a step from the velocity before the step. A strong damper
        on a light link would so reverse the velocity, and oscillate ever more. So the damping is
        limited to what stops the two links at once, if nothing else held them.
        """
        joint = self.joint
        if joint is None or joint.kind == "ball":
            return {}
        properties = {"jointDamping": joint.damping}
        if joint.damping > 0.0:
            # The relative acceleration per effort, if nothing else held the two.
            axis = joint.pose.rotate(joint.axis)
            ends = ((self.link.inertia, joint.axis), (parent.inertia, axis))
            turning = joint.kind != "prismatic"
            loose = sum(mobility(part, axis, turning) for part, axis in ends if part is not None)
            if loose > 0.0:
                properties["jointDamping"] = min(joint.damping, STEPS_PER_SECOND / loose)
        limits = joint.limits
        if joint.kind in ("revolute", "prismatic") and ("lower" in limits or "upper" in limits):
            # A lower limit above the upper one means no limit; PyBullet ignores both.
            properties["jointLowerLimit"] = limits.get("lower", -NO_LIMIT)
            properties["jointUpperLimit"] = limits.get("upper", NO_LIMIT)
        return properties


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
        model: name of the model that it belongs to.
        unique_id: PyBullet's id of it.
        bullet_links: PyBullet's links of it, in order; the first is the root, with index -1.
        links: of the description, the root first.
        joint_names: of the movable joints, less ball joints, which have no single position.
        turned_inertia: whether the root's principal axes differ from its frame's.
        weightless: PyBullet's index and the mass (kg) of the links that gravity does not pull.
        moves: whether its root can move.
        last_place: `com_place()` after the last step, or after it was placed.
        weight: the share of its mass that gravity pulls.
        settling: the number of steps for which `settle` still limits its speed.
        traction: the `Traction` of wheels whose friction Bullet cannot compute, if it has any.
        commanded_velocity: function of a plugin that sets the velocity before each step: returns
            it (m/s, of all centres of mass, and rad/s), as it is before friction acts; or None.
    """

    model: str = ""
    traction: Any = None
    commanded_velocity: Callable[[], tuple[Vector, Vector]] | None = None

    def __init__(self, client: int, unique_id: int, bullet_links: Sequence[BulletLink]):
        self.client = client
        self.unique_id = unique_id
        self.bullet_links = tuple(bullet_links)
        self.com_place = partial(pybullet.getBasePositionAndOrientation, unique_id, client)
        self.set_velocity = partial(pybullet.resetBaseVelocity, unique_id, physicsClientId=client)
        self.near_points = partial(pybullet.getContactPoints, unique_id, physicsClientId=client)
        mass, _, self._com = bullet_links[0].mass_properties()
        self.moves = mass > 0.0
        self.last_place = self.com_place()
        self._com_inverse = self._com.inverse()
        self.turned_inertia = self._com.quaternion != NO_TURN
        self.settling = 0
        # The normal of the deepest contact since the body was placed.
        self._exit_direction = ZERO
        self._placed_velocity = (ZERO, ZERO)
        self._indices: defaultdict[str, list[int]] = defaultdict(list)
        self._joints: dict[str, int] = {}
        self._balls: list[int] = []
        for index, one in enumerate(bullet_links, start=ROOT):
            self._indices[one.link.name].append(index)
            if one.joint and one.joint.kind == "ball":
                self._balls.append(index)
                # PyBullet holds every joint still with a motor of its own.
                free = {"targetPosition": NO_TURN, "positionGain": 0.0, "force": ZERO}
                mode = pybullet.POSITION_CONTROL
                self._call(pybullet.setJointMotorControlMultiDof, index, mode, **free)
            elif one.joint and one.joint.kind != "fixed":
                self._joints[one.joint.name] = index
                self.drive_joint(one.joint.name, 0.0, 0.0)
        self.joint_names = tuple(self._joints)
        self._note_links()

    def pose(self) -> Pose:
        """Return the pose of the root link's frame in the world."""
        return self.com_pose() * self._com_inverse

    def com_pose(self) -> Pose:
        """Return the pose of the root link's principal frame in the world."""
        return Pose(*self.com_place())

    def link_place(self, index: int) -> tuple:
        """Return position and quaternion of the principal frame of a link by PyBullet's index."""
        if index == ROOT:
            return self.com_place()
        # The last argument lets PyBullet compute the pose anew: its copy may be out of date.
        return pybullet.getLinkState(self.unique_id, index, 0, 1, self.client)[:2]

    def velocity(self) -> tuple[Vector, Vector]:
        """Return linear (m/s, of the centre of mass) and angular (rad/s) velocity, in the world."""
        return pybullet.getBaseVelocity(self.unique_id, self.client)

    def origin_velocity(self) -> tuple[Vector, Vector]:
        """Return linear (m/s, of the root frame's origin) and angular (rad/s) velocity."""
        (vx, vy, vz), (wx, wy, wz) = self.velocity()
        x, y, z = self.com_pose().rotate(self._com_inverse.position)
        linear = (vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x)
        return linear, (wx, wy, wz)

    def is_finite(self) -> bool:
        """Return whether its pose and its joints' positions are finite."""
        position, quaternion = self.last_place if self.moves else self.com_place()
        place = sum(position) + sum(quaternion)
        return math.isfinite(place + sum(self.joint_state(name).position for name in self._joints))

    def place(self, pose: Pose) -> None:
        """Place the body at rest, its joints at zero."""
        self.move(pose, ZERO, ZERO)
        # Of a body without contacts, this would only change the order in which they come.
        for index in sorted({point[3] for point in self.near_points()}):
            if self.bullet_links[index - ROOT].mass_properties()[0] > 0.0:
                self._drop_contacts(index)
        for name in self._joints:
            self.set_joint(name, 0.0)
        for index in self._balls:
            self._call(pybullet.resetJointStateMultiDof, index, NO_TURN, ZERO)

    def move(self, pose: Pose, linear: Vector, angular: Vector) -> None:
        """Place the body in motion; its joints keep their positions and stand still.

        The velocities, in m/s and rad/s in the world, are those of the root link's frame.
        """
        com, arm = pose * self._com, pose.rotate(self._com.position)
        self._call(pybullet.resetBasePositionAndOrientation, com.position, com.quaternion)
        self.last_place = self.com_place()
        self._placed_velocity = (add(linear, cross(angular, arm)), angular)
        self.set_velocity(*self._placed_velocity)
        self._exit_direction = ZERO
        self.settling = SETTLING_STEPS
        if self.traction is not None:
            self.traction.reset()
        for name in self._joints:
            self.set_joint(name, self.joint_state(name).position)
        for index in self._balls:
            turn = pybullet.getJointStateMultiDof(self.unique_id, index, self.client)[0]
            self._call(pybullet.resetJointStateMultiDof, index, turn, ZERO)

    def push(self, link: str, force: Vector, torque: Vector, point: Vector) -> None:
        """Apply a force (N, at a point in m) and a torque (N m) to a link in the coming step.

        All vectors are in the world.
        """
        index = self.link_index(link)
        self.push_at(index, force, point)
        self._call(pybullet.applyExternalTorque, index, torque, pybullet.WORLD_FRAME)

    def push_at(self, index: int, force: Vector, point: Vector) -> None:
        """Apply a force (N, at a point in m) to the link with PyBullet's index."""
        pybullet.applyExternalForce(
            self.unique_id, index, force, point, pybullet.WORLD_FRAME, self.client
        )

    def exert(self, joint: str, effort: float) -> None:
        """Apply an effort (N m or N) to a joint in the coming step, in addition to its motor.

        As in Gazebo, the effort is within the joint's effort limit, and zero in the direction in
        which the joint moves faster than its velocity limit. A negative limit means none.
        """
        limits = self._joint(joint).limits
        most, fastest = (limits.get(key, -1.0) for key in ("effort", "velocity"))
        if fastest >= 0.0:
            velocity = self.joint_state(joint).velocity
            if abs(velocity) > fastest and velocity * effort > 0.0:
                effort = 0.0
        if most >= 0.0:
            effort = min(max(effort, -most), most)
        self._control(joint, pybullet.TORQUE_CONTROL, force=effort)

    def cancel_gravity(self, gravity: Vector) -> None:
        """Hold up the links without gravity (m/s²) in the coming step."""
        for index, mass in self.weightless:
            lift = tuple(-mass * value for value in gravity)
            self.push_at(index, lift, self.link_place(index)[0])

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

        Raises KeyError for an unknown name.
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
            if self.traction is not None and index in self.traction.owners:
                continue
            self._call(pybullet.changeDynamics, index, frictionAnchor=int(sticking))
            if sticking:
                # Only new points stick.
                self._drop_contacts(index)

    def _drop_contacts(self, index: int) -> None:
        """Forget a link's contact points, from whose last forces a step would begin."""
        # Setting the unchanged filter does that.
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

    def link_indices(self, name: str) -> list[int]:
        """Return PyBullet's indices of a link and of its helper links."""
        return self._indices[name]

    def link_at(self, index: int) -> BulletLink:
        """Return the link with PyBullet's index."""
        return self.bullet_links[index - ROOT]

    def touching_points(self) -> list[tuple]:
        """Return PyBullet's points where the body touches another; the body itself comes first."""
        return [point for point in self.near_points() if is_contact(point)]

    def change_joint(self, joint: Joint) -> None:
        """Change limits and damping of the joint of that name; raises KeyError."""
        index = self._joints[joint.name]
        changed = self._replace_link(index, joint=joint)
        parent = self.bullet_links[changed.parent].link
        self._call(pybullet.changeDynamics, index, **changed.joint_properties(parent))

    def change_link(self, name: str, inertia: Inertia, gravity: bool) -> None:
        """Change mass and moments of a link, and whether gravity pulls it.

        Raises PhysicsError if one is not positive, or the principal frame would move.
        """
        index = self.link_index(name)
        moments, frame = principal_axes(inertia)
        if inertia.mass <= 0.0 or min(moments) <= 0.0:
            raise PhysicsError(f"link '{name}': its mass and its moments must be positive")
        before = self.link_at(index).mass_properties()[2]
        shift = frame.inverse() * before
        if max(map(abs, (*shift.position, *shift.quaternion[:3]))) >= NEARLY:
            problem = "its centre of mass and its principal axes cannot be changed"
            raise PhysicsError(f"link '{name}': {problem} in a running simulation")
        link = replace(self.link_at(index).link, inertia=inertia, gravity=gravity)
        self._replace_link(index, link=link)
        properties = {"mass": inertia.mass, "localInertiaDiagonal": moments}
        self._call(pybullet.changeDynamics, index, **properties)
        if self.traction is not None:
            self.traction.update_gains()

    def _note_links(self) -> None:
        """Note what the links are now, and which of them gravity does not pull."""
        every = self.bullet_links
        self.links = tuple(one.link for one in every if one.joint is not HELPER_JOINT)
        masses = [one.mass_properties()[0] for one in every]
        total = sum(masses)
        self.weightless = tuple(
            (index, mass)
            for index, (mass, one) in enumerate(zip(masses, every), ROOT)
            if mass and not one.link.gravity
        )
        self.weight = 1.0 - sum(mass for _, mass in self.weightless) / total if total else 1.0

    def _replace_link(self, index: int, **changes: Any) -> BulletLink:
        links = list(self.bullet_links)
        links[index - ROOT] = replace(links[index - ROOT], **changes)
        self.bullet_links = tuple(links)
        self._note_links()
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
            self._exit_direction = deepest[7]
        if self._exit_direction != ZERO:
            linear, _ = self.velocity()
            if dot(linear, self._exit_direction) > SLOW:
                self.set_velocity(*self._placed_velocity)
        if not deep:
            self.settling = 0

    def _control(self, joint: str, mode: int, **targets: float) -> None:
        self._call(pybullet.setJointMotorControl2, self._joints[joint], mode, **targets)

    def _call(self, function: Callable[..., Any], *arguments: Any, **more: Any) -> None:
        function(self.unique_id, *arguments, physicsClientId=self.client, **more)


def net_motor(joint: Joint, velocity: float, effort: float) -> tuple[float, float]:
    """Return the velocity and greatest effort of a motor, together with the joint's friction.

    Friction helps a motor that stops the joint, and hinders one that moves it.
    """
    friction = max(0.0, joint.friction)
    if velocity == 0.0:
        return 0.0, effort + friction
    if effort > friction:
        return velocity, effort - friction
    return 0.0, friction - effort
