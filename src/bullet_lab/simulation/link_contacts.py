"""How links touch: soft or hard, and each other or not."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Sequence

from bullet_lab.simulation.description import Link
from bullet_lab.simulation.engine import pybullet

if TYPE_CHECKING:
    from bullet_lab.simulation.physics import Body

# What Bullet itself takes for a contact that only says the one or the other.
HARD = 1e18
DEFAULT_DAMPING = 0.1


def soften_contacts(body: Body) -> None:
    """Make springs of the contacts of links whose shapes have a stiffness or damping.

    Bullet knows links only: the softest shape decides. The spring and damper are solved
    implicitly, as in ODE, so that stiff ones do not blow up.
    """
    for link in body.links:
        stiffness = [c.stiffness for c in link.collisions if c.stiffness is not None]
        damping = [c.damping for c in link.collisions if c.damping is not None]
        if stiffness or damping:
            pybullet.changeDynamics(
                body.unique_id,
                body.link_index(link.name),
                contactStiffness=min(stiffness, default=HARD),
                contactDamping=max(damping, default=DEFAULT_DAMPING),
                physicsClientId=body.client,
            )


def self_colliding(links: Sequence[Link]) -> bool:
    """Return whether any link touches others of its own body."""
    return any(link.self_collide for link in links)


def spare_the_others(body: Body) -> None:
    """Keep links of a self-colliding body apart that are not to touch each other.

    As in Gazebo, two links touch if one of them says so.
    """
    for one, other in combinations(body.links, 2):
        if not (one.self_collide or other.self_collide):
            pybullet.setCollisionFilterPair(
                body.unique_id,
                body.unique_id,
                body.link_index(one.name),
                body.link_index(other.name),
                0,
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
