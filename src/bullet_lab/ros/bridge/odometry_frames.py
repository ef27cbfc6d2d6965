"""How the odometry frames of all robots lie in the world, on /tf_static."""

from __future__ import annotations

from typing import Dict, Optional, Set

import rospy
from geometry_msgs.msg import Transform, TransformStamped, Vector3
from tf2_msgs.msg import TFMessage

from bullet_lab.core.pose import Pose
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.messages.conversions import pose_message
from bullet_lab.ros.node.publishers import Publisher
from bullet_lab.simulation.plugins.samples import OdometrySample
from bullet_lab.simulation.simulation import ModelInstance

TOPIC = "/tf_static"


class OdometryFrames:
    """Follows the robots that come and go.

    Two robots with one name for their odometry frame are warned about: on TF, each would be
    where the other is.

    Args:
        world: that they are in.
        frame: the world's frame; empty to publish nothing.
    """

    def __init__(self, world: RunningWorld, frame: str):
        self._world = world
        self._frame = frame
        self._places: Dict[str, Dict[str, Pose]] = {}
        self._shared: Set[str] = set()
        # The last message holds all frames, since subscribers that come later get no other.
        self._publisher = Publisher(TOPIC, TFMessage, queue_size=10, latch=True) if frame else None
        world.changed.append(self.changed)
        self.changed("")

    def changed(self, name: str) -> None:
        """Say where the frames of a model are, or those of all with an empty name."""
        before = dict(self._places)
        for model in [name] if name else {*self._world.models, *self._places}:
            places = _places(self._world.models.get(model))
            if places:
                self._places[model] = places
            else:
                self._places.pop(model, None)
        if self._places != before:
            self._warn(set(self._places) - set(before))
            self._publish()

    def _warn(self, newcomers: Set[str]) -> None:
        """Name the first two robots that claim a frame, once for each frame."""
        owners: Dict[str, str] = {}
        for model, places in self._places.items():
            for frame in places:
                first = owners.setdefault(frame, model)
                if first != model and model in newcomers and frame not in self._shared:
                    self._shared.add(frame)
                    rospy.logwarn(
                        "the frame '%s' belongs to '%s' and '%s': give each robot a tf_prefix in "
                        "its namespace",
                        frame,
                        first,
                        model,
                    )

    def _publish(self) -> None:
        if self._publisher is None:
            return
        found = {frame: pose for places in self._places.values() for frame, pose in places.items()}
        message = TFMessage()
        for frame, pose in sorted(found.items()):
            if frame == self._frame:
                continue
            turn = pose_message(pose).orientation
            transform = TransformStamped(transform=Transform(Vector3(*pose.position), turn))
            transform.header.frame_id, transform.child_frame_id = self._frame, frame
            message.transforms.append(transform)
        self._publisher.publish(message)


def _places(instance: Optional[ModelInstance]) -> Dict[str, Pose]:
    """Return the odometry frames of a model and where they are; none for a model that is gone."""
    if instance is None:
        return {}
    return {
        device.frame: getattr(device, "origin", Pose())
        for device in instance.devices
        if any(output.kind is OdometrySample for output in device.outputs)
    }
