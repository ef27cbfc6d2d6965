"""Models in a running simulation: their state, their properties, and finding them by name.

Clients name models, and links as "model::link".
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, Callable, Mapping

import numpy as np

from bullet_lab.core.pose import Pose, Vector, add, cross, subtract
from bullet_lab.errors import LabError
from bullet_lab.simulation.physics.attached_frame import AttachedFrame
from bullet_lab.simulation.physics.bodies import Body
from bullet_lab.simulation.plugins import Plugin
from bullet_lab.simulation.world.description import (
    SEPARATOR,
    WORLD_LINK,
    FrameState,
    Inertia,
    Model,
    ModelState,
)
from bullet_lab.simulation.world.tree import FARTHEST, FASTEST, check_proportions

# Names of the world's own frame.
WORLD_FRAMES = ("", "world", "map", "/map")
# Tolerance of the length of a quaternion from outside, which may have been rounded.
QUATERNION_TOLERANCE = 1e-3
# Corners farther away than this (m) belong to planes, which have no end.
FARTHEST_CORNER = 1e3


class SimulationError(LabError):
    """A request that the simulation cannot fulfil."""


class EntityError(LabError):
    """There is no such model, link or joint."""


@dataclass(eq=False, repr=False)
class ModelInstance:
    """A model in a running simulation.

    Attributes:
        model: its description.
        bodies: of it, by the names of their root links.
        plugins: of its `<plugin>` tags.
        moves: how often it was placed; static models move in no other way.
    """

    model: Model
    bodies: Mapping[str, Body]
    plugins: tuple[Plugin, ...]
    moves: int = 0
    _frames: dict[str | None, AttachedFrame] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The model's name in the world."""
        return self.model.name

    def pose(self) -> Pose:
        """Return the pose of the model's frame in the world."""
        root = self.model.root_links()[0]
        if root.name == WORLD_LINK:
            return self.frame().pose()
        return self.bodies[root.name].pose() * root.pose.inverse()

    def place(self, pose: Pose) -> None:
        """Place the model at rest; raises SimulationError for an invalid pose."""
        check_pose(pose, self.name)
        for root in self.model.root_links():
            self.bodies[root.name].place(pose * root.pose)
        self._note_move()

    def move(self, pose: Pose, linear: Vector, angular: Vector) -> None:
        """Place the model in motion; its joints keep their positions and stand still.

        Pose and velocities (m/s, rad/s) are those of the model's frame in the world.

        Raises:
            SimulationError: the pose or a velocity is invalid.
        """
        check_pose(pose, self.name)
        if not all(abs(value) <= FASTEST for value in linear + angular):
            limit = f"{FASTEST:g} m/s or rad/s"
            raise SimulationError(f"model '{self.name}': its velocity exceeds {limit}")
        before = self.pose().inverse()
        for body in self.bodies.values():
            offset = before * body.pose()
            arm = pose.rotate(offset.position)
            body.move(pose * offset, add(linear, cross(angular, arm)), angular)
        self._note_move()

    def configure(self, positions: Mapping[str, float]) -> None:
        """Place joints (rad or m), at rest.

        Raises:
            SimulationError: a joint is unknown or a position not finite; none is moved.
        """
        bodies = [self.body_of_joint(name) for name in positions]
        for name, position in positions.items():
            if not math.isfinite(position):
                where = f"model '{self.name}': joint '{name}'"
                raise SimulationError(f"{where}: position {position} is not finite")
        for body, name in zip(bodies, positions):
            body.set_joint(name, positions[name])
        self.moves += 1

    def state(self) -> ModelState:
        """Return pose and velocity of all links and joints."""
        links = {entity.frame.link: entity.state() for entity in link_entities(self)}
        if WORLD_LINK in self.bodies:
            links[WORLD_LINK] = FrameState(self.bodies[WORLD_LINK].pose())
        joints = {}
        for body in self.bodies.values():
            for name in body.joint_names:
                state = body.joint_state(name)
                joints[name] = (state.position, state.velocity)
        return ModelState(self.pose(), links, joints)

    def restore(self, state: ModelState) -> None:
        """Place all links and joints as in a state; raises SimulationError."""
        for root in self.model.root_links():
            link = state.links.get(root.name, FrameState(state.pose * root.pose))
            check_pose(link.pose, self.name)
            self.bodies[root.name].move(link.pose, link.linear, link.angular)
        for name, (position, velocity) in state.joints.items():
            self.body_of_joint(name).set_joint(name, position, velocity)
        self._note_move()

    def body_of_joint(self, name: str) -> Body:
        """Return the body that has a joint; raises SimulationError for an unknown one."""
        for body in self.bodies.values():
            if name in body.joint_names:
                return body
        raise SimulationError(f"model '{self.name}' has no movable joint '{name}'")

    def frame(self, link: str | None = None) -> AttachedFrame:
        """Return the frame of a link, merged or not, or of the model; raises KeyError."""
        if link not in self._frames:
            own = self.model.canonical_link()
            place = (own.name, own.pose.inverse()) if link is None else (link,)
            self._frames[link] = AttachedFrame.of(self.model, self.bodies.values(), *place)
        return self._frames[link]

    def command(self, topic: str, command: Any) -> None:
        """Give a command to the plugins with this input topic.

        Raises:
            SimulationError: no plugin has it.
            PluginError: the plugin refuses the command.
        """
        listening = [i for plugin in self.plugins for i in plugin.inputs if i.topic == topic]
        if not listening:
            raise SimulationError(f"model '{self.name}' has no input '{topic}'")
        for entry in listening:
            entry.handle(command)

    def listen(self, topic: str, listener: Callable[[Any], None]) -> None:
        """Call `listener(sample)` with a topic's samples; raises SimulationError if unknown."""
        sending = [o for plugin in self.plugins for o in plugin.outputs if o.topic == topic]
        if not sending:
            raise SimulationError(f"model '{self.name}' has no output '{topic}'")
        for output in sending:
            output.connect(listener)

    def _note_move(self) -> None:
        self.moves += 1
        for plugin in self.plugins:
            plugin.placed()


def check_pose(pose: Pose, model: str) -> None:
    """Refuse a pose that is not finite, too far away, or without a unit quaternion."""
    if not all(map(math.isfinite, pose.position + pose.quaternion)):
        raise SimulationError(f"model '{model}': its pose is not finite")
    if max(map(abs, pose.position)) > FARTHEST:
        raise SimulationError(f"model '{model}': its position exceeds {FARTHEST:g} m")
    length = math.hypot(*pose.quaternion)
    if abs(length - 1.0) > QUATERNION_TOLERANCE:
        raise SimulationError(f"model '{model}': a quaternion of length {length:g}; needs 1")


@dataclass(frozen=True)
class Entity:
    """A frame of a model: the model's own, or that of a link."""

    instance: ModelInstance
    frame: AttachedFrame

    def state(self) -> FrameState:
        """Return pose and velocity in the world."""
        return FrameState(self.frame.pose(), *self.frame.velocity())


def find_model(models: Mapping[str, ModelInstance], name: str) -> ModelInstance:
    """Return a model; raises EntityError."""
    instance = models.get(name)
    if instance is None:
        raise EntityError(f"model [{name}] does not exist")
    return instance


def find_link(models: Mapping[str, ModelInstance], name: str) -> Entity:
    """Return the link "model::link", or "link" if only one model has it, merged or not.

    Raises:
        EntityError: no model or several models have it.
    """
    owner, own = _split(models, name)
    found = []
    for instance in [models[owner]] if owner else models.values():
        with contextlib.suppress(KeyError):
            found.append(Entity(instance, instance.frame(own)))
    if not found:
        hint = "did you forget to scope the link by model name?"
        raise EntityError(f"link [{name}] does not exist; {hint}")
    if len(found) > 1:
        owners = ", ".join(entity.instance.name for entity in found)
        raise EntityError(f"link [{name}] is ambiguous: {owners} have it; use model::link")
    return found[0]


def _split(models: Mapping[str, ModelInstance], name: str) -> tuple[str, str]:
    """Return the model that a scoped name begins with (empty if none), and the rest.

    The rest may be scoped itself, by the names of nested models.
    """
    parts = name.split(SEPARATOR)
    for count in range(len(parts) - 1, 0, -1):
        owner = SEPARATOR.join(parts[:count])
        if owner in models:
            return owner, SEPARATOR.join(parts[count:])
    return "", name


def model_entity(instance: ModelInstance) -> Entity:
    """Return a model's own frame."""
    return Entity(instance, instance.frame())


def link_entities(instance: ModelInstance) -> list[Entity]:
    """Return the links of a model."""
    return [Entity(instance, instance.frame(link.name)) for link in instance.model.own_links()]


def find_joint(models: Mapping[str, ModelInstance], name: str) -> tuple[ModelInstance, str]:
    """Return model and name of the joint "joint" or "model::joint"; raises EntityError.

    As in Gazebo, the first model that has it counts.
    """
    owner, own = _split(models, name)
    for instance in models.values():
        for joint in instance.model.joints:
            if joint.name == name or (joint.name == own and instance.name == owner):
                return instance, joint.name
    raise EntityError(f"joint [{name}] not found")


def frame_state(models: Mapping[str, ModelInstance], frame: str) -> FrameState:
    """Return the state of the world's frame, a model or a link; raises EntityError."""
    if frame in WORLD_FRAMES:
        return FrameState(Pose())
    if frame in models:
        return model_entity(models[frame]).state()
    try:
        return find_link(models, frame).state()
    except EntityError as error:
        raise EntityError(f"entity [{frame}] not found: {error}") from error


def relative_to(frame: FrameState, state: FrameState) -> FrameState:
    """Return a state of the world in a frame.

    As in Gazebo, the velocity is the difference of the two, in the axes of the frame, without the
    part that the frame's rotation adds at a distance.
    """
    back = frame.pose.inverse()
    linear, angular = subtract(state.linear, frame.linear), subtract(state.angular, frame.angular)
    return FrameState(back * state.pose, back.rotate(linear), back.rotate(angular))


def in_world(frame: FrameState, state: FrameState) -> FrameState:
    """Return the state in the world of a state that is given in a frame.

    As in Gazebo, the velocity is only turned into the axes of the world; the velocity of the
    frame is not added.
    """
    turn = frame.pose.rotate
    return FrameState(frame.pose * state.pose, turn(state.linear), turn(state.angular))


def move_link(entity: Entity, state: FrameState) -> None:
    """Place a link together with its model; raises SimulationError."""
    in_link = entity.frame.pose().inverse() * entity.instance.frame().pose()
    arm = state.pose.rotate(in_link.position)
    linear = add(state.linear, cross(state.angular, arm))
    entity.instance.move(state.pose * in_link, linear, state.angular)


def change_joint(
    instance: ModelInstance,
    name: str,
    damping: float | None = None,
    lower: float | None = None,
    upper: float | None = None,
) -> None:
    """Change damping (N m s or N s/m) and limits (rad or m) of a joint; None keeps a value.

    Raises:
        SimulationError: there is no such movable joint.
    """
    body = instance.body_of_joint(name)
    joint = next(joint for joint in instance.model.joints if joint.name == name)
    given = {"lower": lower, "upper": upper}
    limits = {key: value for key, value in given.items() if value is not None}
    changed = replace(
        joint,
        # A continuous joint has no limits.
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
        LabError: the link never moves or was merged into another one; the inertia is not
            physical; or its centre of mass or its principal axes would move.
    """
    instance, name = entity.instance, entity.frame.link
    link = instance.model.links_by_name()[name]
    if instance.model.static or link.inertia is None:
        raise SimulationError(f"link '{instance.name}::{name}' never moves")
    changed = replace(link, inertia=inertia, gravity=gravity)
    links = tuple(changed if one is link else one for one in instance.model.links)
    model = replace(instance.model, links=links)
    check_proportions(model)
    entity.frame.body.change_link(name, inertia, gravity)
    instance.model = model


def bounds(instance: ModelInstance) -> tuple[Vector, Vector]:
    """Return the lower and upper corner of the box around a model's shapes, in the world (m).

    A model without shapes is a point.
    """
    corners = [instance.pose().position]
    for link in instance.model.links:
        place = instance.frame(link.name).pose()
        for shape in (*link.visuals, *link.collisions):
            box = product(*shape.geometry.bounds().T.tolist())
            corners += [(place * shape.pose * Pose(corner)).position for corner in box]
    corners = np.array(corners)
    near = corners[np.abs(corners).max(axis=1) < FARTHEST_CORNER]
    corners = near if len(near) else corners
    return tuple(corners.min(axis=0).tolist()), tuple(corners.max(axis=0).tolist())
