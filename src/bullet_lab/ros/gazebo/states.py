"""Where models and links are: services and topics that say it, and that put them elsewhere.

/gazebo/get_model_state, set_model_state, get_link_state, set_link_state,
set_model_configuration; the topics /gazebo/set_model_state and set_link_state.

/gazebo/model_states and link_states are made while somebody listens, `rate` times per simulated
second. In between, whoever subscribes is told at once how things are, and everybody when something
was added, taken away or put elsewhere: so they are of use while time stands still, too.
"""

from __future__ import annotations

import contextlib
from typing import Any, Callable, Iterator, Optional, Tuple

import rospy

from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.bridge.stepper import StepperError
from bullet_lab.ros.gazebo.services import Answer, between_steps, changing, offer
from bullet_lab.ros.messages.gazebo_types import msg, srv
from bullet_lab.ros.messages.poses import (
    InputError,
    pose_message,
    set_state,
    set_time,
    state_of,
    twist_message,
)
from bullet_lab.ros.node.node import Refusals
from bullet_lab.simulation.models import (
    Entity,
    find_link,
    find_model,
    frame_state,
    in_world,
    link_entities,
    model_entity,
    move_link,
    relative_to,
)

QUEUE_SIZE = 10


class GazeboStates:
    """Offers the services and listens to the topics."""

    def __init__(self, world: RunningWorld):
        self._world = world
        self._refusals = Refusals()
        set_model_state = changing(world, self._set_model_state)
        set_link_state = changing(world, self._set_link_state)
        self.services = [
            offer(
                "get_model_state",
                srv.GetModelState,
                between_steps(world, self._get_model_state),
                "GetModelState: got properties",
            ),
            offer(
                "set_model_state",
                srv.SetModelState,
                lambda request: set_model_state(request.model_state),
                "SetModelState: set model state done",
            ),
            offer(
                "get_link_state",
                srv.GetLinkState,
                between_steps(world, self._get_link_state),
                "GetLinkState: got state",
            ),
            offer(
                "set_link_state",
                srv.SetLinkState,
                lambda request: set_link_state(request.link_state),
                "SetLinkState: success",
            ),
            offer(
                "set_model_configuration",
                srv.SetModelConfiguration,
                changing(world, self._set_model_configuration),
                "SetModelConfiguration: success",
            ),
        ]
        self._listen("set_model_state", msg.ModelState, set_model_state)
        self._listen("set_link_state", msg.LinkState, set_link_state)

    def _listen(self, name: str, kind: type, take: Callable[[Any], Answer]) -> None:
        topic = f"/gazebo/{name}"

        def receive(message: Any) -> None:
            try:
                take(message)
            except StepperError:
                raise
            except LabError as error:
                self._refusals.refuse(topic, str(error))

        self._world.topics.subscribe(topic, kind, receive, QUEUE_SIZE)

    def _get_model_state(self, request: Any) -> Answer:
        models = self._world.models
        state = model_entity(find_model(models, request.model_name)).state()
        frame = frame_state(models, request.relative_entity_name)
        response = srv.GetModelStateResponse()
        set_time(response.header.stamp, self._world.simulation.step)
        response.header.frame_id = request.relative_entity_name or "world"
        set_state(response, relative_to(frame, state))
        return {key: getattr(response, key) for key in ("header", "pose", "twist")}

    def _get_link_state(self, request: Any) -> Answer:
        models = self._world.models
        state = find_link(models, request.link_name).state()
        frame = frame_state(models, request.reference_frame)
        message = msg.LinkState(link_name=request.link_name)
        message.reference_frame = request.reference_frame or "world"
        set_state(message, relative_to(frame, state))
        return {"link_state": message}

    def _set_model_state(self, message: Any) -> str:
        state, models = state_of(message), self._world.models
        instance = find_model(models, message.model_name)
        placed = in_world(frame_state(models, message.reference_frame), state)
        instance.move(placed.pose, placed.linear, placed.angular)
        return instance.name

    def _set_link_state(self, message: Any) -> str:
        state, models = state_of(message), self._world.models
        link = find_link(models, message.link_name)
        move_link(link, in_world(frame_state(models, message.reference_frame), state))
        return link.instance.name

    def _set_model_configuration(self, request: Any) -> str:
        if len(request.joint_names) != len(request.joint_positions):
            raise InputError("joint name and position list have different lengths")
        positions = dict(zip(request.joint_names, request.joint_positions))
        find_model(self._world.models, request.model_name).configure(positions)
        return request.model_name


Named = Tuple[str, Entity]


class GazeboTopics:
    """Publishes where everything is.

    Args:
        world: what to tell of.
        rate: messages per simulated second.
    """

    def __init__(self, world: RunningWorld, rate: float):
        self._states = [
            _States(world, "/gazebo/model_states", msg.ModelStates, _models, rate),
            _States(world, "/gazebo/link_states", msg.LinkStates, _links, rate),
        ]


class _States(rospy.SubscribeListener):
    """One of the topics."""

    def __init__(
        self,
        world: RunningWorld,
        topic: str,
        kind: type,
        entities: Callable[[RunningWorld], Iterator[Named]],
        rate: float,
    ):
        super().__init__()
        self._world = world
        self._kind = kind
        self._entities = entities
        self._publisher = world.topics.publisher(topic, kind)
        self._publisher.impl.add_subscriber_listener(self)
        world.changed.append(self._changed)
        world.simulation.every(rate, self._publish)

    def peer_subscribe(
        self, _topic: str, _publish: Callable[[Any], None], peer_publish: Callable[[Any], None]
    ) -> None:
        """Tell a new subscriber how things are."""
        # What a bridge that ends can no longer tell, nobody needs. In the thread of the others
        # that write to this subscriber, or messages would mix.
        with contextlib.suppress(StepperError, rospy.ROSException):
            self._world.do(lambda: peer_publish(self._message()))

    def _publish(self, _step: Optional[int] = None) -> None:
        if self._publisher.has_connections():
            self._publisher.publish(self._message())

    def _changed(self, _name: str) -> None:
        self._publish()
        self._publisher.flush()

    def _message(self) -> Any:
        message = self._kind()
        for name, entity in self._entities(self._world):
            state = entity.state()
            message.name.append(name)
            message.pose.append(pose_message(state.pose))
            message.twist.append(twist_message(state))
        return message


def _models(world: RunningWorld) -> Iterator[Named]:
    for name, instance in world.models.items():
        yield name, model_entity(instance)


def _links(world: RunningWorld) -> Iterator[Named]:
    for name, instance in world.models.items():
        for entity in link_entities(instance):
            yield f"{name}::{entity.link}", entity
