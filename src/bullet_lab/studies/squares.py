"""The squares without ROS: world, robot, driver, noise and files in one process.

Example:
    bullet_lab squares std:=0.1 seed:=1
"""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Sequence

import numpy as np
from numpy import ndarray

from bullet_lab.core.parameters import boolean, choice, integer
from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import quaternion_from_yaw, yaw_from_quaternion
from bullet_lab.drive import MODES, OPEN_LOOP, Command, PlanarPose, Square, SquareDriver
from bullet_lab.noise.noisy_odom import OdometryNoise, preset
from bullet_lab.noise.odometry_noise import MODELS, noise_parameters
from bullet_lab.noise.systematic import SystematicErrors, SystematicSpread
from bullet_lab.reports import Reading, save_all
from bullet_lab.reports.squares import SquaresReport
from bullet_lab.simulation.plugins.samples import OdometrySample, PlanarCommand
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.studies.study import MOST_SEED, Settings, Summary, Tell, run_from

WORLD = "package://bullet_lab/worlds/empty.world"
ROBOT = "package://bullet_lab/urdf/block_robot.urdf"
SECONDS_PER_STEP = 1e-3
NANOSECONDS_PER_STEP = 1_000_000
NO_SIDE = -1
"""The side of poses before the first one."""


@dataclass(frozen=True, eq=False)
class SquareDrive:
    """The perfect odometry of a square, message by message.

    Attributes:
        steps: ms, shape (n,).
        poses: x (m), y (m), yaw (rad), shape (n, 3).
        sides: from 0, each with the turn after it; `NO_SIDE` before the first; (n,).
        variances: of x and y as the odometry states them (m²), shape (n, 2).
        corners: start of each side, and end of the last one (m), shape (sides + 1, 2).
    """

    steps: ndarray
    poses: ndarray
    sides: ndarray
    variances: ndarray
    corners: ndarray

    @property
    def stamps(self) -> ndarray:
        """Stamps of the messages in s, shape (n,)."""
        return self.steps * SECONDS_PER_STEP


def drive_square(square: Square, mode: str = OPEN_LOOP, rest: float = 0.5) -> SquareDrive:
    """Simulate the block robot along a square, with a rest (s) before and after it.

    Raises:
        LabError: the mode is unknown, or the simulation's files are missing.
    """
    driver = SquareDriver(square, mode)
    rows: list[tuple[int, PlanarPose, int, Sequence[float]]] = []
    corners: list[tuple[float, float]] = []

    def record(sample: OdometrySample) -> None:
        side = NO_SIDE + len(corners)
        rows.append((sample.step, _planar(sample.pose), side, sample.pose_variances[:2]))

    with Simulation.of(WORLD) as simulation:
        robot = simulation.spawn(ROBOT)
        robot.listen("odom", record)

        def send(command: Command, seconds: float) -> None:
            robot.command("cmd_vel", PlanarCommand(vx=command[0], wz=command[1]))
            simulation.run_for(seconds)

        simulation.run_for(rest)
        while True:
            pose = _planar(robot.pose())
            # As a node, it knows the newest message.
            command = driver.command(rows[-1][1] if rows else pose)
            if command is None:
                break
            if driver.sides_done == len(corners):
                corners.append(pose[:2])
            send(command, 1.0 / driver.rate)
        send((0.0, 0.0), rest)
        corners.append(_planar(robot.pose())[:2])
        return SquareDrive(*map(np.array, (*zip(*rows), corners)))


def _planar(pose: Pose) -> PlanarPose:
    """Return x, y (m) and yaw (rad), bit for bit as nodes read them from a message."""
    x, y, _ = pose.position
    return x, y, yaw_from_quaternion(*pose.quaternion)


@dataclass(frozen=True)
class SquaresSettings(noise_parameters(), SystematicErrors, SystematicSpread, Settings):
    """Settings of a run, with the names of the job's arguments."""

    seed: int = integer(1, "seed of the noise", 0, MOST_SEED)
    model: str = choice("report", "rule of the noise", MODELS)
    noise: str = preset()
    mode: str = choice(OPEN_LOOP, "condition that ends a side", MODES)
    as_published: bool = boolean(False, "apply the report's noise with all its defects")


def run_squares(folder: Path, settings: SquaresSettings) -> Summary:
    """Drive the square; write paths.csv, paths.png, TUM files and summary.json.

    The same settings give the same files, byte for byte: those of the job with ROS, whose
    summary.json also has the times of its run. Returns the entries after the settings. Raises
    LabError if the folder cannot be written to.
    """
    noise = OdometryNoise(settings)
    report = SquaresReport(folder)
    report.about = {"job": "squares", **asdict(settings)}
    drive = drive_square(Square(), settings.mode)
    for step, pose, own in zip(drive.steps.tolist(), drive.poses.tolist(), drive.variances):
        stamp = step * NANOSECONDS_PER_STEP
        report.take(SquaresReport.PERFECT, Reading(stamp, pose))
        noisy = noise.update(step * SECONDS_PER_STEP, pose)
        if noisy is not None:
            # As read from the quaternion of a message.
            x, y, yaw = noisy.pose
            noisy_pose = x, y, yaw_from_quaternion(*quaternion_from_yaw(yaw))
            reading = Reading(stamp, noisy_pose, np.diag(own) + noisy.covariance[:2, :2])
            report.take(SquaresReport.NOISY, reading)
    return save_all(report, True, {"sim_time_s": report.seconds()})


def _run(folder: Path, settings: SquaresSettings, _tell: Tell) -> list[str]:
    return [SquaresReport.line(run_squares(folder, settings))]


main = functools.partial(run_from, "squares", __doc__, (SquaresSettings,), _run)
