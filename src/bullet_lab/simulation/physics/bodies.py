"""Making bodies by PyBullet's calls, with the limits and resistance of their joints.

PyBullet's limits: 16 shapes in one call; a mesh by its corners alone; one friction and softness
for a link. So a link carries the first such group of its shapes, and helper links without mass,
fixed to it, carry one more group each. PyBullet frees shapes only with the whole world, so equal
shapes are made once. PyBullet also keeps 0.8 kB or more of each removed body; so the last removed
static bodies wait far away, for models that come back.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from typing import Any, Callable, Dict, Hashable, List, Optional, Sequence, Tuple

from bullet_lab.core.pose import Pose, Vector, subtract
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.entry import hidden_native_output
from bullet_lab.simulation.physics import PhysicsError, pybullet
from bullet_lab.simulation.physics.surfaces import Surface, axle_of, on_treads
from bullet_lab.simulation.world.description import Collision, Joint, Link
from bullet_lab.simulation.world.meshes import file_version
from bullet_lab.simulation.world.shapes import (
    Box,
    Cylinder,
    Mesh,
    Plane,
    Sphere,
    hull_corners,
    triangle_corners,
)
from bullet_lab.simulation.world.tree import FARTHEST, FASTEST, mobility, principal_axes

# PyBullet's limit of shapes in one call.
MOST_SHAPES = 16
# PyBullet's limit of links beside the root in one body.
MOST_LINKS = 127
# PyBullet's index of the root link.
ROOT = -1
# PyBullet's id of no shape.
NO_SHAPE = -1
JOINT_TYPES = {
    "fixed": pybullet.JOINT_FIXED,
    "continuous": pybullet.JOINT_REVOLUTE,
    "revolute": pybullet.JOINT_REVOLUTE,
    "prismatic": pybullet.JOINT_PRISMATIC,
    "ball": pybullet.JOINT_SPHERICAL,
}
# Arguments of `createCollisionShapeArray` for each kind of shape; meshes are made otherwise.
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
# Values of the arguments that a shape does not need.
UNUSED_MEASURES = {
    "radii": 0.0,
    "halfExtents": (0.0, 0.0, 0.0),
    "lengths": 0.0,
    "planeNormals": (0.0, 0.0, 1.0),
}
# Margin of convex meshes in m, instead of Bullet's 1 mm. Without one, most rays pass through them.
MESH_MARGIN = 1e-4
ORIGIN: Vector = (0.0, 0.0, 0.0)
HELPER_JOINT = Joint("", "fixed", "", "")
# Bullet's collision group and mask of static links: they touch everything but each other.
STATIC_FILTER = (2, ~2)
# The same of removed bodies: nothing touches them, and no ray meets them.
REMOVED_FILTER = (0, 0)
REMOVED_PLACE: Vector = (0.0, 0.0, -FARTHEST)
# Removed bodies that are kept: each takes 0.3 us of a step, which takes 5 us for a small robot.
KEPT_BODIES = 6
# Limit (rad or m) of a joint on the side where it has none, as in SDF.
NO_LIMIT = 1e16
LIMITED = ("revolute", "prismatic")


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
    joint: Optional[Joint]
    parent: int
    shapes: Tuple[Collision, ...] = ()
    shape: int = NO_SHAPE
    surface: Surface = Surface()
    origin: Vector = ORIGIN

    def mass_properties(self) -> Tuple[float, Vector, Pose]:
        """Return mass in kg, principal moments in kg m², and the pose of the principal frame."""
        if self.joint is HELPER_JOINT or self.link.inertia is None:
            return 0.0, (0.0, 0.0, 0.0), Pose()
        return (self.link.inertia.mass, *principal_axes(self.link.inertia))

    def joint_place(self, parent_origin: Vector) -> Vector:
        """Return the place (m) of the joint from PyBullet's origin of the parent."""
        if self.joint is HELPER_JOINT:
            return ORIGIN
        pose = self.joint.pose
        if any(self.origin):
            pose = pose * Pose(self.origin)
        return subtract(pose.position, parent_origin)


class BodyMaker:
    """Makes and removes the bodies of one PyBullet client."""

    def __init__(self, client: int):
        self._client = client
        # PyBullet's ids of shapes by what they are made of.
        self._made: Dict[Hashable, List[int]] = {}
        # Shape and surface by body, of static bodies with one link; None for other bodies.
        self._kinds: Dict[int, Hashable] = {}
        # The same of removed bodies that are kept, the oldest first.
        self._removed: Dict[int, Hashable] = {}

    @hidden_native_output()
    def make(
        self, links: Sequence[Link], joints: Sequence[Joint], static: bool, pose: Pose
    ) -> Tuple[int, List[BulletLink]]:
        """Make a body; return PyBullet's id of it and its links, all helpers last.

        Args:
            links: the root first, and each link after its parent.
            joints: between them.
            static: whether the body never moves; its meshes then keep their hollows.
            pose: of the root link's frame in the world.

        Raises:
            MeshError: a mesh is not usable.
            PhysicsError: the body needs too many links, or PyBullet refuses it.
        """
        try:
            made = self._bullet_links(links, joints, static)
            if len(made) - 1 > MOST_LINKS:
                need = f"its joints and shapes need {len(made) - 1} links beside the root"
                raise PhysicsError(f"{need}; the engine allows {MOST_LINKS}")
            kind = (made[0].shape, made[0].surface) if static and len(made) == 1 else None
            body = self._restored(kind, pose)
            if body is None:
                body = self._create(made, pose)
            self._set_dynamics(body, made, static)
            self._kinds[body] = kind
            return body, made
        except pybullet.error as error:
            raise PhysicsError(f"PyBullet cannot make it: {error}") from error

    def remove(self, body: int) -> None:
        """Take a body out of the world."""
        kind = self._kinds.pop(body)
        if kind is None:
            pybullet.removeBody(body, self._client)
            return
        self._place(body, Pose(REMOVED_PLACE), REMOVED_FILTER)
        self._removed[body] = kind
        if len(self._removed) > KEPT_BODIES:
            oldest = next(iter(self._removed))
            del self._removed[oldest]
            pybullet.removeBody(oldest, self._client)

    def _restored(self, kind: Optional[Hashable], pose: Pose) -> Optional[int]:
        """Return a removed body of a kind, now at a pose; None if there is none."""
        for body, removed in self._removed.items():
            if removed == kind:
                del self._removed[body]
                self._place(body, pose, STATIC_FILTER)
                return body
        return None

    def _place(self, body: int, pose: Pose, groups: Tuple[int, int]) -> None:
        pybullet.resetBasePositionAndOrientation(body, *astuple(pose), physicsClientId=self._client)
        # This also drops the contacts of the place before.
        pybullet.setCollisionFilterGroupMask(body, ROOT, *groups, self._client)

    def _bullet_links(
        self, links: Sequence[Link], joints: Sequence[Joint], static: bool
    ) -> List[BulletLink]:
        above = {joint.child: joint for joint in joints}
        places = {link.name: place for place, link in enumerate(links)}
        found, helpers = [], []
        for place, link in enumerate(links):
            joint = above.get(link.name)
            origin, parent = (joint.anchor, places[joint.parent]) if joint else (ORIGIN, ROOT)
            groups = self._shapes(link, axle_of(joint), static, origin)
            first, *more = groups or [((), NO_SHAPE, Surface())]
            found.append(BulletLink(link, joint, parent, *first, origin))
            helpers += [BulletLink(link, HELPER_JOINT, place, *group, origin) for group in more]
        return found + helpers

    def _create(self, links: Sequence[BulletLink], pose: Pose) -> int:
        (mass, _, centre), *masses = [link.mass_properties() for link in links]
        root, *rest = links
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_MAINTAIN_LINK_ORDER
        if any(link.link.self_collide for link in links):
            flags |= pybullet.URDF_USE_SELF_COLLISION
        return pybullet.createMultiBody(
            *(mass, root.shape, NO_SHAPE, *astuple(pose), *astuple(centre)),
            linkMasses=[mass for mass, _, _ in masses],
            linkCollisionShapeIndices=[link.shape for link in rest],
            linkVisualShapeIndices=[NO_SHAPE for _ in rest],
            linkPositions=[link.joint_place(links[link.parent].origin) for link in rest],
            linkOrientations=[link.joint.pose.quaternion for link in rest],
            linkInertialFramePositions=[
                subtract(centre.position, link.origin)
                for link, (_, _, centre) in zip(rest, masses)
            ],
            linkInertialFrameOrientations=[centre.quaternion for _, _, centre in masses],
            linkParentIndices=[link.parent for link in rest],
            linkJointTypes=[JOINT_TYPES[link.joint.kind] for link in rest],
            linkJointAxis=[link.joint.axis for link in rest],
            flags=flags,
            physicsClientId=self._client,
        )

    def _set_dynamics(self, body: int, links: Sequence[BulletLink], static: bool) -> None:
        """Set the properties of a body that `createMultiBody` does not take."""
        # A call of its own: together with these, PyBullet takes any link's index for the root's.
        self._change(body, ROOT, linearDamping=0.0, angularDamping=0.0, maxJointVelocity=FASTEST)
        for index, link in enumerate(links, start=ROOT):
            _, moments, frame = link.mass_properties()
            given = {"localInertiaDiagonal": moments, **link.surface.properties(frame, static)}
            if link.joint:
                given.update(joint_properties(link.joint, links[link.parent].link, link.link))
            self._change(body, index, **given)
            if static and index > ROOT:
                pybullet.setCollisionFilterGroupMask(body, index, *STATIC_FILTER, self._client)

    def _change(self, body: int, index: int, **properties: Any) -> None:
        pybullet.changeDynamics(body, index, physicsClientId=self._client, **properties)

    def _shapes(
        self, link: Link, axle: Optional[Vector], static: bool, origin: Vector
    ) -> List[Tuple[Tuple[Collision, ...], int, Surface]]:
        """Return groups of the link's shapes, each with PyBullet's id and the common surface.

        `origin` is PyBullet's origin of the link in the link's frame, in m.
        """
        by_surface: Dict[Surface, List[Collision]] = {}
        for shape in link.collisions:
            by_surface.setdefault(Surface.of(shape, axle), []).append(shape)
        found = []
        for surface, shapes in by_surface.items():
            simple = [shape for shape in shapes if not isinstance(shape.geometry, Mesh)]
            starts = range(0, len(simple), MOST_SHAPES)
            groups = [simple[start : start + MOST_SHAPES] for start in starts]
            groups += [[shape] for shape in shapes if isinstance(shape.geometry, Mesh)]
            for group in groups:
                ids = self._ids(group, axle, static, origin)
                found += [(tuple(group), shape_id, surface) for shape_id in ids]
        return found

    def _ids(
        self, group: Sequence[Collision], axle: Optional[Vector], static: bool, origin: Vector
    ) -> List[int]:
        """Return PyBullet's ids of a group of shapes, or of the pieces of a mesh."""
        shapes = on_treads(group, axle)
        if any(origin):
            shapes = [replace(shape, pose=_moved(shape.pose, origin)) for shape in shapes]
        mesh, pose = shapes[0].geometry, shapes[0].pose
        key: Hashable = tuple((shape.geometry, shape.pose) for shape in shapes)
        if isinstance(mesh, Mesh):
            key = (key, file_version(mesh), static)
            if key not in self._made:
                pieces = triangle_corners(mesh) if static else [hull_corners(mesh)]
                self._made[key] = [self._mesh(corners.tolist(), pose, static) for corners in pieces]
        elif key not in self._made:
            self._made[key] = [self._simple(shapes)]
        return self._made[key]

    def _simple(self, shapes: Sequence[Collision]) -> int:
        given = [
            {**UNUSED_MEASURES, **SHAPES[type(shape.geometry)](shape.geometry)} for shape in shapes
        ]
        return pybullet.createCollisionShapeArray(
            **{key: [measures[key] for measures in given] for key in given[0]},
            collisionFramePositions=[shape.pose.position for shape in shapes],
            collisionFrameOrientations=[shape.pose.quaternion for shape in shapes],
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
        # A margin that is set for the shape of one body's root holds for all bodies that have it.
        body = pybullet.createMultiBody(0.0, shape, physicsClientId=self._client)
        self._change(body, ROOT, collisionMargin=0.0 if hollow else MESH_MARGIN)
        pybullet.removeBody(body, self._client)
        return shape


def _moved(pose: Pose, origin: Vector) -> Pose:
    """Return a pose in a link's frame relative to another origin."""
    return Pose(subtract(pose.position, origin), pose.quaternion)


def joint_properties(joint: Joint, parent: Link, child: Link) -> Dict[str, float]:
    """Return damping and limits of a joint as PyBullet's properties of the child link.

    PyBullet computes the damping in a step from the velocity before the step. A strong damper on
    a light link would so reverse the velocity, and oscillate ever more. So the damping is limited
    to what stops the two links at once, if nothing else held them.
    """
    if joint.kind == "ball":
        return {}
    properties = {"jointDamping": joint.damping}
    if joint.damping > 0.0:
        # The relative acceleration per effort, if nothing else held the two.
        ends = ((child.inertia, joint.axis), (parent.inertia, joint.pose.rotate(joint.axis)))
        turning = joint.kind != "prismatic"
        loose = sum(mobility(part, axis, turning) for part, axis in ends if part is not None)
        if loose > 0.0:
            properties["jointDamping"] = min(joint.damping, STEPS_PER_SECOND / loose)
    if joint.kind in LIMITED and {"lower", "upper"} & set(joint.limits):
        # A lower limit above the upper one means no limit; PyBullet ignores both.
        properties["jointLowerLimit"] = joint.limits.get("lower", -NO_LIMIT)
        properties["jointUpperLimit"] = joint.limits.get("upper", NO_LIMIT)
    return properties


def allowed_effort(joint: Joint, effort: float, velocity: float) -> float:
    """Return an effort (N m or N) within a joint's limits at a velocity (rad/s or m/s).

    As in Gazebo, the effort is within the joint's effort limit, and zero in the direction in
    which the joint moves faster than its velocity limit. A negative limit means none.
    """
    most, fastest = (joint.limits.get(key, -1.0) for key in ("effort", "velocity"))
    if 0.0 <= fastest < abs(velocity) and velocity * effort > 0.0:
        return 0.0
    return effort if most < 0.0 else min(max(effort, -most), most)


def net_motor(joint: Joint, velocity: float, effort: float) -> Tuple[float, float]:
    """Return the velocity and greatest effort of a motor, together with the joint's friction.

    Friction helps a motor that stops the joint, and hinders one that moves it.
    """
    friction = max(0.0, joint.friction)
    if velocity == 0.0:
        return 0.0, effort + friction
    if effort > friction:
        return velocity, effort - friction
    return 0.0, friction - effort
