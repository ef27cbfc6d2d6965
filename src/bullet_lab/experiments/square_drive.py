"""The square, driven in the simulation without ROS."""

from __future__ import annotations

from typing import Callable

from bullet_lab.errors import LabError
from bullet_lab.numerics.angles import yaw_from_quaternion
from bullet_lab.numerics.square_driver import (
    CLOSED_LOOP_RATE,
    OPEN_LOOP_RATE,
    ClosedLoopSide,
    PlanarPose,
    Square,
    open_loop_side,
)
from bullet_lab.simulation.pose import Pose
from bullet_lab.simulation.samples import OdometrySample, PlanarCommand
from bullet_lab.simulation.simulation import ModelInstance, Simulation

WORLD = "package://bullet_lab/worlds/empty.world"
ROBOT = "package://bullet_lab/urdf/block_robot.urdf"
MODES = ("open_loop", "closed_loop")
SECONDS_PER_STEP = 1e-3


class SquareDriveError(LabError):
    """A drive that is not known."""


def drive_square(
    square: Square,
    on_odometry: Callable[[int, PlanarPose], None],
    mode: str = "open_loop",
    rest: float = 0.5,
    on_corner: Callable[[PlanarPose], None] = lambda pose: None,
) -> float:
    """Simulate the block robot along a square, with a rest before and after it.

    Args:
        square: what to drive.
        on_odometry: gets the step in ms and the pose (m, m, rad) of each odometry message.
        mode: one of `MODES`, what ends a side.
        rest: s.
        on_corner: gets the pose at the start of each side and at the end.

    Returns:
        How long it took, in s of simulated time.

    Raises:
        LabError: the mode is unknown, or the simulation's files are missing.
    """
    if mode not in MODES:
        raise SquareDriveError(f"mode '{mode}' is not one of {', '.join(MODES)}")

    def record(sample: OdometrySample) -> None:
        on_odometry(sample.step, planar(sample.pose))

    with Simulation.of(WORLD) as simulation:
        driver = _Driver(simulation, simulation.spawn(ROBOT))
        driver.robot.listen("odom", record)
        simulation.run_for(rest)
        heading = driver.pose()[2]
        for _ in range(square.sides):
            on_corner(driver.pose())
            if mode == "open_loop":
                driver.drive_by_clock(square)
            else:
                heading = driver.drive_by_pose(square, heading)
        driver.send(0.0, 0.0, rest)
        on_corner(driver.pose())
        return simulation.seconds


def planar(pose: Pose) -> PlanarPose:
    """Return x, y (m) and yaw (rad), to the bit as nodes read them from a message."""
    x, y, _ = pose.position
    return x, y, yaw_from_quaternion(*pose.quaternion)


class _Driver:
    """Commands the robot of a simulation."""

    def __init__(self, simulation: Simulation, robot: ModelInstance):
        self.robot = robot
        self._simulation = simulation

    def pose(self) -> PlanarPose:
        return planar(self.robot.pose())

    def send(self, ahead: float, turn: float, seconds: float) -> None:
        self.robot.command("cmd_vel", PlanarCommand(vx=ahead, wz=turn))
        self._simulation.run_for(seconds)

    def drive_by_clock(self, square: Square) -> None:
        for ahead, turn in open_loop_side(square):
            self.send(ahead, turn, 1.0 / OPEN_LOOP_RATE)

    def drive_by_pose(self, square: Square, heading: float) -> float:
        side = ClosedLoopSide(square, self.pose(), heading)
        while not side.done:
            self.send(*side.command(self.pose()), 1.0 / CLOSED_LOOP_RATE)
        return side.next_heading
