"""The whole way of a robot that drives squares, one command after another."""

from __future__ import annotations

from typing import Generator, Optional

from bullet_lab.numerics.square_driver import (
    CLOSED_LOOP_RATE,
    OPEN_LOOP_RATE,
    ClosedLoopSide,
    Command,
    DriverError,
    PlanarPose,
    Square,
    open_loop_side,
)

OPEN_LOOP, CLOSED_LOOP = "open_loop", "closed_loop"
MODES = (OPEN_LOOP, CLOSED_LOOP)

_Course = Generator[Command, Optional[PlanarPose], None]


class SquareCourse:
    """Says what a robot is to do next, at `rate` Hz.

    Attributes:
        rate: commands per second.
        needs_pose: whether `command` has to be told where the robot is.
        sides_done: how many sides have been driven, with the turn after each.

    Args:
        square: what is driven.
        mode: one of `MODES`, what ends a side.

    Raises:
        DriverError: an unknown mode.
    """

    def __init__(self, square: Square, mode: str = OPEN_LOOP):
        if mode not in MODES:
            raise DriverError(f"mode '{mode}' is not one of {', '.join(MODES)}")
        self._square = square
        self.needs_pose = mode == CLOSED_LOOP
        self.rate = CLOSED_LOOP_RATE if self.needs_pose else OPEN_LOOP_RATE
        self.sides_done = 0
        self._course: Optional[_Course] = None

    def command(self, pose: Optional[PlanarPose] = None) -> Optional[Command]:
        """Return the next command (m/s, rad/s), or None once all is driven.

        Args:
            pose: where the robot is (m, m, rad); of no interest to an open loop.
        """
        try:
            if self._course is None:
                self._course = self._by_odometry(pose) if self.needs_pose else self._by_clock()
                return next(self._course)
            return self._course.send(pose)
        except StopIteration:
            return None

    def _by_clock(self) -> _Course:
        for _ in range(self._square.sides):
            yield from open_loop_side(self._square)
            self.sides_done += 1

    def _by_odometry(self, pose: PlanarPose) -> _Course:
        heading = pose[2]
        for _ in range(self._square.sides):
            side = ClosedLoopSide(self._square, pose, heading)
            while not side.done:
                pose = yield side.command(pose)
            heading = side.next_heading
            self.sides_done += 1
