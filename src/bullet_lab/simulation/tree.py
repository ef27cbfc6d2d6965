"""Links and joints as a tree."""

from __future__ import annotations

from dataclasses import replace
from typing import Dict, Iterable, List, Tuple

from bullet_lab.simulation.description import Joint, Link
from bullet_lab.simulation.pose import Pose
from bullet_lab.simulation.xml_input import XmlError


class TreeError(XmlError):
    """Links and joints do not make one tree."""


def check_tree(links: Tuple[Link, ...], joints: Tuple[Joint, ...], source: str) -> None:
    """Refuse what is not one tree of links with names of their own.

    Raises:
        TreeError: as `check_forest`, or several roots.
    """
    roots = check_forest(links, joints, source)
    if len(roots) > 1:
        raise TreeError(f"{source}: several roots: {', '.join(roots)}")


def check_forest(
    links: Tuple[Link, ...], joints: Tuple[Joint, ...], source: str
) -> Tuple[str, ...]:
    """Refuse what is not made of trees of links with names of their own; return the roots.

    Raises:
        TreeError: no link, a name twice, a joint's end missing, a link with two parents, or a
            loop.
    """
    if not links:
        raise TreeError(f"{source}: there is no link")
    _refuse_repeats((link.name for link in links), "link", source)
    _refuse_repeats((joint.name for joint in joints), "joint", source)
    _refuse_repeats((joint.child for joint in joints), "child link", source)
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
    return tuple(roots)


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


def _refuse_repeats(names: Iterable[str], what: str, source: str) -> None:
    seen = set()
    for name in names:
        if name in seen:
            raise TreeError(f"{source}: {what} '{name}' appears twice")
        seen.add(name)
