"""How links touch: friction and softness in the engine's numbers, and wheels that stand on a tread.

Bullet multiplies the friction of the two that touch, ODE takes the smaller. Both agree if one of
them has 1, so what never moves has no more than that here: on a floor of 100 or 1, a wheel of 0.1
grips with 0.1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Dict, List, Optional, Sequence, Tuple

from bullet_lab.core.pose import Pose, Vector, cross, subtract
from bullet_lab.simulation.world.description import Collision, Joint, Link
from bullet_lab.simulation.world.shapes import Cylinder

# Two directions are the same to this cosine: an axle, a principal axis.
ALIGNED = 0.99
# What Bullet itself takes for a contact that only says the one or the other.
HARD = 1e18
DEFAULT_DAMPING = 0.1
# In m. A wheel is wider, and its rim lower by this share of its radius: nearer than 3 %, Bullet
# makes points of contact with it as well, which costs half as much time again.
TREAD = 0.002
RIM = 0.05
# In m: two axles are one axle.
NEAR = 0.005


@dataclass(frozen=True)
class Surface:
    """What a shape is like to touch, in the axes of its link.

    Attributes:
        friction: Coulomb's coefficient, the greater of the two if it has two.
        axis: unit vector, along which it has the one, and across which the other.
        along: the share of `friction` along it.
        across: the share across it.
        stiffness: N/m; None for a hard one.
        damping: N s/m; None for a hard one.
    """

    friction: float = 1.0
    axis: Vector = (1.0, 0.0, 0.0)
    along: float = 1.0
    across: float = 1.0
    stiffness: Optional[float] = None
    damping: Optional[float] = None

    @property
    def directed(self) -> bool:
        """Whether it rubs more in one direction than in the other."""
        return self.along != self.across

    @classmethod
    def of(cls, shape: Collision, axle: Optional[Vector]) -> Surface:
        """Return the surface of a shape of a link that turns about an axle, if it does.

        A direction that is not that of the axle turns with the wheel. What it means is: along
        the way the first coefficient, along the axle the second.
        """
        spring = (shape.stiffness, shape.damping)
        one, other = shape.friction, shape.friction
        axis = shape.direction and shape.pose.rotate(shape.direction)
        if axis and shape.cross_friction is not None:
            other = shape.cross_friction
            if axle and abs(cosine(axis, axle)) < ALIGNED:
                axis, one, other = axle, other, one
        most = max(one, other)
        if one == other:
            return cls(most, stiffness=shape.stiffness, damping=shape.damping)
        return cls(most, axis, one / most, other / most, *spring)

    def properties(self, frame: Pose, static: bool) -> Dict[str, Any]:
        """Return it as PyBullet's properties of a link with a principal frame in its own.

        Shapes with a stiffness or damping touch as a spring and damper, which are solved
        implicitly, as in ODE, so that stiff ones do not blow up.
        """
        friction = min(self.friction, 1.0) if static else self.friction
        given: Dict[str, Any] = {"lateralFriction": friction}
        if self.directed:
            given.update(self._anisotropy(frame))
        if self.stiffness is not None or self.damping is not None:
            given["contactStiffness"] = HARD if self.stiffness is None else self.stiffness
            given["contactDamping"] = DEFAULT_DAMPING if self.damping is None else self.damping
        return given

    def _anisotropy(self, frame: Pose) -> Dict[str, Any]:
        """Return the shares along the principal axes; of the axis next to ours, if none is ours."""
        cosines = [abs(part) for part in frame.inverse().rotate(self.axis)]
        ours = cosines.index(max(cosines))
        return {"anisotropicFriction": [self.along if i == ours else self.across for i in range(3)]}


def by_surface(
    shapes: Sequence[Collision], axle: Optional[Vector]
) -> List[Tuple[Surface, List[Collision]]]:
    """Return shapes together that are alike to touch, in the order of the first of each kind."""
    groups: Dict[Surface, List[Collision]] = {}
    for shape in shapes:
        groups.setdefault(Surface.of(shape, axle), []).append(shape)
    return list(groups.items())


def axle_of(joint: Optional[Joint]) -> Optional[Vector]:
    """Return the axis about which a joint lets its link turn, in the link's axes."""
    turns = joint is not None and joint.kind in ("continuous", "revolute")
    return joint.axis if turns else None


def on_treads(shapes: Sequence[Collision], axle: Optional[Vector]) -> List[Collision]:
    """Return the shapes of a link as they roll best.

    A cylinder that lies touches the floor along a line, of which Bullet keeps one end: all wheels
    of a robot would roll on their left edges. So one that is a wheel, alone on its axle, stands
    on a narrow tread in its middle, beside which its rim is lower.
    """
    if len(shapes) != 1 or axle is None or not isinstance(shapes[0].geometry, Cylinder):
        return list(shapes)
    (wheel,) = shapes
    radius, width = wheel.geometry.radius, wheel.geometry.length
    aslant = abs(cosine(wheel.pose.rotate((0.0, 0.0, 1.0)), axle)) < ALIGNED
    if aslant or width <= TREAD:
        return [wheel]
    rim = Cylinder((1.0 - RIM) * radius, width)
    return [replace(wheel, geometry=Cylinder(radius, TREAD)), replace(wheel, geometry=rim)]


def wants_friction_pyramid(links: Sequence[Link], joints: Sequence[Joint]) -> bool:
    """Return whether the friction of a body needs a limit for each direction.

    So it does where wheels slip while they are driven: slippery ones, and those on parallel axles
    apart; and if a shape names a direction. Wheels with a `Traction` of their own do not count.
    """
    if any(shape.direction for link in links for shape in link.collisions):
        return True
    axles = {joint.child: axle_of(joint) for joint in joints}
    wheels = [link for link in links if link.collisions and axles.get(link.name)]
    if any(shape.friction < 1.0 for link in wheels for shape in link.collisions):
        return True
    lines = [(link.pose.position, link.pose.rotate(axles[link.name])) for link in wheels]
    return any(
        abs(cosine(one, other)) > ALIGNED
        and math.hypot(*cross(subtract(place, origin), one)) > NEAR
        for (origin, one), (place, other) in combinations(lines, 2)
    )


def cosine(one: Vector, other: Vector) -> float:
    """Return the cosine between two unit vectors."""
    return sum(a * b for a, b in zip(one, other))
