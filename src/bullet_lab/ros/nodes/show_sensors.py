"""Converts contacts of a bumper and accelerations of an IMU into messages that RViz can show.

:ROS Parameters: see `ShowSensorsParameters`.
:ROS Subscribers:
    - bumper (gazebo_msgs/ContactsState)
    - imu (sensor_msgs/Imu)
:ROS Publishers:
    - ~contacts (visualization_msgs/MarkerArray): points of contact with their forces and normals
    - ~wrench (geometry_msgs/WrenchStamped): force and torque of all contacts together
    - ~acceleration (geometry_msgs/AccelStamped): specific force, without angular acceleration
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterable, Iterator

import numpy as np
from geometry_msgs.msg import AccelStamped, Vector3, Wrench, WrenchStamped
from sensor_msgs.msg import Imu
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.core.parameters import number, text
from bullet_lab.core.pose import Vector
from bullet_lab.ros.messages.gazebo_types import msg
from bullet_lab.ros.messages.poses import InputError, marker, vector_of
from bullet_lab.ros.node.lock_step import Publisher, subscriber
from bullet_lab.ros.node.node import node, spin

POINT = ColorRGBA(0.9, 0.1, 0.1, 1.0)
FORCE = ColorRGBA(0.9, 0.4, 0.0, 1.0)
NORMAL = ColorRGBA(0.1, 0.3, 0.9, 1.0)
# m.
NORMAL_LENGTH = 0.1
# N; smaller forces have no arrow, as RViz refuses an arrow without a length.
LEAST_FORCE = 0.01


@dataclass(frozen=True)
class ShowSensorsParameters:
    """Private parameters of show_sensors."""

    bumper: str = text("bumper", "topic of the contacts")
    imu: str = text("imu", "topic of the inertial unit")
    scale: float = number(0.02, "m of an arrow for each N of a contact", above=0.0)


class ShowSensors:
    """Converts the messages of a bumper and an IMU."""

    def __init__(self, parameters: ShowSensorsParameters):
        self._scale = parameters.scale
        self._contacts = Publisher("~contacts", MarkerArray, queue_size=10)
        self._wrench = Publisher("~wrench", WrenchStamped, queue_size=10)
        self._acceleration = Publisher("~acceleration", AccelStamped, queue_size=10)
        subscriber(parameters.bumper, msg.ContactsState, self._show_contacts, 10)
        subscriber(parameters.imu, Imu, self._show_imu, 10)

    def _show_contacts(self, message: msg.ContactsState) -> None:
        total = total_wrench(message)
        markers = list(contact_markers(message, self._scale))
        self._contacts.publish(MarkerArray(markers))
        self._wrench.publish(WrenchStamped(message.header, total))

    def _show_imu(self, message: Imu) -> None:
        vector_of(message.linear_acceleration, "an acceleration")
        shown = AccelStamped(header=message.header)
        shown.accel.linear = message.linear_acceleration
        self._acceleration.publish(shown)


def last_states(message: msg.ContactsState) -> list[msg.ContactState]:
    """Return the states of the last step in a bumper's message, which has those of each step.

    The times are in `info`; without them, all states are returned.
    """
    times = [state.info.partition("time:")[2].strip() for state in message.states]
    return [state for state, time in zip(message.states, times) if time == times[-1]]


def total_wrench(message: msg.ContactsState) -> Wrench:
    """Return the sum of forces and torques of the last step's contacts; raises InputError."""
    totals = [state.total_wrench for state in last_states(message)]
    force = _sum(vector_of(total.force, "a force") for total in totals)
    return Wrench(force, _sum(vector_of(total.torque, "a torque") for total in totals))


def contact_markers(message: msg.ContactsState, scale: float) -> Iterator[Marker]:
    """Yield markers for the points of the last step, which replace those of the message before.

    An arrow has a length of `scale` m for each N. Raises InputError if a number is not finite, or a
    point has no normal or force.
    """
    header, points = message.header, []
    yield Marker(header=header, action=Marker.DELETEALL)
    for state in last_states(message):
        columns = (state.contact_positions, state.contact_normals, state.wrenches)
        if len(set(map(len, columns))) > 1:
            raise InputError("a contact point without a normal or a force")
        points += zip(*columns)
    for index, (place, normal, wrench) in enumerate(points):
        start = vector_of(place, "a point of contact")
        force = vector_of(wrench.force, "a force")
        drawn = [
            marker(header, "point", Marker.SPHERE, POINT, (0.03, 0.03, 0.03), start),
            _arrow(header, "normal", NORMAL, start, vector_of(normal, "a normal"), NORMAL_LENGTH),
        ]
        if math.hypot(*force) > LEAST_FORCE:
            drawn.append(_arrow(header, "force", FORCE, start, force, scale))
        for one in drawn:
            one.id = index
            yield one


def _arrow(
    header: Header, name: str, colour: ColorRGBA, start: Vector, along: Vector, scale: float
) -> Marker:
    end = np.add(start, np.multiply(scale, along)).tolist()
    return marker(header, name, Marker.ARROW, colour, (0.01, 0.02, 0.0), points=(start, end))


def _sum(vectors: Iterable[Vector]) -> Vector3:
    return Vector3(*np.sum([(0.0, 0.0, 0.0), *vectors], axis=0).tolist())


@node
def show_sensors(parameters: ShowSensorsParameters) -> None:
    """Run until ROS shuts down."""
    ShowSensors(parameters)
    spin()
