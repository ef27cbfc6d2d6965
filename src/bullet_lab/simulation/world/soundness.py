"""What no body can be is corrected or left out, and named once; the rest of the model counts."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any, Iterable, Sequence, Set, Tuple, TypeVar

import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import WORLD_LINK, Joint, Link, Model
from bullet_lab.simulation.world.report import leaving_out
from bullet_lab.simulation.world.tree import top_down

LOG = logging.getLogger(__name__)

# Rounded figures in a file miss the limits of what is physical by this much at most.
RELATIVE_TOLERANCE = 1e-3
# The radius in m of the ball that a link without shapes is taken for.
BALL = 0.05

Named = TypeVar("Named", bound=Any)


def first_of_each(parts: Iterable[Named], what: str, source: str) -> Tuple[Named, ...]:
    """Return parts with names of their own: of those that share one, the first."""
    found = {}
    for part in parts:
        if part.name in found:
            LOG.warning("%s: %s '%s' appears twice; the first counts", source, what, part.name)
        found.setdefault(part.name, part)
    return tuple(found.values())


def with_sound_inertias(model: Model, source: str) -> Model:
    """Return a model whose principal moments are positive where there is a mass.

    Others are taken from the box around the link's largest shape. Moments that are positive and
    too unequal for any body stay, as in Gazebo: the engine can count with them.
    """
    if model.static:
        return model
    links = (_with_sound_inertia(link, source) for link in model.links)
    return replace(model, links=tuple(links))


def _with_sound_inertia(link: Link, source: str) -> Link:
    inertia = link.inertia
    if inertia is None or inertia.mass <= 0.0:
        return link
    moments, axes = np.linalg.eigh(inertia.matrix)
    low, middle, high = moments
    if low > 0.0 and high <= (low + middle) * (1.0 + RELATIVE_TOLERANCE):
        return link
    said = ", ".join(f"{value:.3g}" for value in moments)
    what = f"{source}: link '{link.name}': no body has the principal moments {said} kg m²"
    if low > 0.0:
        LOG.warning("%s; they count as they are", what)
        return link
    least = _least_moment(link)
    matrix = axes @ np.diag(np.where(moments > 0.0, moments, least)) @ axes.T
    LOG.warning("%s; %.3g is taken for what is not positive", what, least)
    return replace(link, inertia=replace(inertia, matrix=matrix))


def _least_moment(link: Link) -> float:
    """Return the least principal moment of the box around a link's largest shape, kg m²."""
    found = []
    for shape in link.collisions or link.visuals:
        try:
            sides = np.sort(np.ptp(shape.geometry.bounds(), axis=0))
        except LabError:
            continue
        if sides[1] > 0.0 and sides[2] < np.inf:
            found.append(float(sides[0] ** 2 + sides[1] ** 2) / 12.0)
    return link.inertia.mass * max(found, default=0.4 * BALL**2)


class SoundnessError(LabError):
    """Nothing of a model can be simulated."""


def usable(model: Model) -> Model:
    """Return a model without what cannot be simulated.

    That is shapes whose mesh is not usable, and links that move and have no mass, with what hangs
    on them: as Gazebo leaves them out of a URDF.

    Raises:
        SoundnessError: nothing is left.
    """
    where = f"model '{model.name}'"
    links = tuple(_with_usable_shapes(link, where) for link in model.links)
    joints = model.joints
    if not model.static:
        links, joints = _without_massless(links, joints, where)
    if all(link.name == WORLD_LINK for link in links):
        raise SoundnessError(f"{where}: link '{model.links[0].name}' moves and has no mass")
    return replace(model, links=links, joints=joints)


def _with_usable_shapes(link: Link, where: str) -> Link:
    def used(shapes: Sequence[Any]) -> Tuple[Any, ...]:
        found = []
        for shape in shapes:
            with leaving_out(lambda said: LOG.warning("%s: link '%s': %s", where, link.name, said)):
                # Of a mesh, this asks for all that is in it.
                shape.geometry.bounds()
                found.append(shape)
        return tuple(found)

    return replace(link, visuals=used(link.visuals), collisions=used(link.collisions))


def _without_massless(
    links: Sequence[Link], joints: Sequence[Joint], where: str
) -> Tuple[Tuple[Link, ...], Tuple[Joint, ...]]:
    dropped: Set[str] = set()
    for link in links:
        massless = link.inertia is None or link.inertia.mass <= 0.0
        if massless and not link.anchored and link.name not in dropped:
            below = top_down(link.name, joints)
            dropped.update(below)
            others = f", and with it {', '.join(below[1:])}" if below[1:] else ""
            what = "moves and has no mass; it is left out"
            LOG.warning("%s: link '%s' %s%s", where, link.name, what, others)
    kept = [j for j in joints if j.child not in dropped and j.parent not in dropped]
    return tuple(link for link in links if link.name not in dropped), tuple(kept)
