"""Making bodies by PyBullet's calls, and never through a text that its readers parse.

PyBullet takes 16 shapes in one call, and a mesh by its corners alone. So a link carries the first
such group of its shapes, and helper links without mass, fixed to it, carry one more each.

What PyBullet has made of a shape is given back only with the whole world, not with the body:
70 kB for a mesh of 200 corners. So equal shapes are made once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, Hashable, List, Optional, Sequence, Tuple

from bullet_lab.errors import LabError
from bullet_lab.simulation.description import (
    Box,
    Collision,
    Cylinder,
    Joint,
    Link,
    Mesh,
    Plane,
    Sphere,
)
from bullet_lab.simulation.engine import pybullet
from bullet_lab.simulation.inertia import principal_axes
from bullet_lab.simulation.link_contacts import contact_properties, self_colliding
from bullet_lab.simulation.meshes import file_version, hull_corners, triangle_corners
from bullet_lab.simulation.pose import Pose, Vector
from bullet_lab.simulation.proportions import FASTEST

# PyBullet's limits: of shapes in one call, and of links beside the root in one body.
MOST_SHAPES = 16
MOST_LINKS = 127
# "No shape" and "the root link" in PyBullet's numbers.
NONE = ROOT = -1
SHAPE_TYPES = {
    Box: pybullet.GEOM_BOX,
    Cylinder: pybullet.GEOM_CYLINDER,
    Sphere: pybullet.GEOM_SPHERE,
    Plane: pybullet.GEOM_PLANE,
}
JOINT_TYPES = {
    "fixed": pybullet.JOINT_FIXED,
    "continuous": pybullet.JOINT_REVOLUTE,
    "revolute": pybullet.JOINT_REVOLUTE,
    "prismatic": pybullet.JOINT_PRISMATIC,
}
# Where a joint that is limited on one side ends on the other, as in SDF.
FAR = 1e16
HELPER_JOINT = Joint("", "fixed", "", "")
# Bullet's collision group and mask of what never moves: it touches all but its like.
STATIC_FILTER = (2, ~2)


class PhysicsError(LabError):
    """PyBullet refused something."""


@dataclass(frozen=True)
class Part:
    """What is one link to PyBullet: a link of the description, or a helper fixed to one.

    Attributes:
        link: that it is or belongs to.
        joint: that it hangs on; None for the root.
        parent: the parent's place in the list of parts.
        shapes: that it carries.
        shape: PyBullet's id of them together.
    """

    link: Link
    joint: Optional[Joint]
    parent: int
    shapes: Tuple[Collision, ...] = ()
    shape: int = NONE

    @property
    def helper(self) -> bool:
        """Whether it only carries shapes of its link."""
        return self.joint is HELPER_JOINT

    def mass_properties(self) -> Tuple[float, Vector, Pose]:
        """Return mass in kg, principal moments in kg m², and the pose of the principal frame."""
        if self.helper or self.link.inertia is None:
            return 0.0, (0.0, 0.0, 0.0), Pose()
        return (self.link.inertia.mass, *principal_axes(self.link.inertia))


class BodyMaker:
    """Makes the bodies of one PyBullet client."""

    def __init__(self, client: int):
        self._client = client
        self._made: Dict[Hashable, List[int]] = {}

    def make(
        self, links: Sequence[Link], joints: Sequence[Joint], static: bool, pose: Pose
    ) -> Tuple[int, List[Part]]:
        """Make a body.

        Args:
            links: the root first and each after the one that carries it.
            joints: between them.
            static: whether it never moves; then it keeps the hollows of its meshes.
            pose: of the root link's frame in the world.

        Returns:
            PyBullet's id of it and its parts: the links in their order, then all helpers.

        Raises:
            MeshError: a mesh is not usable.
            PhysicsError: there are more parts than PyBullet can hold, or PyBullet's refusal.
        """
        try:
            parts = self._parts(links, joints, static)
            if len(parts) - 1 > MOST_LINKS:
                raise PhysicsError(
                    f"its joints and shapes need {len(parts) - 1} links beside the root, "
                    f"and the engine holds {MOST_LINKS}"
                )
            return self._make(parts, static, pose), parts
        except pybullet.error as error:
            raise PhysicsError(f"PyBullet cannot make it: {error}") from error

    def _parts(
        self, links: Sequence[Link], joints: Sequence[Joint], static: bool
    ) -> List[Part]:
        above = {joint.child: joint for joint in joints}
        places = {link.name: place for place, link in enumerate(links)}
        parts, helpers = [], []
        for place, link in enumerate(links):
            joint = above.get(link.name)
            first, *more = self._shapes(link, static) or [((), NONE)]
            parts.append(Part(link, joint, places[joint.parent] if joint else ROOT, *first))
            helpers += [Part(link, HELPER_JOINT, place, *group) for group in more]
        return parts + helpers

    def _make(self, parts: Sequence[Part], static: bool, pose: Pose) -> int:
        (mass, _, centre), *masses = inertias = [part.mass_properties() for part in parts]
        joints = [part.joint for part in parts if part.joint is not None]
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_MAINTAIN_LINK_ORDER
        if self_colliding(part.link for part in parts):
            flags |= pybullet.URDF_USE_SELF_COLLISION
        body = pybullet.createMultiBody(
            mass,
            parts[0].shape,
            NONE,
            pose.position,
            pose.quaternion,
            centre.position,
            centre.quaternion,
            linkMasses=[mass for mass, _, _ in masses],
            linkCollisionShapeIndices=[part.shape for part in parts[1:]],
            linkVisualShapeIndices=[NONE for _ in masses],
            linkPositions=[joint.pose.position for joint in joints],
            linkOrientations=[joint.pose.quaternion for joint in joints],
            linkInertialFramePositions=[centre.position for _, _, centre in masses],
            linkInertialFrameOrientations=[centre.quaternion for _, _, centre in masses],
            linkParentIndices=[part.parent for part in parts[1:]],
            linkJointTypes=[JOINT_TYPES[joint.kind] for joint in joints],
            linkJointAxis=[joint.axis for joint in joints],
            flags=flags,
            physicsClientId=self._client,
        )
        # Not in one call with what is a link's: these turn any link's index into the root's.
        free = {"linearDamping": 0.0, "angularDamping": 0.0, "maxJointVelocity": FASTEST}
        self._change(body, ROOT, **free)
        for index, (part, (_, moments, _)) in enumerate(zip(parts, inertias), start=ROOT):
            properties = {**contact_properties(part.link), **_joint_properties(part.joint)}
            self._change(body, index, localInertiaDiagonal=moments, **properties)
            if static and index > ROOT:
                filtered = (body, index, *STATIC_FILTER, self._client)
                pybullet.setCollisionFilterGroupMask(*filtered)
        return body

    def _change(self, body: int, index: int, **properties: Any) -> None:
        pybullet.changeDynamics(body, index, physicsClientId=self._client, **properties)

    def _shapes(self, link: Link, static: bool) -> List[Tuple[Tuple[Collision, ...], int]]:
        """Return the shapes of a link in groups, each with PyBullet's id of it."""
        simple = [shape for shape in link.collisions if type(shape.geometry) in SHAPE_TYPES]
        found = []
        for start in range(0, len(simple), MOST_SHAPES):
            group = tuple(simple[start : start + MOST_SHAPES])
            key = tuple((shape.geometry, shape.pose) for shape in group)
            if key not in self._made:
                columns = _columns(group)
                self._made[key] = [
                    pybullet.createCollisionShapeArray(physicsClientId=self._client, **columns)
                ]
            found += [(group, made) for made in self._made[key]]
        for shape in link.collisions:
            if isinstance(shape.geometry, Mesh):
                found += [((shape,), made) for made in self._mesh(shape, static)]
        return found

    def _mesh(self, shape: Collision, static: bool) -> List[int]:
        """Return PyBullet's ids of the pieces of a mesh: hollow if static, else its hull."""
        mesh, pose = shape.geometry, shape.pose
        key = (mesh, file_version(mesh), pose, static)
        if key not in self._made:
            pieces = triangle_corners(mesh) if static else [hull_corners(mesh)]
            self._made[key] = [self._corners(corners.tolist(), pose, static) for corners in pieces]
        return self._made[key]

    def _corners(self, corners: List[Vector], pose: Pose, static: bool) -> int:
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_MESH,
            vertices=corners,
            # Without triangles, Bullet takes the convex hull.
            indices=list(range(len(corners))) if static else [],
            collisionFramePosition=pose.position,
            collisionFrameOrientation=pose.quaternion,
            physicsClientId=self._client,
        )
        if static:
            # No skin of 1 mm around triangles. What is set for a root's shape is so for all.
            body = pybullet.createMultiBody(0.0, shape, physicsClientId=self._client)
            self._change(body, ROOT, collisionMargin=0.0)
            pybullet.removeBody(body, self._client)
        return shape


def _joint_properties(joint: Optional[Joint]) -> Dict[str, float]:
    """Return damping and limits of a joint as PyBullet's properties of the link below it."""
    if joint is None:
        return {}
    properties = {"jointDamping": joint.damping}
    if joint.kind in ("revolute", "prismatic") and {"lower", "upper"} & set(joint.limits):
        # A lower limit above the upper one means none, and PyBullet passes over it.
        properties["jointLowerLimit"] = joint.limits.get("lower", -FAR)
        properties["jointUpperLimit"] = joint.limits.get("upper", FAR)
    return properties


def _columns(shapes: Sequence[Collision]) -> Dict[str, list]:
    """Return shapes as PyBullet wants them: one list for each property."""
    geometries = [shape.geometry for shape in shapes]
    boxes = [g.size if isinstance(g, Box) else (0.0, 0.0, 0.0) for g in geometries]
    return {
        "shapeTypes": [SHAPE_TYPES[type(g)] for g in geometries],
        "radii": [getattr(g, "radius", 0.0) for g in geometries],
        "halfExtents": [tuple(0.5 * side for side in size) for size in boxes],
        "lengths": [getattr(g, "length", 0.0) for g in geometries],
        "planeNormals": [getattr(g, "normal", (0.0, 0.0, 1.0)) for g in geometries],
        "collisionFramePositions": [shape.pose.position for shape in shapes],
        "collisionFrameOrientations": [shape.pose.quaternion for shape in shapes],
    }
