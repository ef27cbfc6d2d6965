"""Keeps the markers on /bullet_lab/world with the world.

Whoever subscribes gets all markers, and from then on those that change: models that come, go or
are put elsewhere at once, models that move a few times a second.
"""

from __future__ import annotations

import contextlib
import time
from typing import Any, Callable, Dict, Optional, Tuple

import rospy
from visualization_msgs.msg import MarkerArray

from bullet_lab.core.pose import Pose
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.bridge.stepper import StepperError
from bullet_lab.ros.messages.world import deleted_markers, world_markers
from bullet_lab.ros.node.publishers import Publisher
from bullet_lab.simulation.simulation import ModelInstance

TOPIC = "/bullet_lab/world"
QUEUE_SIZE = 100
# Looks at the models that may move, per second of simulated and of wall time at most.
RATE = 10.0


class WorldFeed(rospy.SubscribeListener):
    """Draws the world.

    Args:
        world: what to draw.
        frame: the world's frame.
        hidden: name of a model that is drawn by somebody else.
    """

    def __init__(self, world: RunningWorld, frame: str, hidden: str = ""):
        super().__init__()
        self._world = world
        self._frame = frame
        self._hidden = hidden
        self._counts: Dict[str, int] = {}
        self._places: Dict[str, Tuple[Pose, ...]] = {}
        self._looked = 0.0
        world.changed.append(self._changed)
        world.simulation.every(RATE, self._look)
        self._publisher = Publisher(
            TOPIC, MarkerArray, queue_size=QUEUE_SIZE, subscriber_listener=self
        )

    def peer_subscribe(
        self, _topic: str, _publish: Callable[[Any], None], peer_publish: Callable[[Any], None]
    ) -> None:
        """Draw everything for a new subscriber."""
        # A bridge that ends has nothing more to show.
        with contextlib.suppress(StepperError, rospy.ROSException):
            self._world.do(lambda: peer_publish(self._all()))

    def _all(self) -> MarkerArray:
        array = MarkerArray()
        for name in self._world.models:
            array.markers.extend(self._draw(name).markers)
        return array

    def _changed(self, name: str) -> None:
        if self._publisher.has_connections():
            array = self._draw(name) if name else self._all()
            self._publisher.publish(array)

    def _draw(self, name: str) -> MarkerArray:
        """Return the markers of a model, or what takes them away if it is gone."""
        instance = self._world.models.get(name)
        if name == self._hidden:
            return MarkerArray()
        if instance is None:
            self._places.pop(name, None)
            return deleted_markers(name, self._counts.pop(name, 0), self._frame)
        array = world_markers([instance], self._frame)
        # A successor of the same name may have fewer shapes.
        before, count = self._counts.get(name, 0), len(array.markers)
        if count < before:
            array.markers.extend(deleted_markers(name, before, self._frame).markers[count:])
        self._counts[name] = count
        self._places[name] = _places(instance)
        return array

    def _look(self, _step: Optional[int] = None) -> None:
        """Draw anew what has moved."""
        now = time.monotonic()
        if not self._publisher.has_connections() or now - self._looked < 1.0 / RATE:
            return
        self._looked = now
        moved = MarkerArray()
        for name, instance in self._world.models.items():
            if not instance.model.static and self._places.get(name) != _places(instance):
                moved.markers.extend(self._draw(name).markers)
        if moved.markers:
            self._publisher.publish(moved)


def _places(instance: ModelInstance) -> Tuple[Pose, ...]:
    """Return where the seen links are, to a tenth of a millimetre or so."""
    poses = (instance.frame(link.name).pose() for link in instance.model.links if link.visuals)
    return tuple(
        Pose(
            tuple(round(value, 4) for value in pose.position),
            tuple(round(value, 4) for value in pose.quaternion),
        )
        for pose in poses
    )
