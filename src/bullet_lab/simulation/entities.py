"""What clients name in a running world: models, and links as "model::link"."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Mapping, Tuple

from bullet_lab.core.pose import Pose, add, cross
from bullet_lab.errors import LabError
from bullet_lab.simulation.model_instance import ModelInstance
from bullet_lab.simulation.physics.attached_frame import AttachedFrame
from bullet_lab.simulation.physics.physics import Body
from bullet_lab.simulation.world.description import FrameState

# Names of the world's own frame.
WORLD_FRAMES = ("", "world", "map", "/map")
SEPARATOR = "::"


class EntityError(LabError):
    """There is no such model, link or joint."""


@dataclass(frozen=True)
class Entity:
    """A frame of a model: that of the model itself, or of one of its links.

    Attributes:
        instance: the model.
        frame: where it is and how it moves.
        link: the link that carries the frame.
    """

    instance: ModelInstance
    frame: AttachedFrame
    link: str

    @property
    def body(self) -> Body:
        """The body that carries the frame."""
        return self.frame.body

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
    found = _links(models, name)
    if not found:
        raise EntityError(
            f"link [{name}] does not exist; did you forget to scope the link by model name?"
        )
    if len(found) > 1:
        owners = ", ".join(entity.instance.name for entity in found)
        raise EntityError(f"link [{name}] is ambiguous: {owners} have it; say model::link")
    return found[0]


def find_entity(models: Mapping[str, ModelInstance], name: str) -> Entity:
    """Return the model or link that a name means; raises EntityError."""
    instance = models.get(name)
    if instance is not None:
        return model_entity(instance)
    try:
        return find_link(models, name)
    except EntityError as error:
        raise EntityError(f"entity [{name}] not found: {error}") from error


def model_entity(instance: ModelInstance) -> Entity:
    """Return a model's own frame."""
    return Entity(instance, instance.frame(), instance.model.root_links()[0].name)


def link_entities(instance: ModelInstance) -> List[Entity]:
    """Return the links of a model."""
    links = instance.model.links
    return [Entity(instance, instance.frame(link.name), link.name) for link in links]


def find_joint(models: Mapping[str, ModelInstance], name: str) -> Tuple[ModelInstance, str]:
    """Return model and name of the joint that "joint" or "model::joint" names.

    As in Gazebo, the first model that has it counts.

    Raises:
        EntityError: none has.
    """
    owner, _, own = name.rpartition(SEPARATOR)
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
    linear = tuple(a - b for a, b in zip(state.linear, frame.linear))
    angular = tuple(a - b for a, b in zip(state.angular, frame.angular))
    turn = Pose(quaternion=back.quaternion)
    return FrameState(back * state.pose, turn.rotate(linear), turn.rotate(angular))


def in_world(frame: FrameState, state: FrameState) -> FrameState:
    """Return the state in the world that is asked for in a frame.

    As in Gazebo, the velocity is turned into the axes of the world and is no velocity relative
    to that of the frame.
    """
    turn = Pose(quaternion=frame.pose.quaternion)
    pose = frame.pose * state.pose
    return FrameState(pose, turn.rotate(state.linear), turn.rotate(state.angular))


def move_link(entity: Entity, wanted: FrameState) -> None:
    """Put a link somewhere, and with it all that hangs on it; the joints keep their positions.

    Raises:
        SimulationError: an impossible pose.
    """
    instance = entity.instance
    model = model_entity(instance)
    in_link = entity.frame.pose().inverse() * model.frame.pose()
    place = wanted.pose * in_link
    arm = wanted.pose.rotate(in_link.position)
    instance.move(place, add(wanted.linear, cross(wanted.angular, arm)), wanted.angular)


def _links(models: Mapping[str, ModelInstance], name: str) -> List[Entity]:
    owner, separator, own = name.rpartition(SEPARATOR)
    if separator and owner in models:
        return _links_of(models[owner], own)
    return [entity for instance in models.values() for entity in _links_of(instance, name)]


def _links_of(instance: ModelInstance, name: str) -> List[Entity]:
    keeper = instance.keeper(name)
    return [] if keeper is None else [Entity(instance, instance.frame(name), keeper)]
