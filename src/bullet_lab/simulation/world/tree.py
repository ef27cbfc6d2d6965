"""Links and joints as a tree, and merging of links on fixed joints as Gazebo does."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Dict, Iterable, List, Sequence, Tuple, Type

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import WORLD_LINK, Collision, Joint, Link, Model
from bullet_lab.simulation.world.inertia import combine
from bullet_lab.simulation.world.xml import XmlError

LOG = logging.getLogger(__name__)


class TreeError(XmlError):
    """Links and joints do not make one tree."""


def check_tree(links: Sequence[Link], joints: Sequence[Joint], source: str) -> None:
    """Refuse with TreeError what is not one tree of links with names of their own.

    That is no link, a name twice, a joint's end missing, a link with two parents, or a loop.
    """
    refuse_repeats((link.name for link in links), "link", source)
    refuse_repeats((joint.name for joint in joints), "joint", source)
    refuse_repeats((joint.child for joint in joints), "child link", source)
    names = {link.name for link in links}
    for joint in joints:
        for end in (joint.parent, joint.child):
            if end not in names:
                raise TreeError(f"{source}: joint '{joint.name}' names no link '{end}'")
    roots = sorted(names - {joint.child for joint in joints})
    # Each link has one parent at most: what no root reaches hangs on a loop.
    unreached = names.difference(*(top_down(root, joints) for root in roots))
    if unreached:
        raise TreeError(f"{source}: a loop of joints at {', '.join(sorted(unreached))}")
    if len(roots) > 1:
        raise TreeError(f"{source}: several roots: {', '.join(roots)}")
    if not links:
        raise TreeError(f"{source}: there is no link")


def rooted(
    links: Sequence[Link], joints: Sequence[Joint], source: str
) -> Tuple[Tuple[Link, ...], Tuple[Joint, ...]]:
    """Return links and joints as trees, whose joints lead away from their roots.

    What is fixed to the world becomes an anchored root; what other joints hang on the world hangs
    on an anchored link of the name WORLD_LINK. A joint that leads to a root is turned round. One
    that closes a loop is left out with a warning, since the engine knows trees only.
    """
    names = [WORLD_LINK, *(link.name for link in links)]
    held = [WORLD_LINK, *(link.name for link in links if link.anchored)]
    kept = _without_loops(names, held, joints, source)
    ends: Dict[str, List[Joint]] = {name: [] for name in names}
    for joint in kept:
        ends[joint.parent].append(joint)
        ends[joint.child].append(joint)
    children = {joint.child for joint in kept}
    away: Dict[str, Joint] = {}
    reached = set(held)
    # Whatever hangs on no joint comes before what a joint would have to be turned round for.
    for start in (*held, *(name for name in names if name not in children), *names):
        queue = [start] if start in held or start not in reached else []
        for name in queue:
            reached.add(name)
            for joint in (joint for joint in ends[name] if joint.name not in away):
                away[joint.name] = joint if joint.parent == name else _turned(joint)
                queue.append(away[joint.name].child)
    return _anchored(links, [away[joint.name] for joint in kept])


def _without_loops(
    names: Iterable[str], held: Sequence[str], joints: Iterable[Joint], source: str
) -> List[Joint]:
    """Return joints without those that close a loop; what is `held` is joined already."""
    group = {name: {name} for name in names}
    for name in held:
        group[name] = group[held[0]]
    group[held[0]].update(held)
    kept = []
    for joint in joints:
        one, other = group[joint.parent], group[joint.child]
        if one is other:
            LOG.warning("%s: joint '%s' closes a loop and is left out", source, joint.name)
            continue
        kept.append(joint)
        one |= other
        for name in other:
            group[name] = one
    return kept


def _turned(joint: Joint) -> Joint:
    """Return the same joint with parent and child changed round, which has the same positions."""
    x, y, z = joint.pose.rotate(joint.axis)
    return replace(
        joint,
        parent=joint.child,
        child=joint.parent,
        pose=joint.pose.inverse(),
        axis=(-x, -y, -z),
        anchor=(joint.pose * Pose(joint.anchor)).position,
    )


def _anchored(
    links: Sequence[Link], joints: Sequence[Joint]
) -> Tuple[Tuple[Link, ...], Tuple[Joint, ...]]:
    """Return links and joints with those links anchored that are fixed to the world."""
    to_world = {joint.child: joint.kind for joint in joints if joint.parent == WORLD_LINK}
    fixed = {name for name, kind in to_world.items() if kind == "fixed"}
    found = [replace(link, anchored=link.anchored or link.name in fixed) for link in links]
    if len(fixed) < len(to_world):
        found.append(Link(WORLD_LINK, anchored=True))
    kept = (j for j in joints if j.parent != WORLD_LINK or j.child not in fixed)
    return tuple(found), tuple(kept)


def top_down(root: str, joints: Iterable[Joint]) -> List[str]:
    """Return the links that can be reached from a root, each after its parent."""
    children: Dict[str, List[str]] = {}
    for joint in joints:
        children.setdefault(joint.parent, []).append(joint.child)
    order = [root]
    for link in order:
        order.extend(children.get(link, ()))
    return order


def place_links(links: Tuple[Link, ...], joints: Tuple[Joint, ...]) -> Tuple[Link, ...]:
    """Return the links with their poses in the root's frame, all joints at zero."""
    above = {joint.child: joint for joint in joints}
    poses: Dict[str, Pose] = {}
    root = next(link.name for link in links if link.name not in above)
    for name in top_down(root, joints):
        joint = above.get(name)
        poses[name] = Pose() if joint is None else poses[joint.parent] * joint.pose
    return tuple(replace(link, pose=poses[link.name]) for link in links)


def refuse_repeats(
    names: Iterable[str], what: str, source: str, error: Type[XmlError] = TreeError
) -> None:
    """Refuse a name that comes twice; `what` says of what it is, `source` where."""
    seen = set()
    for name in names:
        if name in seen:
            raise error(f"{source}: {what} '{name}' appears twice")
        seen.add(name)


# Stands between the names of the link that stays and of the shape that came from another.
LUMP = "_fixed_joint_lump__"


def lump_fixed_joints(model: Model, rename: bool = False) -> Model:
    """Return the same body with as few links as its movable joints, and gravity, need.

    Shapes, masses and inertias go over to the link that stays; `frames` of the result says
    where each merged link's frame lies in it. Movable joints are hung on the links that stay.
    With `rename`, names of shapes tell that they came from another link.
    """
    fixed = {joint.child: joint for joint in model.joints if _merges(joint, model)}
    if not fixed:
        return model
    places = {link.name: _place(link.name, fixed) for link in model.links}
    members: Dict[str, List[Tuple[Link, Pose]]] = {}
    for link in model.links:
        keeper, pose = places[link.name]
        members.setdefault(keeper, []).append((link, pose))
    kept = (link for link in model.links if link.name not in fixed)
    links = tuple(_merge(link, members[link.name], rename) for link in kept)
    joints = []
    for joint in (joint for joint in model.joints if joint.child not in fixed):
        parent, pose = places[joint.parent]
        joints.append(replace(joint, parent=parent, pose=pose * joint.pose))
    frames = {name: place for name, place in places.items() if name in fixed}
    return replace(model, links=links, joints=tuple(joints), frames={**model.frames, **frames})


def _merges(joint: Joint, model: Model) -> bool:
    """Return whether the ends of a joint become one link: of one that floats, only half would."""
    if joint.kind != "fixed" or model.static:
        return joint.kind == "fixed"
    links = model.links_by_name()
    parent, child = links[joint.parent], links[joint.child]
    return parent.anchored or parent.gravity == child.gravity


def _place(name: str, fixed: Dict[str, Joint]) -> Tuple[str, Pose]:
    """Return the link that a link ends up in and the pose of its frame in that link."""
    pose = Pose()
    while name in fixed:
        pose = fixed[name].pose * pose
        name = fixed[name].parent
    return name, pose


def _merge(keeper: Link, members: List[Tuple[Link, Pose]], rename: bool) -> Link:
    def moved(shape: Collision, link: Link, pose: Pose) -> Collision:
        come = rename and link.name != keeper.name
        name = f"{keeper.name}{LUMP}{shape.name}" if come else shape.name
        return replace(shape, pose=pose * shape.pose, name=name)

    inertias = [(link.inertia, pose) for link, pose in members if link.inertia is not None]
    return replace(
        keeper,
        inertia=combine(inertias) if inertias else None,
        visuals=tuple(replace(v, pose=p * v.pose) for link, p in members for v in link.visuals),
        collisions=tuple(moved(c, link, p) for link, p in members for c in link.collisions),
        self_collide=any(link.self_collide for link, _ in members),
    )
