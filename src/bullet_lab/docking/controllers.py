"""What drives into a dock, by name: ours, and others to measure it against.

Another one is a class with the methods of `DockingController` in a file of its own, and a line in
CONTROLLERS.
"""

from __future__ import annotations

import functools
from typing import Callable, Dict, Optional, Protocol

from bullet_lab.docking.graceful import GracefulSettings, GracefulTask
from bullet_lab.docking.task import DockingTask
from bullet_lab.docking.types import Command, DockingResult, Observation, Odometry


class DockingController(Protocol):
    """A docking under way, fed with odometry and images and asked for commands at 20 Hz.

    It is made of a dock, its rough pose in the odometry frame and the camera's mount, and by name
    of `time_limit` (s) and `seed`.
    """

    @property
    def result(self) -> Optional[DockingResult]:
        """How it ended; None before."""

    @property
    def wants_images(self) -> bool:
        """Whether an image would be used now."""

    def add_odometry(self, odometry: Odometry) -> None:
        """Take the next message of odometry."""

    def add_observation(self, observation: Observation) -> None:
        """Take what was seen in an image."""

    def tick(self, stamp: float) -> Command:
        """Return the command (m/s, rad/s) for a time in s."""


TUNED = GracefulSettings(
    k_delta=3.0,
    v_linear_min=0.02,
    slowdown_radius=1.0,
    backward_projection=0.1,
    external_detection_translation_x=0.0075,
    docking_threshold=0.01,
    dock_approach_timeout=60.0,
)
"""To the docks and the robot of this package; docs/docking.md says how."""

CONTROLLERS: Dict[str, Callable[..., DockingController]] = {
    "ours": DockingTask,
    "graceful": functools.partial(GracefulTask, settings=TUNED),
    "graceful_nav2": GracefulTask,
}
"""The last one has nav2's defaults."""
