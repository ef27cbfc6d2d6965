"""The topics /gazebo/model_states and /gazebo/link_states.

They are made while somebody listens, `rate` times per simulated second. In between, whoever
subscribes is told at once how things are, and everybody when something was added, taken away
or put elsewhere: so they are of use while time stands still, too.
"""

from __future__ import annotations

import contextlib
from typing import Any, Callable, Iterator, Optional, Tuple

import rospy

from bullet_lab.ros.conversions import pose_message
from bullet_lab.ros.gazebo_messages import twist_message
from bullet_lab.ros.gazebo_services import RunningWorld
from bullet_lab.ros.gazebo_types import msg
from bullet_lab.ros.stepper import StepperError
from bullet_lab.simulation.entities import Entity, link_entities, model_entity

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
        self._publisher = world.wiring.publisher(topic, kind)
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
