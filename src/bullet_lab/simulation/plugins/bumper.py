"""libgazebo_ros_bumper.so: the contacts of a link."""

from __future__ import annotations

import re
from typing import Dict, List, Tuple

from bullet_lab.core.pose import Pose, Vector, cross, subtract
from bullet_lab.simulation.physics.contacts import ContactPoint, contact_points
from bullet_lab.simulation.plugins.plugin import Mount, Output, Plugin, PluginError, SensorTag
from bullet_lab.simulation.plugins.samples import ContactsSample, ShapeContact
from bullet_lab.simulation.world.tree import LUMP

# The parts that Gazebo's conversion of URDF adds to a shape's name.
ADDED = re.compile(rf"^.*{LUMP}|_collision(_\d+)?$")


class Bumper(Plugin):
    """Reports the contacts of its link's shapes, with their forces in the last step.

    Samples come at the sensor's rate, also without contacts. Vectors are in frameName if that is
    a link of the model, else in the world. (In Gazebo they are always in the world.)
    """

    filenames = ("libgazebo_ros_bumper.so",)

    def __init__(self, mount: Mount):
        super().__init__(mount)
        tag = SensorTag(mount, ("contact",))
        self._place = tag.place()
        self._watched = _watched(mount, tag, self._place.link)
        frame = mount.text("frameName", "/world")
        self._frame = mount.frame(frame)
        is_link = frame in mount.model.frames or frame in mount.model.links_by_name()
        self._reference = mount.attached(frame) if is_link else None
        topic = mount.topic(mount.text("bumperTopicName", "bumper_states"))
        self.bumper = Output(topic, ContactsSample)
        self.outputs = (self.bumper,)
        self.schedule = tag.schedule()

    def produce(self, step: int) -> None:
        if not self.bumper.wanted:
            return
        frame = Pose() if self._reference is None else self._reference.pose()
        centre = self._place.centre_of_mass()
        contacts = tuple(
            _contact(*names, points, frame.inverse(), centre)
            for names, points in self._touched().items()
        )
        self.bumper.send(ContactsSample(step, self._frame, contacts))

    def _touched(self) -> Dict[Tuple[str, str], List[ContactPoint]]:
        """Return the contact points by the names of the two shapes, the own one first."""
        pairs: Dict[Tuple[str, str], List[ContactPoint]] = {}
        body, name = self._place.body, self.mount.name_shape
        for point in contact_points(body, self._place.link):
            first = name(body.unique_id, point.index, point.place)
            if first in self._watched:
                second = name(*point.other, point.place_on_other)
                pairs.setdefault((first, second), []).append(point)
        return pairs


def _contact(
    first: str, second: str, points: List[ContactPoint], into: Pose, centre: Vector
) -> ShapeContact:
    """Return the contact of two shapes in a frame.

    `into` is the pose of the world in that frame; torques are about `centre`, in the world.
    """
    turn = into.rotate
    torques = [cross(subtract(point.place, centre), point.force) for point in points]
    return ShapeContact(
        first,
        second,
        tuple(turn(point.force) for point in points),
        tuple(turn(torque) for torque in torques),
        tuple((into * Pose(point.place)).position for point in points),
        tuple(turn(point.normal) for point in points),
        tuple(point.depth for point in points),
    )


def _watched(mount: Mount, tag: SensorTag, link: str) -> Tuple[str, ...]:
    """Return the full names of the shapes that the sensor watches; raises PluginError."""
    known = [shape.name for shape in mount.model.links_by_name()[link].collisions]
    wanted = [(element.text or "").strip() for element in tag.element.findall("contact/collision")]
    chosen: List[str] = []
    for name in wanted:
        found = [name] if name in known else []
        if not found:
            # Gazebo's versions differ in what they add to the name of a shape of a URDF.
            found = [one for one in known if ADDED.sub("", one) == ADDED.sub("", name)]
        if not found:
            where, shapes = tag.where("collision"), ", ".join(known) or "none"
            raise PluginError(f"{where}: link '{link}' has no shape '{name}'; its shapes: {shapes}")
        chosen += found
    return tuple(f"{mount.model.name}::{link}::{name}" for name in chosen or known)
