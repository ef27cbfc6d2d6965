"""Making bodies by PyBullet's calls, with what their joints allow and resist.

PyBullet takes 16 shapes in one call, and a mesh by its corners alone, and has one friction and
softness for a link. So a link carries the first such group of its shapes, and helper links without
mass, fixed to it, carry one more each. It gives shapes back only with the whole world, so equal
ones are made once. Of each body it keeps the list of its shapes, 0.8 kB or more; so the last static
ones that were taken away wait elsewhere, for models that come back.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from typing import Any, Callable, Dict, Hashable, List, Optional, Sequence, Tuple

from bullet_lab.core.native_output import hidden_native_output
from bullet_lab.core.pose import Pose, Vector, subtract
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.physics.engine import PhysicsError, pybullet
from bullet_lab.simulation.physics.surfaces import Surface, axle_of, by_surface, on_treads
from bullet_lab.simulation.world.description import Collision, Joint, Link
from bullet_lab.simulation.world.inertia import FARTHEST, FASTEST, mobility, principal_axes
from bullet_lab.simulation.world.meshes import file_version, hull_corners, triangle_corners
from bullet_lab.simulation.world.shapes import Box, Cylinder, Mesh, Plane, Sphere

# PyBullet's limits: of shapes in one call, and of links beside the root in one body.
MOST_SHAPES = 16
MOST_LINKS = 127
# "No shape" and "the root link" in PyBullet's numbers.
NONE = ROOT = -1
JOINT_TYPES = {
    "fixed": pybullet.JOINT_FIXED,
    "continuous": pybullet.JOINT_REVOLUTE,
    "revolute": pybullet.JOINT_REVOLUTE,
    "prismatic": pybullet.JOINT_PRISMATIC,
    "ball": pybullet.JOINT_SPHERICAL,
}
# What `createCollisionShapeArray` is told of a shape; a mesh is made by its corners.
SHAPES: Dict[type, Callable[[Any], Dict[str, Any]]] = {
    Box: lambda box: {
        "shapeTypes": pybullet.GEOM_BOX,
        "halfExtents": tuple(0.5 * side for side in box.size),
    },
    Cylinder: lambda cylinder: {
        "shapeTypes": pybullet.GEOM_CYLINDER,
        "radii": cylinder.radius,
        "lengths": cylinder.length,
    },
    Sphere: lambda sphere: {"shapeTypes": pybullet.GEOM_SPHERE, "radii": sphere.radius},
    Plane: lambda plane: {"shapeTypes": pybullet.GEOM_PLANE, "planeNormals": plane.normal},
}
# For what a shape has not.
NO_MEASURES = {
    "radii": 0.0,
    "halfExtents": (0.0, 0.0, 0.0),
    "lengths": 0.0,
    "planeNormals": (0.0, 0.0, 1.0),
}
# Around convex meshes, in m, instead of Bullet's 1 mm. Without one, most rays go through them.
SKIN = 1e-4
ORIGIN: Vector = (0.0, 0.0, 0.0)
# What carries no shapes: none, PyBullet's id of none, and a surface.
EMPTY = ((), NONE, Surface())
HELPER_JOINT = Joint("", "fixed", "", "")
# Bullet's collision group and mask of what never moves: it touches all but its like.
STATIC_FILTER = (2, ~2)
# Of what has been taken away: nothing touches it and no ray meets it, wherever it is.
AWAY_FILTER = (0, 0)
AWAY: Vector = (0.0, 0.0, -FARTHEST)
# Bodies that wait there: each takes 0.3 us of a step, which has 5 with the smallest robot.
KEPT_BODIES = 6


@dataclass(frozen=True)
class Part:
    """What is one link to PyBullet: a link of the description, or a helper fixed to one.

    It hangs on `joint`, None for the root; `parent` is its parent's place in the list of parts,
    and `shape` PyBullet's id of the `shapes` that it carries, which share a `surface`. PyBullet has
    its joint in its origin, which is at the place `origin` (m) in the frame of the link.
    """

    link: Link
    joint: Optional[Joint]
    parent: int
    shapes: Tuple[Collision, ...] = ()
    shape: int = NONE
    surface: Surface = Surface()
    origin: Vector = (0.0, 0.0, 0.0)

    def mass_properties(self) -> Tuple[float, Vector, Pose]:
        """Return mass in kg, principal moments in kg m², and the pose of the principal frame."""
        if self.joint is HELPER_JOINT or self.link.inertia is None:
            return 0.0, (0.0, 0.0, 0.0), Pose()
        return (self.link.inertia.mass, *principal_axes(self.link.inertia))


class BodyMaker:
    """Makes the bodies of one PyBullet client."""

    def __init__(self, client: int):
        self._client = client
        self._made: Dict[Hashable, List[int]] = {}
        # What tells bodies apart that may come back: of those in use, and of those that are away.
        self._kinds: Dict[int, Hashable] = {}
        self._away: Dict[int, Hashable] = {}

    @hidden_native_output()
    def make(
        self, links: Sequence[Link], joints: Sequence[Joint], static: bool, pose: Pose
    ) -> Tuple[int, List[Part]]:
        """Make a body; return PyBullet's id of it and its parts, all helpers last.

        Args:
            links: the root first and each after the one that carries it.
            joints: between them.
            static: whether it never moves; then it keeps the hollows of its meshes.
            pose: of the root link's frame in the world.

        Raises:
            MeshError: a mesh is not usable.
            PhysicsError: there are more parts than PyBullet can hold, or PyBullet's refusal.
        """
        try:
            parts = self._parts(links, joints, static)
            if len(parts) - 1 > MOST_LINKS:
                need = f"its joints and shapes need {len(parts) - 1} links beside the root"
                raise PhysicsError(f"{need}, and the engine holds {MOST_LINKS}")
            kind = (parts[0].shape, parts[0].surface) if static and len(parts) == 1 else None
            body = self._back(kind, pose)
            if body is None:
                body = self._make(parts, pose)
            self._tune(body, parts, static)
            self._kinds[body] = kind
            return body, parts
        except pybullet.error as error:
            raise PhysicsError(f"PyBullet cannot make it: {error}") from error

    def take_away(self, body: int) -> None:
        """Take a body out of the world."""
        kind = self._kinds.pop(body)
        if kind is None:
            pybullet.removeBody(body, self._client)
            return
        self._put(body, Pose(AWAY), AWAY_FILTER)
        self._away[body] = kind
        if len(self._away) > KEPT_BODIES:
            oldest = next(iter(self._away))
            del self._away[oldest]
            pybullet.removeBody(oldest, self._client)

    def _back(self, kind: Optional[Hashable], pose: Pose) -> Optional[int]:
        """Return a body of a kind that was away, now at a pose, or None."""
        body = next((body for body, one in self._away.items() if one == kind), None)
        if body is not None:
            del self._away[body]
            self._put(body, pose, STATIC_FILTER)
        return body

    def _put(self, body: int, pose: Pose, groups: Tuple[int, int]) -> None:
        """Put a static body somewhere, and say what it touches there."""
        pybullet.resetBasePositionAndOrientation(body, *astuple(pose), physicsClientId=self._client)
        # This forgets what it touched, too.
        pybullet.setCollisionFilterGroupMask(body, ROOT, *groups, self._client)

    def _parts(self, links: Sequence[Link], joints: Sequence[Joint], static: bool) -> List[Part]:
        above = {joint.child: joint for joint in joints}
        places = {link.name: place for place, link in enumerate(links)}
        parts, helpers = [], []
        for place, link in enumerate(links):
            joint = above.get(link.name)
            origin, parent = (joint.anchor, places[joint.parent]) if joint else (ORIGIN, ROOT)
            first, *more = self._shapes(link, axle_of(joint), static, origin) or [EMPTY]
            parts.append(Part(link, joint, parent, *first, origin))
            helpers += [Part(link, HELPER_JOINT, place, *group, origin) for group in more]
        return parts + helpers

    def _make(self, parts: Sequence[Part], pose: Pose) -> int:
        (mass, _, centre), *masses = [part.mass_properties() for part in parts]
        joints = [part.joint for part in parts if part.joint is not None]
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_MAINTAIN_LINK_ORDER
        if any(part.link.self_collide for part in parts):
            flags |= pybullet.URDF_USE_SELF_COLLISION
        return pybullet.createMultiBody(
            *(mass, parts[0].shape, NONE, *astuple(pose), *astuple(centre)),
            linkMasses=[mass for mass, _, _ in masses],
            linkCollisionShapeIndices=[part.shape for part in parts[1:]],
            linkVisualShapeIndices=[NONE for _ in masses],
            linkPositions=[_joint_place(part, parts) for part in parts[1:]],
            linkOrientations=[joint.pose.quaternion for joint in joints],
            linkInertialFramePositions=[
                subtract(centre.position, part.origin)
                for part, (_, _, centre) in zip(parts[1:], masses)
            ],
            linkInertialFrameOrientations=[centre.quaternion for _, _, centre in masses],
            linkParentIndices=[part.parent for part in parts[1:]],
            linkJointTypes=[JOINT_TYPES[joint.kind] for joint in joints],
            linkJointAxis=[joint.axis for joint in joints],
            flags=flags,
            physicsClientId=self._client,
        )

    def _tune(self, body: int, parts: Sequence[Part], static: bool) -> None:
        """Tell PyBullet of a body what `createMultiBody` does not take."""
        # Not in one call with what is a link's: these turn any link's index into the root's.
        self._change(body, ROOT, linearDamping=0.0, angularDamping=0.0, maxJointVelocity=FASTEST)
        for index, part in enumerate(parts, start=ROOT):
            _, moments, frame = part.mass_properties()
            given = {"localInertiaDiagonal": moments, **part.surface.properties(frame, static)}
            if part.joint:
                given.update(joint_properties(part.joint, parts[part.parent].link, part.link))
            self._change(body, index, **given)
            if static and index > ROOT:
                pybullet.setCollisionFilterGroupMask(body, index, *STATIC_FILTER, self._client)

    def _change(self, body: int, index: int, **properties: Any) -> None:
        pybullet.changeDynamics(body, index, physicsClientId=self._client, **properties)

    def _shapes(
        self, link: Link, axle: Optional[Vector], static: bool, origin: Vector
    ) -> List[Tuple[Tuple[Collision, ...], int, Surface]]:
        """Return the shapes of a link as PyBullet takes them in one call, with its ids of them.

        PyBullet's origin of the link is at a place (m) in its frame.
        """
        groups: List[Tuple[List[Collision], Surface]] = []
        for surface, shapes in by_surface(link.collisions, axle):
            simple = [shape for shape in shapes if not isinstance(shape.geometry, Mesh)]
            starts = range(0, len(simple), MOST_SHAPES)
            groups += [(simple[start : start + MOST_SHAPES], surface) for start in starts]
            groups += [([s], surface) for s in shapes if isinstance(s.geometry, Mesh)]
        return [
            (tuple(group), made, surface)
            for group, surface in groups
            for made in self._once(group, axle, static, origin)
        ]

    def _once(
        self, group: Sequence[Collision], axle: Optional[Vector], static: bool, origin: Vector
    ) -> List[int]:
        """Return PyBullet's ids of a group of shapes, or of the pieces of a mesh."""
        shapes = [replace(s, pose=_moved(s.pose, origin)) for s in on_treads(group, axle)]
        mesh, pose = group[0].geometry, shapes[0].pose
        key: Hashable = tuple((shape.geometry, shape.pose) for shape in shapes)
        if isinstance(mesh, Mesh):
            key = (key, file_version(mesh), static)
            if key not in self._made:
                pieces = triangle_corners(mesh) if static else [hull_corners(mesh)]
                self._made[key] = [self._mesh(corners.tolist(), pose, static) for corners in pieces]
        elif key not in self._made:
            self._made[key] = [self._simple(shapes)]
        return self._made[key]

    def _simple(self, group: Sequence[Collision]) -> int:
        told = [{**NO_MEASURES, **SHAPES[type(shape.geometry)](shape.geometry)} for shape in group]
        return pybullet.createCollisionShapeArray(
            **{key: [measures[key] for measures in told] for key in told[0]},
            collisionFramePositions=[shape.pose.position for shape in group],
            collisionFrameOrientations=[shape.pose.quaternion for shape in group],
            physicsClientId=self._client,
        )

    def _mesh(self, corners: List[Vector], pose: Pose, hollow: bool) -> int:
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_MESH,
            vertices=corners,
            # Without triangles, Bullet takes the convex hull.
            indices=list(range(len(corners))) if hollow else [],
            collisionFramePosition=pose.position,
            collisionFrameOrientation=pose.quaternion,
            physicsClientId=self._client,
        )
        # What is set for a shape of one body's root is so for all that have it.
        body = pybullet.createMultiBody(0.0, shape, physicsClientId=self._client)
        self._change(body, ROOT, collisionMargin=0.0 if hollow else SKIN)
        pybullet.removeBody(body, self._client)
        return shape


def _moved(pose: Pose, origin: Vector) -> Pose:
    """Return a pose in a link's frame as PyBullet has it, whose origin is elsewhere."""
    return pose if not any(origin) else Pose(subtract(pose.position, origin), pose.quaternion)


def _joint_place(part: Part, parts: Sequence[Part]) -> Vector:
    """Return the place (m) of a part's joint from PyBullet's origin of its parent."""
    if part.joint is HELPER_JOINT:
        return ORIGIN
    at = part.joint.pose * Pose(part.origin) if any(part.origin) else part.joint.pose
    return subtract(at.position, parts[part.parent].origin)


# Where a joint that is limited on one side ends on the other, as in SDF.
FAR = 1e16
LIMITED = ("revolute", "prismatic")


def joint_properties(joint: Joint, parent: Link, child: Link) -> Dict[str, float]:
    """Return damping and limits of a joint as PyBullet's properties of the link below it.

    PyBullet takes the damping of a step from the velocity before it. A strong damper on a light
    link would so turn the velocity round, and swing up. It gets no stronger here than what stops
    the two links at once, if nothing else held them.
    """
    if joint.kind == "ball":
        return {}
    properties = {"jointDamping": joint.damping}
    if joint.damping > 0.0:
        # The acceleration per effort, if nothing else held the two.
        ends = ((child.inertia, joint.axis), (parent.inertia, joint.pose.rotate(joint.axis)))
        turning = joint.kind != "prismatic"
        loose = sum(mobility(part, axis, turning) for part, axis in ends if part is not None)
        if loose > 0.0:
            properties["jointDamping"] = min(joint.damping, STEPS_PER_SECOND / loose)
    if joint.kind in LIMITED and {"lower", "upper"} & set(joint.limits):
        # A lower limit above the upper one means none, and PyBullet passes over it.
        properties["jointLowerLimit"] = joint.limits.get("lower", -FAR)
        properties["jointUpperLimit"] = joint.limits.get("upper", FAR)
    return properties


def allowed_effort(joint: Joint, effort: float, velocity: float) -> float:
    """Return what is left of an effort (N m or N) on a joint with a velocity (rad/s or m/s).

    As in Gazebo, it is no more than the joint's effort limit, and nothing in the direction in
    which the joint moves faster than its velocity limit. A negative limit is none.
    """
    most, fastest = (joint.limits.get(key, -1.0) for key in ("effort", "velocity"))
    if 0.0 <= fastest < abs(velocity) and velocity * effort > 0.0:
        return 0.0
    return effort if most < 0.0 else min(max(effort, -most), most)


def net_motor(joint: Joint, velocity: float, effort: float) -> Tuple[float, float]:
    """Return the velocity and greatest effort of a motor together with the joint's friction.

    Friction helps a motor that stops the joint, and hinders one that moves it.
    """
    friction = max(0.0, joint.friction)
    if velocity == 0.0:
        return 0.0, effort + friction
    if effort > friction:
        return velocity, effort - friction
    return 0.0, friction - effort
