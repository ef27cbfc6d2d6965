"""Merging links that hang on fixed joints into their parents, as Gazebo does."""

from __future__ import annotations

from dataclasses import replace
from typing import Dict, List, Tuple

from bullet_lab.simulation.description import Collision, Joint, Link, Model
from bullet_lab.simulation.inertia import combine
from bullet_lab.simulation.pose import Pose

# Stands between the names of the link that stays and of the shape that came from another.
LUMP = "_fixed_joint_lump__"


def lump_fixed_joints(model: Model, rename: bool = False) -> Model:
    """Return the same body with as few links as its movable joints need.

    Shapes, masses and inertias go over to the link that stays; `frames` of the result says
    where each merged link's frame lies in it. Movable joints are hung on the links that stay.

    Args:
        model: what to simplify.
        rename: whether names of shapes are to tell that they came from another link.
    """
    fixed = {joint.child: joint for joint in model.joints if joint.kind == "fixed"}
    if not fixed:
        return model
    places = {link.name: _place(link.name, fixed) for link in model.links}
    members: Dict[str, List[Tuple[Link, Pose]]] = {}
    for link in model.links:
        keeper, pose = places[link.name]
        members.setdefault(keeper, []).append((link, pose))
    links = tuple(
        _merge(link, members[link.name], rename) for link in model.links if link.name not in fixed
    )
    joints = tuple(_rehang(j, places) for j in model.joints if j.kind != "fixed")
    frames = {name: place for name, place in places.items() if name in fixed}
    return replace(model, links=links, joints=joints, frames={**model.frames, **frames})


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


def _rehang(joint: Joint, places: Dict[str, Tuple[str, Pose]]) -> Joint:
    parent, pose = places[joint.parent]
    return replace(joint, parent=parent, pose=pose * joint.pose)
