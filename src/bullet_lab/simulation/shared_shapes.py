"""Bodies of one link put together from shapes that are loaded once.

PyBullet gives what it has made of a collision mesh back only with the whole world: loading such
a body a thousand times from a file costs fifty megabytes, a thousand bodies of one shape cost
nothing.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, Sequence, Tuple, Union

from bullet_lab.errors import LabError
from bullet_lab.simulation.bullet_urdf import drawable
from bullet_lab.simulation.description import (
    Box,
    Collision,
    Cylinder,
    Geometry,
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
from bullet_lab.simulation.pose import Pose

# "No shape" and "the root link" in PyBullet's numbers.
NONE = ROOT = -1
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


def has_collision_mesh(link: Link) -> bool:
    """Return whether a link collides as a mesh."""
    return any(isinstance(shape.geometry, Mesh) for shape in link.collisions)


class SharedShapes:
    """The shapes of one PyBullet client."""

    def __init__(self, client: int):
        self._client = client
        self._loaded: Dict[str, Tuple[int, int]] = {}

    def make_body(self, key: str, link: Link, static: bool, folder: Path) -> int:
        """Make a body of one link and return PyBullet's id of it.

        Args:
            key: the same for links with the same shapes that move alike.
            link: what to make.
            static: whether it never moves.
            folder: where mesh files are written to, for PyBullet to read.

        Raises:
            MeshError: a mesh is not usable.
            SharedShapeError: PyBullet's refusal.
        """
        with hidden_native_output():
            try:
                return self._make_body(key, link, static, folder)
            except pybullet.error as error:
                raise SharedShapeError(f"PyBullet cannot load '{link.name}': {error}") from error

    def _make_body(self, key: str, link: Link, static: bool, folder: Path) -> int:
        if key not in self._loaded:
            self._loaded[key] = self._load(link, static, folder)
        collision, visual = self._loaded[key]
        mass, centre = 0.0, Pose()
        if not static and link.inertia is not None:
            mass = link.inertia.mass
            moments, centre = principal_axes(link.inertia)
        body = pybullet.createMultiBody(
            mass,
            collision,
            visual,
            baseInertialFramePosition=centre.position,
            baseInertialFrameOrientation=centre.quaternion,
            physicsClientId=self._client,
        )
        if mass:
            pybullet.changeDynamics(
                body, ROOT, localInertiaDiagonal=moments, physicsClientId=self._client
            )
        if static:
            # As what PyBullet loads from files: no skin around hollow meshes.
            pybullet.changeDynamics(
                body, ROOT, collisionMargin=0.0, physicsClientId=self._client
            )
        self._paint(body, link)
        return body

    def _load(self, link: Link, static: bool, folder: Path) -> Tuple[int, int]:
        # Bullet takes the convex hull of a mesh unless told otherwise; only what never moves
        # may keep its hollows.
        flags = pybullet.GEOM_FORCE_CONCAVE_TRIMESH if static else 0
        columns = _columns(link.collisions, "collision", folder, flags)
        collision = pybullet.createCollisionShapeArray(physicsClientId=self._client, **columns)
        if not link.visuals:
            return collision, NONE
        columns = _columns([drawable(v) for v in link.visuals], "visual", folder, 0)
        return collision, pybullet.createVisualShapeArray(physicsClientId=self._client, **columns)

    def _paint(self, body: int, link: Link) -> None:
        for index, visual in enumerate(link.visuals):
            pybullet.changeVisualShape(
                body,
                ROOT,
                shapeIndex=index,
                rgbaColor=visual.colour,
                physicsClientId=self._client,
            )


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
