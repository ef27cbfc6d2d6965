"""Check the links and joints of a model, make trees of them, and merge links on fixed joints."""

from __future__ import annotations

import logging
from collections import Counter, defaultdict
from dataclasses import replace
from itertools import chain
from typing import Any, Iterable, Iterator, Mapping, Sequence, Tuple, TypeVar

import numpy as np

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import (
    WORLD_LINK,
    Inertia,
    Joint,
    Link,
    Model,
)
from bullet_lab.simulation.world.xml import XmlError, leaving_out

LOG = logging.getLogger(__name__)

INERTIA_KEYS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
# The limits of simulated models: m.
FARTHEST = 1e6
# m/s and rad/s.
FASTEST = 1e6
# kg.
HEAVIEST = 1e12
# Rounded numbers in a file may exceed the limits of physical inertias by this share.
RELATIVE_TOLERANCE = 1e-3
# The radius in m of the ball that replaces a link without shapes.
BALL = 0.05

Links = Tuple[Link, ...]
Joints = Tuple[Joint, ...]
Named = TypeVar("Named", bound=Any)


class ModelError(LabError):
    """A model cannot be simulated."""


def first_of_each(parts: Iterable[Named], what: str, source: str) -> tuple[Named, ...]:
    """Return the parts without those whose name appeared before; warn of these."""
    found: dict[str, Named] = {}
    for part in parts:
        if part.name in found:
            LOG.warning("%s: %s '%s' appears twice; the first is used", source, what, part.name)
        found.setdefault(part.name, part)
    return tuple(found.values())


def check_tree(links: Sequence[Link], joints: Sequence[Joint], source: str) -> None:
    """Raise XmlError unless the links and joints make one tree with unique names."""
    kinds = (("link", links, "name"), ("joint", joints, "name"), ("child link", joints, "child"))
    for what, parts, key in kinds:
        for name, count in Counter(getattr(part, key) for part in parts).items():
            if count > 1:
                raise XmlError(f"{source}: {what} '{name}' appears twice")
    known = {link.name for link in links}
    for joint in joints:
        for end in (joint.parent, joint.child):
            if end not in known:
                raise XmlError(f"{source}: joint '{joint.name}' has an unknown link '{end}'")
    roots = sorted(known - {joint.child for joint in joints})
    # Each link has one parent at most, so that only a loop is reached from no root.
    unreached = known.difference(*(top_down(root, joints) for root in roots))
    if unreached:
        raise XmlError(f"{source}: a loop of joints at {', '.join(sorted(unreached))}")
    if len(roots) > 1:
        raise XmlError(f"{source}: several root links: {', '.join(roots)}")
    if not links:
        raise XmlError(f"{source}: there is no link")


def rooted(links: Sequence[Link], joints: Sequence[Joint], source: str) -> tuple[Links, Joints]:
    """Return links and joints as trees, with all joints leading away from the roots.

    A link that is fixed to the world becomes an anchored root. Other joints to the world get an
    anchored link with the name WORLD_LINK as their parent. A joint that leads towards a root is
    reversed. A joint that closes a loop is left out with a warning: the engine only knows trees.
    """
    names = [WORLD_LINK, *(link.name for link in links)]
    anchored = [WORLD_LINK, *(link.name for link in links if link.anchored)]
    kept = _without_loops(names, anchored, joints, source)
    ends: dict[str, list[Joint]] = {name: [] for name in names}
    for joint in kept:
        ends[joint.parent].append(joint)
        ends[joint.child].append(joint)
    children = {joint.child for joint in kept}
    away: dict[str, Joint] = {}
    # Links that are no child come before those whose joint would have to be reversed.
    for start in (*anchored, *(name for name in names if name not in children), *names):
        queue = [start]
        for name in queue:
            for joint in (joint for joint in ends[name] if joint.name not in away):
                away[joint.name] = joint if joint.parent == name else _reversed(joint)
                queue.append(away[joint.name].child)
    return _anchored(links, [away[joint.name] for joint in kept])


def _without_loops(
    names: Iterable[str], anchored: Sequence[str], joints: Iterable[Joint], source: str
) -> list[Joint]:
    """Return the joints that close no loop; the `anchored` links are connected already."""
    group = {name: {name} for name in names}
    group.update(dict.fromkeys(anchored, set(anchored)))
    kept = []
    for joint in joints:
        one, other = group[joint.parent], group[joint.child]
        if one is other:
            LOG.warning("%s: joint '%s' closes a loop and is left out", source, joint.name)
            continue
        kept.append(joint)
        one |= other
        group.update(dict.fromkeys(other, one))
    return kept


def _reversed(joint: Joint) -> Joint:
    """Return the same joint with parent and child exchanged; its positions stay the same."""
    x, y, z = joint.pose.rotate(joint.axis)
    return replace(
        joint,
        parent=joint.child,
        child=joint.parent,
        pose=joint.pose.inverse(),
        axis=(-x, -y, -z),
        anchor=(joint.pose * Pose(joint.anchor)).position,
    )


def _anchored(links: Sequence[Link], joints: Sequence[Joint]) -> tuple[Links, Joints]:
    """Return links and joints, with the links anchored that are fixed to the world."""
    fixed = {j.child for j in joints if j.parent == WORLD_LINK and j.kind == "fixed"}
    found = [replace(link, anchored=link.anchored or link.name in fixed) for link in links]
    kept = tuple(j for j in joints if j.parent != WORLD_LINK or j.child not in fixed)
    if any(joint.parent == WORLD_LINK for joint in kept):
        found.append(Link(WORLD_LINK, anchored=True))
    return tuple(found), kept


def top_down(root: str, joints: Iterable[Joint]) -> list[str]:
    """Return the names of the links below a root and its own, each after its parent."""
    children: defaultdict[str, list[str]] = defaultdict(list)
    for joint in joints:
        children[joint.parent].append(joint.child)
    order = [root]
    for link in order:
        order.extend(children[link])
    return order


def place_links(links: Links, joints: Joints) -> Links:
    """Return the links with their poses in the root's frame, with all joints at zero."""
    above = {joint.child: joint for joint in joints}
    poses: dict[str, Pose] = {}
    root = next(link.name for link in links if link.name not in above)
    for name in top_down(root, joints):
        joint = above.get(name)
        poses[name] = Pose() if joint is None else poses[joint.parent] * joint.pose
    return tuple(replace(link, pose=poses[link.name]) for link in links)


def lump_fixed_joints(model: Model) -> Model:
    """Return a model with the links on fixed joints merged into their parents.

    A merged link gives its shapes, mass and inertia to the link that stays, and `frames` has its
    pose there. Links on which gravity acts differently are not merged, unless they cannot move.
    """
    fixed = {joint.child: joint for joint in model.joints if _merges(joint, model)}
    places = {link.name: _place(link.name, fixed) for link in model.links}
    frames = {}
    for name, (link, pose) in model.frames.items():
        base, offset = places[link]
        frames[name] = (base, offset * pose)
    members: defaultdict[str, list[tuple[Link, Pose]]] = defaultdict(list)
    for link in model.links:
        base, pose = places[link.name]
        members[base].append((link, pose))
        if link.name in fixed:
            frames[link.name] = (base, pose)
    joints = []
    for joint in model.joints:
        if joint.child not in fixed:
            parent, pose = places[joint.parent]
            joints.append(replace(joint, parent=parent, pose=pose * joint.pose))
    kept = (link for link in model.links if link.name not in fixed)
    links = tuple(_merge(link, members[link.name]) for link in kept)
    return replace(model, links=links, joints=tuple(joints), frames=frames)


def _merges(joint: Joint, model: Model) -> bool:
    if joint.kind != "fixed" or model.static:
        return joint.kind == "fixed"
    links = model.links_by_name()
    parent, child = links[joint.parent], links[joint.child]
    return parent.anchored or parent.gravity == child.gravity


def _place(name: str, fixed: dict[str, Joint]) -> tuple[str, Pose]:
    """Return the link that a link is merged into, and the pose of its frame there."""
    pose = Pose()
    while name in fixed:
        pose = fixed[name].pose * pose
        name = fixed[name].parent
    return name, pose


def _merge(base: Link, members: list[tuple[Link, Pose]]) -> Link:
    inertias = [(link.inertia, pose) for link, pose in members if link.inertia is not None]
    shapes: defaultdict[str, list[Any]] = defaultdict(list)
    for link, pose in members:
        for kind in ("visuals", "collisions"):
            shapes[kind] += [replace(s, pose=pose * s.pose) for s in getattr(link, kind)]
    return replace(
        base,
        inertia=combine(inertias) if inertias else None,
        self_collide=any(link.self_collide for link, _ in members),
        **{kind: tuple(found) for kind, found in shapes.items()},
    )


def inertia_at(pose: Pose, mass: float, moments: Mapping[str, float]) -> Inertia:
    """Return the inertia of an `<inertial>` at a pose in the link's frame, in kg and kg m².

    `moments` has the elements of the matrix by their INERTIA_KEYS.
    """
    ixx, iyy, izz, ixy, ixz, iyz = (moments[key] for key in INERTIA_KEYS)
    own = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]], dtype=float)
    turn = pose.rotation_matrix()
    return Inertia(mass, pose.position, turn @ own @ turn.T, pose.quaternion)


def combine(parts: Sequence[tuple[Inertia, Pose]]) -> Inertia:
    """Return the inertia of bodies fixed to each other, by the parallel axis theorem.

    `parts` holds each body's inertia and the pose of its frame in the common one.

    >>> ball = Inertia(1.0, (0.0, 0.0, 0.0), np.eye(3))
    >>> both = combine([(ball, Pose((-2.0, 0.0, 0.0))), (ball, Pose((2.0, 0.0, 0.0)))])
    >>> both.mass, both.centre, both.matrix.diagonal().tolist()
    (2.0, (0.0, 0.0, 0.0), [2.0, 10.0, 10.0])
    """
    if len(parts) == 1 and parts[0][1] == Pose():
        return parts[0][0]
    mass = sum(inertia.mass for inertia, _ in parts)
    centres = [np.array((pose * Pose(inertia.centre)).position) for inertia, pose in parts]
    weights = [inertia.mass for inertia, _ in parts]
    centre = np.average(centres, axis=0, weights=weights) if mass > 0.0 else np.mean(centres, 0)
    matrix = np.zeros((3, 3))
    for (inertia, pose), own_centre in zip(parts, centres):
        turn = pose.rotation_matrix()
        arm = own_centre - centre
        steiner = inertia.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        matrix += turn @ inertia.matrix @ turn.T + steiner
    return Inertia(float(mass), tuple(centre.tolist()), matrix)


def mobility(inertia: Inertia, axis: Vector, turning: bool) -> float:
    """Return the acceleration of a free body per torque about an axis, or per force along it.

    The axis is a unit vector in the axes of the inertia, which has a mass.
    """
    if not turning:
        return 1.0 / inertia.mass
    return float(np.dot(axis, np.linalg.solve(inertia.matrix, axis)))


def principal_axes(inertia: Inertia) -> tuple[Vector, Pose]:
    """Return the principal moments and the pose of the principal frame in the link's frame.

    A diagonal inertia keeps the axes of the link.
    """
    matrix = inertia.matrix
    off_diagonal = matrix - np.diag(np.diag(matrix))
    if np.abs(off_diagonal).max() <= 1e-9 * np.abs(matrix).max():
        return tuple(np.diag(matrix).tolist()), Pose(inertia.centre)
    moments, axes = np.linalg.eigh(matrix)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    return tuple(moments.tolist()), Pose.from_matrix(inertia.centre, axes)


def with_sound_inertias(model: Model, source: str) -> Model:
    """Return a model with positive principal moments for all links that have a mass.

    A moment that is not positive is replaced by that of the box around the link's largest shape.
    Positive moments that are too unequal for any body stay, as in Gazebo, with a warning.
    """
    if model.static:
        return model
    return replace(model, links=tuple(_with_sound_inertia(link, source) for link in model.links))


def _with_sound_inertia(link: Link, source: str) -> Link:
    inertia = link.inertia
    if inertia is None or inertia.mass <= 0.0:
        return link
    moments, axes = np.linalg.eigh(inertia.matrix)
    low, middle, high = moments
    if low > 0.0 and high <= (low + middle) * (1.0 + RELATIVE_TOLERANCE):
        return link
    shown = ", ".join(f"{value:.3g}" for value in moments)
    what = f"{source}: link '{link.name}': no body can have the principal moments {shown} kg m²"
    if low > 0.0:
        LOG.warning("%s; they are used as they are", what)
        return link
    least = _least_moment(link)
    matrix = axes @ np.diag(np.where(moments > 0.0, moments, least)) @ axes.T
    LOG.warning("%s; moments that are not positive become %.3g", what, least)
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


def usable(model: Model) -> Model:
    """Return a model without the parts that cannot be simulated.

    These are shapes whose mesh is unusable, and moving links without mass, with all links below
    them, which Gazebo drops as well.

    Raises:
        ModelError: nothing is left.
    """
    where = f"model '{model.name}'"
    links = tuple(_with_usable_shapes(link, where) for link in model.links)
    joints = model.joints
    if not model.static:
        links, joints = _without_massless(links, joints, where)
    if all(link.name == WORLD_LINK for link in links):
        name = model.links[0].name if model.links else WORLD_LINK
        raise ModelError(f"{where}: link '{name}' moves and has no mass")
    return replace(model, links=links, joints=joints)


def _with_usable_shapes(link: Link, where: str) -> Link:
    def used(shapes: Sequence[Any]) -> tuple[Any, ...]:
        found = []
        for shape in shapes:
            with leaving_out(lambda what: LOG.warning("%s: link '%s': %s", where, link.name, what)):
                # Reads the file of a mesh.
                shape.geometry.bounds()
                found.append(shape)
        return tuple(found)

    return replace(link, visuals=used(link.visuals), collisions=used(link.collisions))


def _without_massless(links: Links, joints: Joints, where: str) -> tuple[Links, Joints]:
    dropped: set[str] = set()
    for link in links:
        massless = link.inertia is None or link.inertia.mass <= 0.0
        if massless and not link.anchored and link.name not in dropped:
            below = top_down(link.name, joints)
            dropped.update(below)
            others = f", and with it {', '.join(below[1:])}" if below[1:] else ""
            what = "moves and has no mass; it is left out"
            LOG.warning("%s: link '%s' %s%s", where, link.name, what, others)
    # Below a link that is dropped, all are.
    kept = [joint for joint in joints if joint.child not in dropped]
    return tuple(link for link in links if link.name not in dropped), tuple(kept)


def check_proportions(model: Model) -> None:
    """Raise ModelError for a model with a part that is too far away, too large or too heavy."""
    for what, values, limit in _measures(model):
        for value in values:
            # NaN is refused, too.
            if not abs(value) <= limit:
                problem = f"{what}: {value:g} is not within ±{limit:g}"
                raise ModelError(f"model '{model.name}': {problem}")


def _measures(model: Model) -> Iterator[tuple[str, Iterable[float], float]]:
    """Yield what is measured, its values, and their limit."""
    yield "pose", model.pose.position, FARTHEST
    for link in model.links:
        where = f"link '{link.name}'"
        yield f"{where}: pose", link.pose.position, FARTHEST
        if link.inertia is not None:
            yield f"{where}: mass", (link.inertia.mass,), HEAVIEST
            yield f"{where}: centre of mass", link.inertia.centre, FARTHEST
            yield f"{where}: inertia", link.inertia.matrix.flat, HEAVIEST * FARTHEST
        for shape in (*link.visuals, *link.collisions):
            yield f"{where}: pose of a shape", shape.pose.position, FARTHEST
            yield f"{where}: size of a shape", chain(*shape.geometry.measures().values()), FARTHEST
    for joint in model.joints:
        yield f"joint '{joint.name}': pose", joint.pose.position, FARTHEST
