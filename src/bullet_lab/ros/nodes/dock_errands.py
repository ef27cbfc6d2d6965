"""What the dock node is busy with: one goal, from its acceptance to its result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable, Mapping, Optional, Sequence

from actionlib import ServerGoalHandle

from bullet_lab.docking.database import Dock
from bullet_lab.docking.task import DockingTask, UndockingTask
from bullet_lab.docking.types import (
    CameraMount,
    DockingError,
    DockingResult,
    DockingSettings,
    Observation,
    Odometry,
    PlanarPose,
)
from bullet_lab.msg import DockGoal, UndockFeedback
from bullet_lab.ros.nodes.dock_goals import (
    Lookup,
    check_dock_goal,
    check_undock_goal,
    dock_feedback,
    dock_of,
    dock_result,
    rough_pose,
    undock_result,
)


@dataclass(frozen=True)
class Surroundings:
    """What is known at the start of an errand.

    Attributes:
        docks: the database.
        usual: name of the dock that one given by its pose is like.
        settings: of docking.
        seed: of what is random in it.
        frame: of the odometry.
        lookup: returns the pose of its second frame in its first, or raises LabError.
        mount: where the camera is.
        last_dock: where the robot has docked last, in the odometry frame; None for nowhere.
    """

    docks: Mapping[str, Dock]
    usual: str
    settings: DockingSettings
    seed: int
    frame: str
    lookup: Lookup
    mount: Optional[CameraMount] = None
    last_dock: Optional[PlanarPose] = None


class Errand:
    """A goal that is pursued, by a task once the first odometry is there.

    Args:
        handle: of the accepted goal.

    Attributes:
        needs_camera: it cannot do without.
    """

    needs_camera = False

    def __init__(self, handle: ServerGoalHandle):
        self.handle = handle
        self.task: Any = None

    def check(self) -> None:
        """Raise GoalError for a goal that makes no sense by itself."""
        raise NotImplementedError

    def start(self, surroundings: Surroundings) -> None:
        """Make the task; raises GoalError."""
        raise NotImplementedError

    def step(
        self, seconds: float, odometry: Sequence[Odometry], observations: Sequence[Observation]
    ) -> Any:
        """Feed the task with what is new and return its command (m/s, rad/s)."""
        for message in odometry:
            self.task.add_odometry(message)
        for observation in observations:
            self.task.add_observation(observation)
        return self.task.tick(seconds)

    def publish_feedback(self) -> None:
        """Tell the client how it goes."""
        raise NotImplementedError

    def end(self, result: DockingResult) -> None:
        """Tell the client how it ended."""
        message = self.result_message(result)
        if result.success:
            self.handle.set_succeeded(message, result.message)
        elif result.error == DockingError.PREEMPTED:
            self.handle.set_canceled(message, result.message)
        else:
            self.handle.set_aborted(message, result.message)

    def result_message(self, result: DockingResult) -> Any:
        """Return a result as the action sends it."""
        raise NotImplementedError


class DockErrand(Errand):
    """Drives into a dock.

    Args:
        handle: of the accepted goal.
        refine: gives a dock of the database the tolerances that are wanted here.
    """

    needs_camera = True

    def __init__(self, handle: ServerGoalHandle, refine: Callable[[Dock], Dock]):
        super().__init__(handle)
        self._refine = refine

    def check(self) -> None:  # noqa: D102 - inherited
        check_dock_goal(self.handle.get_goal())

    def start(self, surroundings: Surroundings) -> None:  # noqa: D102 - inherited
        goal = self.handle.get_goal()
        dock = dock_of(goal, surroundings.docks, surroundings.usual)
        pose = rough_pose(goal, dock, surroundings.frame, surroundings.lookup)
        self.task = DockingTask(
            self._refine(dock),
            pose,
            surroundings.mount,
            surroundings.settings,
            search=goal.search,
            max_retries=goal.max_retries,
            seed=surroundings.seed,
        )

    def publish_feedback(self) -> None:  # noqa: D102 - inherited
        self.handle.publish_feedback(dock_feedback(self.task.status))

    def result_message(self, result: DockingResult) -> Any:  # noqa: D102 - inherited
        return dock_result(result)


class UndockErrand(Errand):
    """Drives backwards out of a dock, on its axis where the camera shows it."""

    def check(self) -> None:  # noqa: D102 - inherited
        check_undock_goal(self.handle.get_goal())

    def start(self, surroundings: Surroundings) -> None:  # noqa: D102 - inherited
        asked = DockGoal(dock_id=surroundings.usual)
        dock = dock_of(asked, surroundings.docks, surroundings.usual)
        pose = surroundings.last_dock
        if pose is None:
            pose = rough_pose(asked, dock, surroundings.frame, surroundings.lookup)
        self.task = UndockingTask(
            self.handle.get_goal().distance,
            dock=dock,
            dock_pose=pose,
            mount=surroundings.mount,
            settings=surroundings.settings,
        )

    def publish_feedback(self) -> None:  # noqa: D102 - inherited
        self.handle.publish_feedback(UndockFeedback(self.task.remaining))

    def result_message(self, result: DockingResult) -> Any:  # noqa: D102 - inherited
        return undock_result(result)
