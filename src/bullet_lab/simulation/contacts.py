"""Who touches whom."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Iterable, Mapping, Tuple

from bullet_lab.simulation.physics import Body
from bullet_lab.simulation.pose import Vector


@dataclass(frozen=True)
class Contact:
    """What two models do to each other.

    Attributes:
        force: sum of the normal forces of all points of contact, in N.
        position: of the point that presses most, in m in the world.
    """

    force: float
    position: Vector


def contacts_of(bodies: Iterable[Body], owners: Mapping[int, str], own: str) -> Dict[str, Contact]:
    """Return the contacts of a model in the last step.

    Args:
        bodies: of the model.
        owners: names of the models by the unique ids of their bodies.
        own: the model's name; what it does to itself is left out.

    Returns:
        Contacts by the other models' names.
    """
    sums: Dict[str, float] = {}
    strongest: Dict[str, Tuple[float, Vector]] = {}
    for body in bodies:
        # The body that is asked for always comes first.
        for _, _, second, _, _, place, _, _, distance, force, *_ in body.near_points():
            # Bullet lists what is merely near, too; what comes apart overlaps without a force.
            if force <= 0.0 and distance >= 0.0:
                continue
            other = owners[second]
            sums[other] = sums.get(other, 0.0) + force
            if other not in strongest or force > strongest[other][0]:
                strongest[other] = (force, place)
    sums.pop(own, None)
    return {other: Contact(force, strongest[other][1]) for other, force in sums.items()}
