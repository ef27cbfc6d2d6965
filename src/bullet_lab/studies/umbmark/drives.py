"""Squares that robots drive by their odometry, in this process."""

from __future__ import annotations

from typing import Callable, List, Protocol

import numpy as np

from bullet_lab.core.se2 import PlanarPose
from bullet_lab.drive.square import CLOSED_LOOP, Square, SquareDriver
from bullet_lab.studies.study import UnfinishedError
from bullet_lab.studies.umbmark.runs import Run

REST_SECONDS = 0.5
PATIENCE = 3.0
"""Times as long as a square takes at its speeds: a robot that is not round by then never is."""


class Robot(Protocol):
    """What drives: odometry has what was reported so far, the last entry the present one."""

    odometry: List[PlanarPose]

    def pose(self) -> PlanarPose:
        """Return where it really is: (m, m, rad)."""

    def drive(self, ahead: float, turning: float, seconds: float) -> None:
        """Follow a command (m/s, rad/s) for some time."""


def drive_square(
    robot: Robot,
    square: Square,
    name: str,
    noisy: Callable[[PlanarPose], PlanarPose] = lambda pose: pose,
) -> Run:
    """Drive a square by odometry, with a rest after it.

    Args:
        robot: that stands still.
        square: its turns are clockwise where the turn speed is negative.
        name: of the run.
        noisy: makes what the robot goes by of each pose that its odometry reports, in order.

    Raises:
        UnfinishedError: the robot does not come round.
    """
    driver = SquareDriver(square, CLOSED_LOOP)
    start, period = robot.pose(), 1.0 / driver.rate
    first = len(robot.odometry) - 1
    reported: List[PlanarPose] = []

    def newest() -> PlanarPose:
        while first + len(reported) < len(robot.odometry):
            reported.append(noisy(robot.odometry[first + len(reported)]))
        return reported[-1]

    seconds = square.sides * (square.side / square.speed + np.pi / abs(square.turn_speed))
    for _ in range(round(PATIENCE * seconds / period)):
        command = driver.command(newest())
        if command is None:
            robot.drive(0.0, 0.0, REST_SECONDS)
            newest()
            return Run(name, np.array(reported), start, robot.pose())
        robot.drive(*command, period)
    raise UnfinishedError(f"{name}: the robot does not come round its square")
