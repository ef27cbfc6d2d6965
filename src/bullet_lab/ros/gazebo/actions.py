"""The actions and queries of controllers on ROS."""

from __future__ import annotations

from functools import partial
from typing import Any

import rospy
from actionlib.server_goal_handle import ServerGoalHandle

from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.messages.actions import ACTIONS
from bullet_lab.ros.messages.gazebo_types import arm_srv
from bullet_lab.ros.node.driving import LastingServer
from bullet_lab.simulation.plugins.controllers.actions import ACCEPTED, ActionController, Goal


class ControllerAction:
    """Gives the goals of an action server to a controller, and offers its queries.

    Goals come in threads of rospy that hold actionlib's lock. The controller moves them later, in
    the thread of the simulation, which takes that lock for a moment.
    """

    def __init__(self, world: RunningWorld, controller: ActionController):
        self._world, self._controller = world, controller
        kind, self._goal_of, self._feedback, self._result = ACTIONS[controller.action]
        self._goals: dict[str, Goal] = {}
        calls = (kind, self._receive, self._cancel)
        self._server = LastingServer(controller.topic(controller.action), *calls, auto_start=False)
        self._server.start()
        self._services = [
            rospy.Service(
                controller.topic(name), arm_srv.QueryTrajectoryState, partial(self._answer, query)
            )
            for name, query in controller.queries.items()
        ]

    def shutdown(self) -> None:
        """Shut down the action and the services."""
        self._server.stop()
        for service in self._services:
            service.shutdown()

    def _answer(self, query: Any, request: Any) -> Any:
        try:
            names, point = self._world.do(lambda: query(request.time.to_sec()))
        except LabError as error:
            raise rospy.ServiceException(str(error)) from error
        return (names, *point[1:])

    def _receive(self, handle: ServerGoalHandle) -> None:
        name = handle.get_goal_id().id

        def move(state: str, result: Any, text: str) -> None:
            if state == ACCEPTED:
                handle.set_accepted()
                return
            del self._goals[name]
            message = None if result is None else self._result(*result)
            getattr(handle, f"set_{state}")(message, text)

        def tell(feedback: Any) -> None:
            handle.publish_feedback(self._feedback(*feedback))

        goal = self._goals[name] = Goal(self._goal_of(handle.get_goal()), move, tell)
        self._controller.receive(goal)

    def _cancel(self, handle: ServerGoalHandle) -> None:
        goal = self._goals.get(handle.get_goal_id().id)
        if goal is not None:
            self._controller.cancel(goal)
