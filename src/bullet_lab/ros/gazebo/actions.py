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
from bullet_lab.simulation.plugins.controllers import ControlError, actions
from bullet_lab.simulation.plugins.controllers.actions import ActionController, Goal


class ControllerAction:
    """Gives the goals of an action server to a controller, and offers its queries.

    Goals come in threads of rospy that hold actionlib's lock. The controller moves them later, in
    the thread of the simulation, which takes that lock for a moment.
    """

    def __init__(self, world: RunningWorld, controller: ActionController):
        self._world, self._controller = world, controller
        self._kind = ACTIONS[controller.goal_kind]
        self._goals: dict[str, Goal] = {}
        calls = (self._kind.kind, self._receive, self._cancel)
        self._server = LastingServer(controller.topic(controller.action), *calls, auto_start=False)
        self._server.start()
        kind = arm_srv.QueryTrajectoryState
        self._services = [
            rospy.Service(controller.topic(name), kind, partial(self._answer, ask))
            for name, ask in controller.queries.items()
        ]

    def shutdown(self) -> None:
        """Shut down the action and the services."""
        self._server.stop()
        for service in self._services:
            service.shutdown()

    def _answer(self, ask: Any, request: Any) -> Any:
        try:
            names, point = self._world.do(lambda: ask(request.time.to_sec()))
        except LabError as error:
            raise rospy.ServiceException(str(error)) from error
        return names, point.positions, point.velocities, point.accelerations

    def _receive(self, handle: ServerGoalHandle) -> None:
        def tell(feedback: Any) -> None:
            handle.publish_feedback(self._kind.feedback(feedback))

        goal = Goal(self._kind.goal_of(handle.get_goal()), partial(self._moved, handle), tell)
        self._goals[handle.get_goal_id().id] = goal
        self._controller.receive(goal)

    def _cancel(self, handle: ServerGoalHandle) -> None:
        goal = self._goals.get(handle.get_goal_id().id)
        if goal is not None:
            self._controller.cancel(goal)

    def _moved(self, handle: ServerGoalHandle, goal: Goal) -> None:
        if goal.state == actions.ACTIVE:
            handle.set_accepted()
            return
        del self._goals[handle.get_goal_id().id]
        ends = {
            actions.REJECTED: handle.set_rejected,
            actions.PREEMPTED: handle.set_canceled,
            actions.ABORTED: handle.set_aborted,
            actions.SUCCEEDED: handle.set_succeeded,
        }
        result = None if goal.result is None else self._kind.result(goal.result)
        ends[goal.state](result, goal.text)


def check_action(controller: ActionController) -> None:
    """Raise ControlError if the types of a controller's action are missing."""
    if controller.goal_kind not in ACTIONS:
        raise ControlError(f"'{controller.kind}' needs the package control_msgs, which is missing")
