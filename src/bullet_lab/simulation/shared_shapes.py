"""Bodies put together from shapes that are loaded once.

PyBullet gives what it has made of a body's collision shapes back only with the whole world, not
with the body: 70 kB for a mesh of 200 corners, 1 kB for a box. A thousand bodies with the same
shapes cost next to nothing.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence, Tuple, Union

from bullet_lab.errors import LabError
from bullet_lab.simulation.bullet_urdf import drawable
from bullet_lab.simulation.description import (
    Box,
    Collision,
    Cylinder,
    Geometry,
    Joint,
    Link,
    Mesh,
    Plane,
    Sphere,
    Visual,
)
from bullet_lab.simulation.engine import pybullet
from bullet_lab.simulation.inertia import principal_axes
from bullet_lab.simulation.meshes import load_triangles, write_obj
from bullet_lab.simulation.native_output import hidden_native_output
from bullet_lab.simulation.pose import Pose, Vector

# "No shape" and "the root link" in PyBullet's numbers.
NONE = ROOT = -1
JOINT_TYPES = {
    "continuous": pybullet.JOINT_REVOLUTE,
    "revolute": pybullet.JOINT_REVOLUTE,
    "prismatic": pybullet.JOINT_PRISMATIC,
}
# Where a joint that is limited on one side ends on the other.
FAR = 1e16
UNUSED = {
    "radii": 0.0,
    "halfExtents": (0.0, 0.0, 0.0),
    "lengths": 0.0,
    "fileNames": "",
    "meshScales": (1.0, 1.0, 1.0),
    "planeNormals": (0.0, 0.0, 1.0),
    "flags": 0,
}


class SharedShapeError(LabError):
    """PyBullet refused a shape."""


def can_share(links: Sequence[Link], joints: Sequence[Joint], static: bool) -> bool:
    """Return whether a body collides as a mesh, and can be put together here."""
    shapes = [shape for link in links for shape in link.collisions]
    if not any(isinstance(shape.geometry, Mesh) for shape in shapes):
        return False
    return not joints or (not static and all(joint.kind in JOINT_TYPES for joint in joints))


class SharedShapes:
    """The shapes of one PyBullet client."""

    def __init__(self, client: int):
        self._client = client
        self._loaded: Dict[str, List[Tuple[int, int]]] = {}

    def make_body(
        self,
        key: str,
        links: Sequence[Link],
        joints: Sequence[Joint],
        static: bool,
        folder: Path,
        flags: int = 0,
    ) -> Tuple[int, Mapping[str, str]]:
        """Make a body.

        Args:
            key: the same for links with the same shapes that move alike.
            links: what to make, the root first and each after the one that carries it.
            joints: between them.
            static: whether it never moves.
            folder: where mesh files are written to, for PyBullet to read.
            flags: PyBullet's, for reading URDF.

        Returns:
            PyBullet's id of it, and the names of links and joints by those that PyBullet has
            given them.

        Raises:
            MeshError: a mesh is not usable.
            SharedShapeError: PyBullet's refusal.
        """
        with hidden_native_output():
            try:
                if key not in self._loaded:
                    self._loaded[key] = [self._load(link, static, folder) for link in links]
                return self._make_body(self._loaded[key], links, joints, static, flags)
            except pybullet.error as error:
                raise SharedShapeError(
                    f"PyBullet cannot load '{links[0].name}': {error}"
                ) from error

    def _make_body(
        self,
        shapes: Sequence[Tuple[int, int]],
        links: Sequence[Link],
        joints: Sequence[Joint],
        static: bool,
        flags: int,
    ) -> Tuple[int, Mapping[str, str]]:
        masses = [_mass(link, static) for link in links]
        mass, _, centre = masses[0]
        body = pybullet.createMultiBody(
            mass,
            *shapes[0],
            baseInertialFramePosition=centre.position,
            baseInertialFrameOrientation=centre.quaternion,
            flags=flags,
            physicsClientId=self._client,
            **_parts(shapes, links, joints, masses),
        )
        names = _names(links, joints)
        by_name = {link.name: number for number, link in enumerate(links)}
        for index in range(ROOT, len(joints)):
            number = by_name[self._link_name(body, index, names)] if index >= 0 else 0
            if masses[number][0]:
                self._change(body, index, localInertiaDiagonal=masses[number][1])
            self._paint(body, index, links[number])
        for index in range(len(joints)):
            self._set_joint(body, index, joints, self._link_name(body, index, names))
        if static:
            # As what PyBullet loads from files: no skin around hollow meshes.
            self._change(body, ROOT, collisionMargin=0.0)
        return body, names

    def _link_name(self, body: int, index: int, names: Mapping[str, str]) -> str:
        return names[pybullet.getJointInfo(body, index, self._client)[12].decode()]

    def _set_joint(self, body: int, index: int, joints: Sequence[Joint], child: str) -> None:
        joint = next(joint for joint in joints if joint.child == child)
        self._change(body, index, jointDamping=joint.damping)
        if {"lower", "upper"} & set(joint.limits):
            lower, upper = joint.limits.get("lower", -FAR), joint.limits.get("upper", FAR)
            self._change(body, index, jointLowerLimit=lower, jointUpperLimit=upper)

    def _change(self, body: int, index: int, **properties: Any) -> None:
        pybullet.changeDynamics(body, index, physicsClientId=self._client, **properties)

    def _load(self, link: Link, static: bool, folder: Path) -> Tuple[int, int]:
        # Bullet takes the convex hull of a mesh unless told otherwise; only what never moves
        # may keep its hollows.
        flags = pybullet.GEOM_FORCE_CONCAVE_TRIMESH if static else 0
        collision = NONE
        if link.collisions:
            columns = _columns(link.collisions, "collision", folder, flags)
            collision = pybullet.createCollisionShapeArray(physicsClientId=self._client, **columns)
        if not link.visuals:
            return collision, NONE
        columns = _columns([drawable(v) for v in link.visuals], "visual", folder, 0)
        return collision, pybullet.createVisualShapeArray(physicsClientId=self._client, **columns)

    def _paint(self, body: int, index: int, link: Link) -> None:
        for number, visual in enumerate(link.visuals):
            pybullet.changeVisualShape(
                body,
                index,
                shapeIndex=number,
                rgbaColor=visual.colour,
                physicsClientId=self._client,
            )


def _mass(link: Link, static: bool) -> Tuple[float, Vector, Pose]:
    """Return mass in kg, principal moments in kg m², and the pose of the principal frame."""
    if static or link.inertia is None:
        return 0.0, (0.0, 0.0, 0.0), Pose()
    return (link.inertia.mass, *principal_axes(link.inertia))


def _names(links: Sequence[Link], joints: Sequence[Joint]) -> Mapping[str, str]:
    """Return the names of links and joints by those that PyBullet gives them, by number."""
    by_child = {joint.child: joint.name for joint in joints}
    names = {}
    for number, link in enumerate(links[1:], start=1):
        names.update({f"link{number}": link.name, f"joint{number}": by_child[link.name]})
    return names


def _parts(
    shapes: Sequence[Tuple[int, int]],
    links: Sequence[Link],
    joints: Sequence[Joint],
    masses: Sequence[Tuple[float, Vector, Pose]],
) -> Dict[str, list]:
    """Return all links but the root as PyBullet wants them: one list for each property."""
    numbers = {link.name: number for number, link in enumerate(links)}
    by_child = {joint.child: joint for joint in joints}
    carried = [by_child[link.name] for link in links[1:]]
    return {
        "linkMasses": [mass for mass, _, _ in masses[1:]],
        "linkCollisionShapeIndices": [collision for collision, _ in shapes[1:]],
        "linkVisualShapeIndices": [visual for _, visual in shapes[1:]],
        "linkPositions": [joint.pose.position for joint in carried],
        "linkOrientations": [joint.pose.quaternion for joint in carried],
        "linkInertialFramePositions": [centre.position for _, _, centre in masses[1:]],
        "linkInertialFrameOrientations": [centre.quaternion for _, _, centre in masses[1:]],
        "linkParentIndices": [numbers[joint.parent] for joint in carried],
        "linkJointTypes": [JOINT_TYPES[joint.kind] for joint in carried],
        "linkJointAxis": [joint.axis for joint in carried],
    }


def _columns(
    shapes: Sequence[Union[Collision, Visual]], kind: str, folder: Path, flags: int
) -> Dict[str, list]:
    """Return shapes as PyBullet wants them: one list for each property."""
    found = [{**UNUSED, **_properties(shape.geometry, folder, flags)} for shape in shapes]
    columns = {key: [properties[key] for properties in found] for key in ("shapeTypes", *UNUSED)}
    columns[f"{kind}FramePositions"] = [shape.pose.position for shape in shapes]
    columns[f"{kind}FrameOrientations"] = [shape.pose.quaternion for shape in shapes]
    return columns


def _properties(geometry: Geometry, folder: Path, flags: int) -> Dict[str, Any]:
    if isinstance(geometry, Box):
        half = tuple(0.5 * side for side in geometry.size)
        return {"shapeTypes": pybullet.GEOM_BOX, "halfExtents": half}
    if isinstance(geometry, Cylinder):
        size = {"radii": geometry.radius, "lengths": geometry.length}
        return {"shapeTypes": pybullet.GEOM_CYLINDER, **size}
    if isinstance(geometry, Sphere):
        return {"shapeTypes": pybullet.GEOM_SPHERE, "radii": geometry.radius}
    if isinstance(geometry, Plane):
        return {"shapeTypes": pybullet.GEOM_PLANE, "planeNormals": geometry.normal}
    path = write_obj(load_triangles(geometry), folder)
    return {"shapeTypes": pybullet.GEOM_MESH, "fileNames": str(path), "flags": flags}
