"""The physics engine: a PyBullet client, and how bodies are made in it.

Each `Physics` has a client of its own, so several simulations can live in one process.

PyBullet's limits: 16 shapes in one call; a mesh by its corners alone; one friction and softness
for a link. So a link carries the first such group of its shapes, and helper links without mass,
fixed to it, carry one more group each. PyBullet frees shapes only with the whole world, so equal
shapes are made once.
"""

from __future__ import annotations

from dataclasses import astuple, replace
from functools import partial
from itertools import combinations
from typing import Any, Callable, Hashable, Mapping, Sequence

from bullet_lab.core.pose import Pose, Vector, subtract
from bullet_lab.entry import hidden_native_output
from bullet_lab.errors import LabError
from bullet_lab.simulation.physics import PhysicsError, pybullet
from bullet_lab.simulation.physics.bodies import (
    HELPER_JOINT,
    NO_SHAPE,
    ROOT,
    ZERO,
    Body,
    BulletLink,
)
from bullet_lab.simulation.physics.rays import RayScene
from bullet_lab.simulation.physics.surfaces import (
    ContactSurface,
    axle_of,
    directed_wheels,
    heavy_enough,
    is_wheel,
    load_of,
    on_treads,
    skidding_wheels,
)
from bullet_lab.simulation.physics.traction import Traction
from bullet_lab.simulation.world.description import Collision, Joint, Link, Model
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
from bullet_lab.simulation.world.tree import FASTEST, top_down

STEP_SECONDS = 1e-3
# PyBullet's limit of shapes in one call.
MOST_SHAPES = 16
# PyBullet's limit of links beside the root in one body.
MOST_LINKS = 127
JOINT_TYPES = {
    "fixed": pybullet.JOINT_FIXED,
    "continuous": pybullet.JOINT_REVOLUTE,
    "revolute": pybullet.JOINT_REVOLUTE,
    "prismatic": pybullet.JOINT_PRISMATIC,
    "ball": pybullet.JOINT_SPHERICAL,
}
# Arguments of `createCollisionShapeArray` for each kind of shape; meshes are made otherwise.
SHAPES: dict[type, Callable[[Any], dict[str, Any]]] = {
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
# How far a contact point may slide before it is given up, as a share of the body's radius.
# Bullet's 0.02 loses the corners of a sliding box; it rocks, and its friction is 2 % too large.
KEPT_CONTACTS = 0.1
# Margin of convex meshes in m, instead of Bullet's 1 mm. Without one, most rays pass through them.
MESH_MARGIN = 1e-4
# Bullet's collision group and mask of static links: they touch everything but each other.
STATIC_FILTER = (2, ~2)


class ShapeMaker:
    """Makes the collision shapes of links in a PyBullet client, equal ones once."""

    def __init__(self, client: int):
        self._client = client
        # PyBullet's ids of shapes by what they are made of.
        self._made: dict[Hashable, list[int]] = {}

    def groups(
        self, link: Link, joint: Joint | None, load: float, skids: bool, static: bool
    ) -> list[tuple[tuple[Collision, ...], int, ContactSurface]]:
        """Return groups of the link's shapes, each with PyBullet's id and the common surface.

        The link hangs on a joint unless it is a root. See `load_of` for the load. `skids` tells
        whether it is a wheel that skids as the body turns, `static` whether its model never moves.
        """
        axle, origin = axle_of(joint), joint.anchor if joint else ZERO
        rolls = is_wheel(link.collisions, axle) and not (skids or static)
        by_surface: dict[ContactSurface, list[Collision]] = {}
        for shape in link.collisions:
            surface = ContactSurface.of(shape, axle, load, rolls)
            by_surface.setdefault(surface, []).append(shape)
        found = []
        for surface, shapes in by_surface.items():
            simple = [shape for shape in shapes if not isinstance(shape.geometry, Mesh)]
            starts = range(0, len(simple), MOST_SHAPES)
            groups = [simple[start : start + MOST_SHAPES] for start in starts]
            groups += [[shape] for shape in shapes if isinstance(shape.geometry, Mesh)]
            for group in groups:
                placed = [_moved(shape, origin) for shape in on_treads(group, axle, skids)]
                found += [(tuple(group), made, surface) for made in self._ids(placed, static)]
        return found

    def _ids(self, shapes: Sequence[Collision], static: bool) -> list[int]:
        """Return PyBullet's ids of simple shapes, or of the pieces of a mesh."""
        mesh = shapes[0].geometry
        key: Hashable = tuple((shape.geometry, shape.pose) for shape in shapes)
        if isinstance(mesh, Mesh):
            key = (key, file_version(mesh), static)
        if key not in self._made:
            if isinstance(mesh, Mesh):
                pieces = triangle_corners(mesh) if static else [hull_corners(mesh)]
                ids = [self._mesh(piece.tolist(), shapes[0].pose, static) for piece in pieces]
            else:
                ids = [self._simple(shapes)]
            self._made[key] = ids
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

    def _mesh(self, corners: list[Vector], pose: Pose, hollow: bool) -> int:
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
        margin = 0.0 if hollow else MESH_MARGIN
        pybullet.changeDynamics(body, ROOT, collisionMargin=margin, physicsClientId=self._client)
        pybullet.removeBody(body, self._client)
        return shape


def _moved(shape: Collision, origin: Vector) -> Collision:
    """Return a shape in a link's frame relative to another origin."""
    pose = Pose(subtract(shape.pose.position, origin), shape.pose.quaternion)
    return replace(shape, pose=pose)


class Physics:
    """A PyBullet world, headless; `step()` advances it by 1 ms.

    Attributes:
        bodies: all bodies by PyBullet's ids.
        rays: what rays can hit.
    """

    def __init__(self, gravity: Vector, coulomb: bool = False):
        self._coulomb = coulomb
        self.client = pybullet.connect(pybullet.DIRECT)
        self.step = partial(pybullet.stepSimulation, self.client)
        self.set_gravity(gravity)
        pybullet.setTimeStep(STEP_SECONDS, self.client)
        pybullet.setPhysicsEngineParameter(
            deterministicOverlappingPairs=1,
            # Without cones, friction has a limit along each of two axes of the world, as in ODE.
            enableConeFriction=int(coulomb),
            contactBreakingThreshold=KEPT_CONTACTS,
            physicsClientId=self.client,
        )
        self._shapes = ShapeMaker(self.client)
        self.bodies: dict[int, Body] = {}
        self.rays = RayScene(self.client)

    def close(self) -> None:
        """Disconnect from PyBullet; the object cannot be used afterwards."""
        if self.client >= 0:
            pybullet.disconnect(self.client)
            self.client = -1

    def set_gravity(self, gravity: Vector) -> None:
        """Change gravity, in m/s²."""
        pybullet.setGravity(*gravity, physicsClientId=self.client)

    def add(self, model: Model) -> dict[str, Body]:
        """Make the bodies of a model at its pose; return them by the names of their root links.

        Raises PhysicsError for too many links or what PyBullet refuses, and MeshError.
        """
        bodies: dict[str, Body] = {}
        try:
            for root in model.root_links():
                bodies[root.name] = self._add_tree(model, root)
        except LabError:
            self.remove(bodies)
            raise
        return bodies

    def remove(self, bodies: Mapping[str, Body]) -> None:
        """Take the bodies of a model out of the world."""
        for body in bodies.values():
            del self.bodies[body.unique_id]
            self.rays.remove(body)
            pybullet.removeBody(body.unique_id, self.client)

    def _add_tree(self, model: Model, root: Link) -> Body:
        by_name = model.links_by_name()
        names = top_down(root.name, model.joints)
        links = [by_name[name] for name in names]
        joints = [joint for joint in model.joints if joint.parent in names]
        # Without a mass, a body's root never moves; without a centre of mass, the body's frame
        # is that of its root link.
        held = len(links) if model.static else int(root.anchored)
        links[:held] = [replace(link, inertia=None) for link in links[:held]]
        pose = model.pose * root.pose
        skidding = [] if held else skidding_wheels(links, joints)
        slipping = skidding if self._coulomb or held else directed_wheels(links, joints)
        if slipping:
            links = heavy_enough(links, slipping)
        skids = set() if self._coulomb else {wheel.link for wheel in skidding}
        try:
            with hidden_native_output():
                made = self._bullet_links(links, joints, model.static, skids)
                body = self._create(made, model, pose)
        except pybullet.error as error:
            what = f"model '{model.name}': PyBullet cannot make it: {error}"
            raise PhysicsError(what) from error
        body.model = model.name
        self.bodies[body.unique_id] = body
        self.rays.add(body)
        if slipping:
            body.traction = Traction(body, slipping, self.bodies, self._coulomb)
        if any(link.self_collide for link in links):
            _set_self_collisions(body)
        body.place(pose)
        return body

    def _bullet_links(
        self,
        links: Sequence[Link],
        joints: Sequence[Joint],
        static: bool,
        skids: set[str],
    ) -> list[BulletLink]:
        """Return PyBullet's links, the root first, each after its parent, and all helpers last.

        The meshes of a static body keep their hollows. `skids` are the names of skidding wheels.
        """
        load = 0.0 if static else load_of(links)
        above = {joint.child: joint for joint in joints}
        places = {link.name: place for place, link in enumerate(links)}
        found, helpers = [], []
        for place, link in enumerate(links):
            joint = above.get(link.name)
            origin, parent = (joint.anchor, places[joint.parent]) if joint else (ZERO, ROOT)
            groups = self._shapes.groups(link, joint, load, link.name in skids, static)
            first, *more = groups or [((), NO_SHAPE, ContactSurface())]
            found.append(BulletLink(link, joint, parent, *first, origin))
            helpers += [BulletLink(link, HELPER_JOINT, place, *group, origin) for group in more]
        return found + helpers

    def _create(self, links: Sequence[BulletLink], model: Model, pose: Pose) -> Body:
        """Make a body of a model at a pose of its root link's frame."""
        (mass, _, centre), *masses = [link.mass_properties() for link in links]
        root, *rest = links
        if len(rest) > MOST_LINKS:
            need = f"its joints and shapes need {len(rest)} links beside the root"
            raise PhysicsError(f"model '{model.name}': {need}; the engine allows {MOST_LINKS}")
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_MAINTAIN_LINK_ORDER
        if any(link.link.self_collide for link in links):
            flags |= pybullet.URDF_USE_SELF_COLLISION
        # From PyBullet's origin of the parent to that of the link.
        places = [
            subtract((link.joint.pose * Pose(link.origin)).position, links[link.parent].origin)
            for link in rest
        ]
        body = pybullet.createMultiBody(
            *(mass, root.shape, NO_SHAPE, *astuple(pose), *astuple(centre)),
            linkMasses=[mass for mass, _, _ in masses],
            linkCollisionShapeIndices=[link.shape for link in rest],
            linkVisualShapeIndices=[NO_SHAPE for _ in rest],
            linkPositions=places,
            linkOrientations=[link.joint.pose.quaternion for link in rest],
            linkInertialFramePositions=[
                subtract(centre.position, link.origin) for link, (_, _, centre) in zip(rest, masses)
            ],
            linkInertialFrameOrientations=[centre.quaternion for _, _, centre in masses],
            linkParentIndices=[link.parent for link in rest],
            linkJointTypes=[JOINT_TYPES[link.joint.kind] for link in rest],
            linkJointAxis=[link.joint.axis for link in rest],
            flags=flags,
            physicsClientId=self.client,
            # A body that never moves needs no tree of links: a world of 1,000 takes a quarter.
            useMaximalCoordinates=int(not rest and mass == 0.0),
        )
        self._set_dynamics(body, links, model.static)
        return Body(self.client, body, links)

    def _set_dynamics(self, body: int, links: Sequence[BulletLink], static: bool) -> None:
        """Set the properties of a body that `createMultiBody` does not take."""
        change = partial(pybullet.changeDynamics, body, physicsClientId=self.client)
        # A call of its own: together with these, PyBullet takes any link's index for the root's.
        change(ROOT, linearDamping=0.0, angularDamping=0.0, maxJointVelocity=FASTEST)
        for index, link in enumerate(links, start=ROOT):
            _, moments, frame = link.mass_properties()
            surface = link.surface.properties(frame, static)
            joint = link.joint_properties(links[link.parent].link)
            change(index, localInertiaDiagonal=moments, **surface, **joint)
            if static and index > ROOT:
                pybullet.setCollisionFilterGroupMask(body, index, *STATIC_FILTER, self.client)


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
