"""Services and topics that say where models and links are, and put them elsewhere.

/gazebo/get_model_state, set_model_state, get_link_state, set_link_state,
set_model_configuration; the topics /gazebo/set_model_state and set_link_state.
"""

from __future__ import annotations

from typing import Any, Callable

import rospy

from bullet_lab.errors import LabError
from bullet_lab.ros.conversions import set_time
from bullet_lab.ros.gazebo_messages import MessageError, set_state, state_of
from bullet_lab.ros.gazebo_services import Answer, RunningWorld, offer
from bullet_lab.ros.gazebo_types import msg, srv
from bullet_lab.ros.node import Refusals
from bullet_lab.ros.stepper import StepperError
from bullet_lab.simulation.entities import (
    find_link,
    find_model,
    frame_state,
    in_world,
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
        self.services = [
            offer(
                "get_model_state",
                srv.GetModelState,
                self._get_model_state,
                "GetModelState: got properties",
            ),
            offer(
                "set_model_state",
                srv.SetModelState,
                lambda request: self._set_model_state(request.model_state),
                "SetModelState: set model state done",
            ),
            offer(
                "get_link_state",
                srv.GetLinkState,
                self._get_link_state,
                "GetLinkState: got state",
            ),
            offer(
                "set_link_state",
                srv.SetLinkState,
                lambda request: self._set_link_state(request.link_state),
                "SetLinkState: success",
            ),
            offer(
                "set_model_configuration",
                srv.SetModelConfiguration,
                self._set_model_configuration,
                "SetModelConfiguration: success",
            ),
        ]
        self.subscribers = [
            self._listen("set_model_state", msg.ModelState, self._set_model_state),
            self._listen("set_link_state", msg.LinkState, self._set_link_state),
        ]

    def _listen(
        self, name: str, kind: type, take: Callable[[Any], Answer]
    ) -> rospy.Subscriber:
        topic = f"/gazebo/{name}"

        def receive(message: Any) -> None:
            try:
                take(message)
            except StepperError:
                # A message that comes as the bridge ends has nothing left to move.
                return
            except LabError as error:
                self._refusals.refuse(topic, str(error))
            self._world.stepper.note_command(message._connection_header["callerid"])

        return rospy.Subscriber(
            topic, kind, receive, queue_size=QUEUE_SIZE, tcp_nodelay=True
        )

    def _get_model_state(self, request: Any) -> Answer:
        def look() -> Answer:
            models = self._world.models
            state = model_entity(find_model(models, request.model_name)).state()
            frame = frame_state(models, request.relative_entity_name)
            response = srv.GetModelStateResponse()
            set_time(response.header.stamp, self._world.simulation.step)
            response.header.frame_id = request.relative_entity_name or "world"
            set_state(response, relative_to(frame, state))
            return {key: getattr(response, key) for key in ("header", "pose", "twist")}

        return self._world.do(look)

    def _set_model_state(self, wanted: Any) -> Answer:
        state = state_of(wanted)

        def change() -> str:
            models = self._world.models
            instance = find_model(models, wanted.model_name)
            placed = in_world(frame_state(models, wanted.reference_frame), state)
            instance.move(placed.pose, placed.linear, placed.angular)
            return instance.name

        self._world.change(change)
        return {}

    def _get_link_state(self, request: Any) -> Answer:
        def look() -> Answer:
            models = self._world.models
            state = find_link(models, request.link_name).state()
            frame = frame_state(models, request.reference_frame)
            message = msg.LinkState(link_name=request.link_name)
            message.reference_frame = request.reference_frame or "world"
            set_state(message, relative_to(frame, state))
            return {"link_state": message}

        return self._world.do(look)

    def _set_link_state(self, wanted: Any) -> Answer:
        state = state_of(wanted)

        def change() -> str:
            models = self._world.models
            link = find_link(models, wanted.link_name)
            move_link(link, in_world(frame_state(models, wanted.reference_frame), state))
            return link.instance.name

        self._world.change(change)
        return {}

    def _set_model_configuration(self, request: Any) -> Answer:
        if len(request.joint_names) != len(request.joint_positions):
            raise MessageError("joint name and position list have different lengths")
        wanted = dict(zip(request.joint_names, request.joint_positions))

        def change() -> str:
            find_model(self._world.models, request.model_name).configure(wanted)
            return request.model_name

        self._world.change(change)
        return {}


