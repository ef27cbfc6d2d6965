"""How links touch: soft or hard, and each other or not."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Dict, Iterable

from bullet_lab.simulation.description import Link
from bullet_lab.simulation.engine import pybullet

if TYPE_CHECKING:
    from bullet_lab.simulation.physics import Body

# What Bullet itself takes for a contact that only says the one or the other.
HARD = 1e18
DEFAULT_DAMPING = 0.1


def contact_properties(link: Link) -> Dict[str, float]:
    """Return friction, stiffness and damping of a link's contacts as PyBullet's properties.

    PyBullet knows links only: the roughest and the softest shape decide. Shapes with a stiffness
    or damping touch as a spring and damper, which are solved implicitly, as in ODE, so that stiff
    ones do not blow up.
    """
    properties = {"lateralFriction": max((c.friction for c in link.collisions), default=1.0)}
    stiffness = [c.stiffness for c in link.collisions if c.stiffness is not None]
    damping = [c.damping for c in link.collisions if c.damping is not None]
    if stiffness or damping:
        properties["contactStiffness"] = min(stiffness, default=HARD)
        properties["contactDamping"] = max(damping, default=DEFAULT_DAMPING)
    return properties


def self_colliding(links: Iterable[Link]) -> bool:
    """Return whether any link touches others of its own body."""
    return any(link.self_collide for link in links)


def part_the_links(body: Body) -> None:
    """Say which links of a self-colliding body touch each other, and which do not.

    As in Gazebo, two links touch if one of them says so, but never over a joint.
    """
    joined = {(part.joint.parent, part.link.name) for part in body.parts if part.joint}
    for (first, one), (second, other) in combinations(enumerate(body.parts, start=-1), 2):
        names = (one.link.name, other.link.name)
        apart = names[0] == names[1] or names in joined or names[::-1] in joined
        touchy = one.link.self_collide or other.link.self_collide
        # Of every pair: PyBullet remembers what was said of a body that had this id before.
        pybullet.setCollisionFilterPair(
            body.unique_id,
            body.unique_id,
            first,
            second,
            int(touchy and not apart),
            physicsClientId=body.client,
        )


def use_friction_pyramid(body: Body) -> None:
    """Limit friction along two directions each for itself, in the body's whole world.

    ODE, Gazebo's engine, does so by default. Bullet's default, a cone, solves the directions
    together, and wheels that slip sideways while they are driven then hardly push: a robot that
    steers by slipping turned at 0.1 to 0.6 of what it was told, as its heading had it, and at
    0.6 to 0.8 with the pyramid (Coulomb's law says 0.61 for it).
    """
    pybullet.setPhysicsEngineParameter(enableConeFriction=0, physicsClientId=body.client)
