"""How links touch: friction and softness, the treads of wheels, and which wheels must skid.

Bullet multiplies the friction coefficients of two surfaces that touch; ODE takes the smaller one.
The results agree if one of the two is 1, so static models are limited to 1 here: on a floor of
100 or of 1, a wheel of 0.1 has the friction 0.1.

Wheels on parallel axles that are apart cannot all roll while the body turns: they skid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Sequence, Tuple

import numpy as np

from bullet_lab.core.pose import Pose, Vector, cross, dot, subtract
from bullet_lab.simulation.world.description import Collision, Joint, Link
from bullet_lab.simulation.world.shapes import Cylinder, Mesh, Sphere, hull_corners

# A place (m) on an axle, and the axle's direction.
Axle = Tuple[Vector, Vector]

# Two directions count as the same above this cosine.
ALIGNED = 0.99
# Two axles at this distance (m) or nearer count as one axle.
NEAR = 0.005
# Stiffness (N/m) of a contact that names only a damping, as in Bullet.
HARD = 1e18
# Damping (N s/m) of a contact that names only a stiffness, as in Bullet.
DEFAULT_DAMPING = 0.1
# Width of a wheel's tread in m.
TREAD = 0.002
# The rim beside the treads is lower by this share of the radius. Below 3 %, Bullet makes contact
# points with the rim, too, and a step takes half as much time again.
RIM = 0.05
# Greatest cosine between a level axle and the vertical.
LEVEL = 0.3
# Least cosine between a steering axis and the vertical.
UPRIGHT = 0.7
# Greatest roundness error of a mesh that counts as a wheel, as a share of its radius.
ROUND = 0.05
# A wheel's inertia is at least that of this share of its load at its rim: otherwise friction in a
# single step would spin it.
LEAST_RIM = 0.05
# Gravity in m/s² for the springs of hard shapes.
GRAVITY = 9.8
# How deep (m) and how fast (m/s) a hard contact sinks in under the load of the whole body.
SINKING = 1e-4
SINKING_SPEED = 0.015


@dataclass(frozen=True)
class ContactSurface:
    """Friction and softness of a shape, in the axes of its link.

    Attributes:
        friction: Coulomb's coefficient, the greater of the two if it has two.
        axis: unit vector; friction differs along it and across it.
        along: the share of `friction` along the axis.
        across: the share of `friction` across the axis.
        stiffness: N/m; None for a hard surface.
        damping: N s/m; None for a hard surface.
    """

    friction: float = 1.0
    axis: Vector = (1.0, 0.0, 0.0)
    along: float = 1.0
    across: float = 1.0
    stiffness: float | None = None
    damping: float | None = None

    @classmethod
    def of(
        cls, shape: Collision, axle: Vector | None, load: float = 0.0, rolls: bool = False
    ) -> ContactSurface:
        """Return the surface of a shape of a link.

        A direction that is not the axle's turns with the wheel. It then means that the first
        coefficient acts along the rolling direction, and the second along the axle.

        Args:
            shape: of the link.
            axle: what the link turns about, or None.
            load: of the body on hard shapes, see `load_of`.
            rolls: whether the shape is a wheel that rolls: ODE gives it two contacts, Bullet one.
        """
        stiffness, damping = shape.stiffness, shape.damping
        if load and stiffness is damping is None:
            stiffness, damping = load / SINKING, load / SINKING_SPEED
        if rolls:
            stiffness, damping = (value and 2.0 * value for value in (stiffness, damping))
        first = second = shape.friction
        axis = shape.direction and shape.pose.rotate(shape.direction)
        if axis and shape.cross_friction is not None:
            second = shape.cross_friction
            if axle and abs(dot(axis, axle)) < ALIGNED:
                axis, first, second = axle, second, first
        if first == second:
            return cls(first, stiffness=stiffness, damping=damping)
        most = max(first, second)
        return cls(most, axis, first / most, second / most, stiffness, damping)

    def properties(self, frame: Pose, static: bool) -> dict[str, Any]:
        """Return the surface as PyBullet's properties of a link with this principal frame.

        Contacts with a stiffness or damping are a spring and damper, which Bullet solves
        implicitly, as ODE does, so that stiff ones stay stable.
        """
        friction = min(self.friction, 1.0) if static else self.friction
        properties = {"lateralFriction": friction}
        if self.along != self.across:
            # Bullet knows principal axes alone: the one next to our axis stands for it.
            cosines = [abs(value) for value in frame.inverse().rotate(self.axis)]
            nearest = cosines.index(max(cosines))
            shares = [self.across, self.across, self.across]
            shares[nearest] = self.along
            properties["anisotropicFriction"] = shares
        if self.stiffness is not None or self.damping is not None:
            properties["contactStiffness"] = HARD if self.stiffness is None else self.stiffness
            properties["contactDamping"] = DEFAULT_DAMPING if self.damping is None else self.damping
        return properties


def axle_of(joint: Joint | None) -> Vector | None:
    """Return the axis about which a joint lets its child link turn, in that link's axes."""
    turns = joint is not None and joint.kind in ("continuous", "revolute")
    return joint.axis if turns else None


def on_treads(shapes: Sequence[Collision], axle: Vector | None, skids: bool) -> list[Collision]:
    """Return the shapes of a link, with a wheel replaced by narrow treads and a lower rim.

    A lying cylinder touches the floor along a line. ODE makes a contact at each end of it; Bullet
    keeps one of them, and all wheels of a robot would roll on their left edges. So a cylinder
    that is alone on its axle gets a tread in its middle, on which it rolls freely; or one at each
    edge if it skids, since where it touches decides how far the robot turns.
    """
    if not is_wheel(shapes, axle):
        return list(shapes)
    (wheel,) = shapes
    radius, width = wheel.geometry.radius, wheel.geometry.length
    tread, rim = Cylinder(radius, TREAD), Cylinder((1.0 - RIM) * radius, width)
    edge = 0.5 * (width - TREAD)
    places = [Pose((0.0, 0.0, z)) for z in ((-edge, edge) if skids else (0.0,))]
    treads = [replace(wheel, geometry=tread, pose=wheel.pose * place) for place in places]
    return [*treads, replace(wheel, geometry=rim)]


def load_of(links: Sequence[Link]) -> float:
    """Return the load (N) that a body puts on hard shapes; 0 if their contacts stay hard.

    How hard contacts share a load is undetermined if there are more than three; Bullet's solver
    would decide, anew in each step. Springs of equal stiffness share it as ODE does, whose
    contacts are springs: by where they are. So each hard shape is a spring that the body's load
    compresses. A ball does not share its load, and would bounce.
    """
    shapes = [shape.geometry for link in links for shape in link.collisions]
    if all(isinstance(shape, Sphere) for shape in shapes):
        return 0.0
    return GRAVITY * sum(link.inertia.mass for link in links if link.inertia is not None)


def is_wheel(shapes: Sequence[Collision], axle: Vector | None) -> bool:
    """Return whether the shapes of a link are one cylinder that turns about its axle."""
    if len(shapes) != 1 or axle is None or not isinstance(shapes[0].geometry, Cylinder):
        return False
    return _turns_about(shapes[0], axle) and shapes[0].geometry.length > 2.0 * TREAD


def _parallel_and_apart(one: Axle, other: Axle) -> bool:
    (place, axis), (other_place, other_axis) = one, other
    if abs(dot(axis, other_axis)) <= ALIGNED:
        return False
    return math.hypot(*cross(subtract(other_place, place), axis)) > NEAR


def _turns_about(cylinder: Collision, axle: Vector) -> bool:
    return abs(dot(cylinder.pose.rotate((0.0, 0.0, 1.0)), axle)) >= ALIGNED


@dataclass(frozen=True)
class RoundWheel:
    """A wheel on a level axle that nothing steers.

    Attributes:
        link: name of its link.
        axle: in the link's axes.
        radius: in m.
        direction: `fdir1` in the link's axes, unless it is the axle's or there is none.
    """

    link: str
    axle: Vector
    radius: float
    direction: Vector | None = None


def skidding_wheels(links: Sequence[Link], joints: Sequence[Joint]) -> list[RoundWheel]:
    """Return the wheels of a body that skid sideways as it turns, in the order of its links.

    Their axles are parallel and apart. The links have poses in a frame whose z axis points up.
    """
    found = _round_wheels(links, joints)
    return [
        wheel for wheel, line in found if any(_parallel_and_apart(line, one) for _, one in found)
    ]


def directed_wheels(links: Sequence[Link], joints: Sequence[Joint]) -> list[RoundWheel]:
    """Return the wheels of a body whose directions of friction turn with them; see above."""
    return [wheel for wheel, _ in _round_wheels(links, joints) if wheel.direction]


def _round_wheels(links: Sequence[Link], joints: Sequence[Joint]) -> list[tuple[RoundWheel, Axle]]:
    above = {joint.child: joint for joint in joints}
    poses = {link.name: link.pose for link in links}
    found: list[tuple[RoundWheel, Axle]] = []
    for link in links:
        joint = above.get(link.name)
        if joint is None or not _turns_freely(joint) or _is_steered(joint, above, poses):
            continue
        radius = max((_radius(shape, joint) for shape in link.collisions), default=0.0)
        axle = link.pose.rotate(joint.axis)
        if radius > 0.0 and abs(axle[2]) < LEVEL:
            wheel = RoundWheel(link.name, joint.axis, radius, _direction(link, joint.axis))
            found.append((wheel, ((link.pose * Pose(joint.anchor)).position, axle)))
    return found


def _direction(link: Link, axle: Vector) -> Vector | None:
    directions = [c.pose.rotate(c.direction) for c in link.collisions if c.direction]
    return next((d for d in directions if abs(dot(d, axle)) < ALIGNED), None)


def _turns_freely(joint: Joint) -> bool:
    if axle_of(joint) is None:
        return False
    least, most = joint.limits.get("lower", -math.inf), joint.limits.get("upper", math.inf)
    return joint.kind == "continuous" or not 0.0 <= most - least <= math.tau


def _is_steered(joint: Joint, above: dict[str, Joint], poses: dict[str, Pose]) -> bool:
    """Return whether a link that carries the joint can turn about the vertical."""
    while joint.parent in above:
        joint = above[joint.parent]
        axis = poses[joint.child].rotate(joint.axis)
        if joint.kind == "ball" or (axle_of(joint) and abs(axis[2]) > UPRIGHT):
            return True
    return False


def _radius(shape: Collision, joint: Joint) -> float:
    """Return the radius of a shape that is round about a joint's axis; 0 if it is not round."""
    geometry = shape.geometry
    if isinstance(geometry, Mesh):
        return _radius_of_mesh(geometry, shape.pose, joint)
    if not isinstance(geometry, (Cylinder, Sphere)):
        return 0.0
    distance = math.hypot(*cross(subtract(shape.pose.position, joint.anchor), joint.axis))
    is_round = isinstance(geometry, Sphere) or _turns_about(shape, joint.axis)
    return geometry.radius if is_round and distance <= NEAR else 0.0


def _radius_of_mesh(mesh: Mesh, pose: Pose, joint: Joint) -> float:
    corners = hull_corners(mesh) @ pose.rotation_matrix().T
    _, _, (_, *across) = np.linalg.svd(np.array([joint.axis]))
    places = (corners + np.subtract(pose.position, joint.anchor)) @ np.transpose(across)
    reaches = np.abs([places.min(axis=0), places.max(axis=0)])
    return float(reaches.max()) if np.ptp(reaches) < ROUND * reaches.max() else 0.0


def heavy_enough(links: Sequence[Link], wheels: Sequence[RoundWheel]) -> list[Link]:
    """Return the links with the wheels heavy enough at their rims (`LEAST_RIM`)."""
    load = sum(link.inertia.mass for link in links) / len(wheels)
    by_name = {link.name: link for link in links}
    for wheel in wheels:
        link = by_name[wheel.link]
        matrix = link.inertia.matrix
        lacking = LEAST_RIM * load * wheel.radius**2 - wheel.axle @ matrix @ wheel.axle
        inertia = replace(link.inertia, matrix=matrix + max(0.0, lacking) * np.eye(3))
        by_name[wheel.link] = replace(link, inertia=inertia)
    return list(by_name.values())
