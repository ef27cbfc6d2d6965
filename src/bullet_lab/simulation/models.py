"""Models in a running simulation: where their parts are, by name, and putting them elsewhere.

Clients name models, and links as "model::link".
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple

from bullet_lab.core.pose import Pose, Vector, add, cross, subtract
from bullet_lab.errors import LabError
from bullet_lab.simulation.physics.attached_frame import AttachedFrame
from bullet_lab.simulation.physics.physics import Body
from bullet_lab.simulation.plugins import Plugin
from bullet_lab.simulation.world.description import (
    SEPARATOR,
    WORLD_LINK,
    FrameState,
    Model,
    ModelState,
)
from bullet_lab.simulation.world.inertia import FARTHEST, FASTEST

# Names of the world's own frame.
WORLD_FRAMES = ("", "world", "map", "/map")
# Of the length of a quaternion from outside, which may have been rounded.
QUATERNION_TOLERANCE = 1e-3


class SimulationError(LabError):
    """Something is asked of the simulation that it cannot do."""


class EntityError(LabError):
    """There is no such model, link or joint."""


@dataclass(eq=False, repr=False)
class ModelInstance:
    """A model in a running simulation.

    Attributes:
        model: its description.
        bodies: of it, by the names of their root links.
        plugins: what its `<plugin>` tags do.
        moves: how often it was put somewhere: what is static moves in no other way.
    """

    model: Model
    bodies: Mapping[str, Body]
    plugins: Tuple[Plugin, ...]
    moves: int = 0
    _frames: Dict[str, AttachedFrame] = field(default_factory=dict)

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
        """Put the model somewhere, at rest; raises SimulationError for an impossible pose."""
        check_pose(pose, self.name)
        for root in self.model.root_links():
            self.bodies[root.name].place(pose * root.pose)
        self._note_move()

    def move(self, pose: Pose, linear: Vector, angular: Vector) -> None:
        """Put the model somewhere in motion; its joints keep their positions and stand still.

        Pose and velocities (m/s, rad/s) are those of the model's frame in the world.

        Raises:
            SimulationError: a number that is not finite, or an impossible pose.
        """
        check_pose(pose, self.name)
        if not all(abs(value) <= FASTEST for value in linear + angular):
            raise SimulationError(f"model '{self.name}': its velocity is out of all proportion")
        before = self.pose().inverse()
        for body in self.bodies.values():
            offset = before * body.pose()
            arm = pose.rotate(offset.position)
            body.move(pose * offset, add(linear, cross(angular, arm)), angular)
        self._note_move()

    def configure(self, positions: Mapping[str, float]) -> None:
        """Put joints somewhere (rad or m), at rest.

        Raises:
            SimulationError: an unknown joint or a position that is not finite; none is moved.
        """
        bodies = [self.body_of_joint(name) for name in positions]
        for name, position in positions.items():
            if not math.isfinite(position):
                raise SimulationError(f"model '{self.name}': joint '{name}' at {position}")
        for body, (name, position) in zip(bodies, positions.items()):
            body.set_joint(name, position)
        self.moves += 1

    def state(self) -> ModelState:
        """Return where all parts of the model are and how they move."""
        links = {entity.link: entity.state() for entity in link_entities(self)}
        if WORLD_LINK in self.bodies:
            links[WORLD_LINK] = FrameState(self.bodies[WORLD_LINK].pose())
        joints = {}
        for body in self.bodies.values():
            for name in body.joint_names:
                state = body.joint_state(name)
                joints[name] = (state.position, state.velocity)
        return ModelState(self.pose(), links, joints)

    def restore(self, state: ModelState) -> None:
        """Put all parts of the model where a state has them; raises SimulationError."""
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

    def keeper(self, link: str) -> Optional[str]:
        """Return the link that a link's frame is fixed to: itself, if it was not merged."""
        if link in self.model.frames:
            return self.model.frames[link][0]
        return link if link in self.model.links_by_name() else None

    def frame(self, link: str = "") -> AttachedFrame:
        """Return the frame of a link, merged or not, or of the model; raises KeyError."""
        if link not in self._frames:
            own = self.model.canonical_link()
            place = (link,) if link else (own.name, own.pose.inverse())
            self._frames[link] = AttachedFrame.of(self.model, self.bodies.values(), *place)
        return self._frames[link]

    def command(self, topic: str, command: Any) -> None:
        """Give a command to the plugins that listen to a topic.

        Raises:
            SimulationError: no plugin does.
            PluginError: the plugin refuses it.
        """
        listening = [i for plugin in self.plugins for i in plugin.inputs if i.topic == topic]
        if not listening:
            raise SimulationError(f"model '{self.name}' has no input '{topic}'")
        for entry in listening:
            entry.handle(command)

    def listen(self, topic: str, listener: Callable[[Any], None]) -> None:
        """Call `listener(sample)` with what plugins send on a topic; raises SimulationError."""
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
    """Refuse a pose that is not finite, absurdly far away or no rotation."""
    if not all(map(math.isfinite, pose.position + pose.quaternion)):
        raise SimulationError(f"model '{model}': its pose is not finite")
    if max(map(abs, pose.position)) > FARTHEST:
        raise SimulationError(f"model '{model}': its pose is out of all proportion")
    length = math.hypot(*pose.quaternion)
    if abs(length - 1.0) > QUATERNION_TOLERANCE:
        raise SimulationError(f"model '{model}': a quaternion of length {length:g}, not 1")


@dataclass(frozen=True)
class Entity:
    """A frame of a model: that of the model itself, or of one of its links.

    `link` names the link that carries the frame, if it was merged the one that stays.
    """

    instance: ModelInstance
    frame: AttachedFrame
    link: str

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
    """Return the link that "model::link" names, or "link" where only one model has it.

    A link that was merged into another is found, too.

    Raises:
        EntityError: there is none, or there are several.
    """
    owner, own = _split(models, name)
    candidates = [models[owner]] if owner else models.values()
    keepers = [(instance, instance.keeper(own)) for instance in candidates]
    found = [Entity(i, i.frame(own), keeper) for i, keeper in keepers if keeper is not None]
    if not found:
        hint = "did you forget to scope the link by model name?"
        raise EntityError(f"link [{name}] does not exist; {hint}")
    if len(found) > 1:
        owners = ", ".join(entity.instance.name for entity in found)
        raise EntityError(f"link [{name}] is ambiguous: {owners} have it; say model::link")
    return found[0]


def _split(models: Mapping[str, ModelInstance], name: str) -> Tuple[str, str]:
    """Return the model that a scoped name begins with, empty for none, and the rest of the name.

    The rest may be scoped itself, by the names of nested models.
    """
    parts = name.split(SEPARATOR)
    for count in range(len(parts) - 1, 0, -1):
        owner = SEPARATOR.join(parts[:count])
        if owner in models:
            return owner, SEPARATOR.join(parts[count:])
    return "", name


def find_entity(models: Mapping[str, ModelInstance], name: str) -> Entity:
    """Return the model or link that a name means; raises EntityError."""
    if name in models:
        return model_entity(models[name])
    try:
        return find_link(models, name)
    except EntityError as error:
        raise EntityError(f"entity [{name}] not found: {error}") from error


def model_entity(instance: ModelInstance) -> Entity:
    """Return a model's own frame."""
    return Entity(instance, instance.frame(), instance.model.canonical_link().name)


def link_entities(instance: ModelInstance) -> List[Entity]:
    """Return the links of a model."""
    names = [link.name for link in instance.model.own_links()]
    return [Entity(instance, instance.frame(name), name) for name in names]


def find_joint(models: Mapping[str, ModelInstance], name: str) -> Tuple[ModelInstance, str]:
    """Return model and name of the joint that "joint" or "model::joint" names.

    As in Gazebo, the first model that has it counts.

    Raises:
        EntityError: none has.
    """
    owner, own = _split(models, name)
    for instance in models.values():
        for joint in instance.model.joints:
            if joint.name == name or (joint.name == own and instance.name == owner):
                return instance, joint.name
    raise EntityError(f"joint [{name}] not found")


def frame_state(models: Mapping[str, ModelInstance], frame: str) -> FrameState:
    """Return the state of a reference frame; raises EntityError for an unknown one."""
    if frame in WORLD_FRAMES:
        return FrameState(Pose())
    return find_entity(models, frame).state()


def relative_to(frame: FrameState, state: FrameState) -> FrameState:
    """Return a state of the world as a frame has it.

    As in Gazebo, the velocity is the difference of the two, in the axes of the frame: what the
    frame's rotation adds at a distance is not taken off.
    """
    back = frame.pose.inverse()
    linear, angular = subtract(state.linear, frame.linear), subtract(state.angular, frame.angular)
    return FrameState(back * state.pose, back.rotate(linear), back.rotate(angular))


def in_world(frame: FrameState, state: FrameState) -> FrameState:
    """Return the state in the world that is asked for in a frame.

    As in Gazebo, the velocity is turned into the axes of the world and is no velocity relative
    to that of the frame.
    """
    turn = frame.pose.rotate
    return FrameState(frame.pose * state.pose, turn(state.linear), turn(state.angular))


def move_link(entity: Entity, state: FrameState) -> None:
    """Put a link somewhere, with all that hangs on it; raises SimulationError."""
    in_link = entity.frame.pose().inverse() * entity.instance.frame().pose()
    arm = state.pose.rotate(in_link.position)
    linear = add(state.linear, cross(state.angular, arm))
    entity.instance.move(state.pose * in_link, linear, state.angular)
