"""Changing what joints and links of a running model are like."""

from __future__ import annotations

from dataclasses import replace
from typing import Dict, Optional

from bullet_lab.simulation.models import Entity, ModelInstance, SimulationError
from bullet_lab.simulation.world.description import Inertia
from bullet_lab.simulation.world.tree import check_proportions


def change_joint(
    instance: ModelInstance,
    name: str,
    damping: Optional[float] = None,
    lower: Optional[float] = None,
    upper: Optional[float] = None,
) -> None:
    """Change damping (N m s or N s/m) and limits (rad or m) of a joint; None leaves one as it is.

    Raises:
        SimulationError: there is no such movable joint.
    """
    body = instance.body_of_joint(name)
    joint = next(joint for joint in instance.model.joints if joint.name == name)
    told = {"lower": lower, "upper": upper}
    limits: Dict[str, float] = {key: value for key, value in told.items() if value is not None}
    changed = replace(
        joint,
        # What has no end is of another kind.
        kind="revolute" if limits and joint.kind == "continuous" else joint.kind,
        limits={**joint.limits, **limits},
        damping=joint.damping if damping is None else damping,
    )
    body.change_joint(changed)
    joints = tuple(changed if one is joint else one for one in instance.model.joints)
    instance.model = replace(instance.model, joints=joints)


def change_link(entity: Entity, inertia: Inertia, gravity: bool) -> None:
    """Change mass and moments of a link, and whether gravity pulls it.

    Raises:
        LabError: it never moves, was merged into another one, or no body has such an inertia; or
            its centre of mass or its principal axes would lie elsewhere, which the engine cannot.
    """
    instance, name = entity.instance, entity.link
    link = instance.model.links_by_name()[name]
    where = f"link '{instance.name}::{name}'"
    if instance.model.static or link.inertia is None:
        raise SimulationError(f"{where} never moves")
    changed = replace(link, inertia=inertia, gravity=gravity)
    links = tuple(changed if one is link else one for one in instance.model.links)
    model = replace(instance.model, links=links)
    check_proportions(model)
    entity.frame.body.change_inertia(name, inertia)
    entity.frame.body.change_gravity(name, gravity)
    instance.model = model
