"""Writing a body as the plain URDF that PyBullet loads.

PyBullet's own readers take liberties with Gazebo's files (links without inertia weigh 1 kg,
`package://` is searched for, Y-up meshes turn, problems are printed and ignored). What reaches
it from here holds nothing but resolved facts.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Iterable, Mapping, Tuple
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from bullet_lab.simulation.description import (
    Box,
    Colour,
    Cylinder,
    Geometry,
    Inertia,
    Joint,
    Link,
    Mesh,
    Plane,
    Sphere,
    Visual,
)
from bullet_lab.simulation.inertia import principal_axes
from bullet_lab.simulation.meshes import load_triangles, write_obj
from bullet_lab.simulation.pose import Pose, Vector

SLAB_THICKNESS = 0.01
# Where a joint that is limited on one side ends on the other, as in SDF.
FAR = 1e16
# A body that is never moved by forces: PyBullet takes mass 0 as infinitely heavy.
IMMOVABLE = Inertia(0.0, (0.0, 0.0, 0.0), np.zeros((3, 3)))


def body_urdf(
    links: Iterable[Link], joints: Iterable[Joint], static: bool, folder: Path
) -> str:
    """Return the URDF text of one body.

    Args:
        links: root first.
        joints: between these links.
        static: give all links no mass.
        folder: where mesh files are written to, for PyBullet to read.

    Raises:
        MeshError: a mesh is not usable.
    """
    robot = Element("robot", name="body")
    materials: dict = {}
    for link in links:
        _add_link(robot, link, static, folder, materials)
    for joint in joints:
        _add_joint(robot, joint)
    return tostring(robot, encoding="unicode")


def _add_link(robot: Element, link: Link, static: bool, folder: Path, materials: dict) -> None:
    element = SubElement(robot, "link", name=link.name)
    _add_inertia(element, IMMOVABLE if static or link.inertia is None else link.inertia)
    for visual in map(drawable, link.visuals):
        child = _add_shape(element, "visual", visual, folder)
        material = SubElement(child, "material", name=_material(visual.colour, materials))
        SubElement(material, "color", rgba=_text(visual.colour))
    for collision in link.collisions:
        child = _add_shape(element, "collision", collision, folder)
        if static and isinstance(collision.geometry, Mesh):
            # Bullet takes the convex hull of a mesh unless told otherwise; only what never
            # moves may keep its hollows.
            child.set("concave", "yes")


def drawable(visual: Visual) -> Visual:
    """Return a slab for a plane, which PyBullet would draw as a blue checkerboard."""
    if not isinstance(visual.geometry, Plane):
        return visual
    upright = Pose.from_matrix((0.0, 0.0, 0.0), _frame_with_z(visual.geometry.normal))
    slab = Box((*visual.geometry.size, SLAB_THICKNESS))
    sunk = Pose((0.0, 0.0, -0.5 * SLAB_THICKNESS))
    return replace(visual, geometry=slab, pose=visual.pose * upright * sunk)


def _frame_with_z(normal: Vector) -> np.ndarray:
    """Return a rotation matrix whose third column is a direction."""
    z = np.asarray(normal) / np.linalg.norm(normal)
    x = np.cross((0.0, 1.0, 0.0) if abs(z[1]) < 0.9 else (0.0, 0.0, 1.0), z)
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(z, x), z))


def _material(colour: Colour, materials: dict) -> str:
    return materials.setdefault(colour, f"colour_{len(materials)}")


def _add_inertia(element: Element, inertia: Inertia) -> None:
    inertial = SubElement(element, "inertial")
    SubElement(inertial, "mass", value=repr(inertia.mass))
    moments: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    if inertia.mass > 0.0:
        moments, frame = principal_axes(inertia)
        _add_origin(inertial, frame)
    diagonal = {key: repr(value) for key, value in zip(("ixx", "iyy", "izz"), moments)}
    SubElement(inertial, "inertia", ixy="0", ixz="0", iyz="0", **diagonal)


def _add_shape(element: Element, tag: str, shape, folder: Path) -> Element:
    child = SubElement(element, tag)
    _add_origin(child, shape.pose)
    _add_geometry(SubElement(child, "geometry"), shape.geometry, folder)
    return child


def _add_geometry(element: Element, geometry: Geometry, folder: Path) -> None:
    if isinstance(geometry, Box):
        SubElement(element, "box", size=_text(geometry.size))
    elif isinstance(geometry, Cylinder):
        size = {"radius": repr(geometry.radius), "length": repr(geometry.length)}
        SubElement(element, "cylinder", size)
    elif isinstance(geometry, Sphere):
        SubElement(element, "sphere", radius=repr(geometry.radius))
    elif isinstance(geometry, Plane):
        SubElement(element, "plane", normal=_text(geometry.normal))
    else:
        path = write_obj(load_triangles(geometry), folder)
        SubElement(element, "mesh", filename=str(path))


def _add_joint(robot: Element, joint: Joint) -> None:
    element = SubElement(robot, "joint", name=joint.name, type=joint.kind)
    _add_origin(element, joint.pose)
    SubElement(element, "parent", link=joint.parent)
    SubElement(element, "child", link=joint.child)
    SubElement(element, "axis", xyz=_text(joint.axis))
    dynamics = {"damping": repr(joint.damping), "friction": repr(joint.friction)}
    SubElement(element, "dynamics", dynamics)
    limits = {key: repr(float(value)) for key, value in _limits(joint).items()}
    SubElement(element, "limit", limits)


def _limits(joint: Joint) -> Mapping[str, float]:
    """Return limits that PyBullet accepts: it refuses to load a hinge without any."""
    bounds = {key for key in ("lower", "upper") if key in joint.limits}
    # A lower bound above the upper one means none.
    open_ends = {"lower": -FAR, "upper": FAR} if bounds else {"lower": 0.0, "upper": -1.0}
    return {**open_ends, **joint.limits}


def _add_origin(element: Element, pose: Pose) -> None:
    SubElement(element, "origin", xyz=_text(pose.position), rpy=_text(pose.rpy()))


def _text(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
