"""The squares, without ROS: world, robot, driver, noise and files in one process.

Example:
    python3 -m bullet_lab.studies.squares results/plain --std 0.1 --seed 1
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Sequence

from bullet_lab.core.angles import quaternion_from_yaw, yaw_from_quaternion
from bullet_lab.core.figures import save
from bullet_lab.core.files import write_json
from bullet_lab.core.pose import Pose
from bullet_lab.drive.square import MODES, OPEN_LOOP, Command, PlanarPose, Square, SquareDriver
from bullet_lab.errors import LabError
from bullet_lab.noise.odometry_noise import MODELS, NoisyPath, make_rule
from bullet_lab.noise.published_noise import PUBLISHED_RATE, PublishedNoise, Sampler
from bullet_lab.reports.squares import PathsRecording, noise_figure, squares_summary
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation

WORLD = "package://bullet_lab/worlds/empty.world"
ROBOT = "package://bullet_lab/urdf/block_robot.urdf"
SECONDS_PER_STEP = 1e-3


def drive_square(
    square: Square,
    on_odometry: Callable[[int, PlanarPose], None],
    mode: str = OPEN_LOOP,
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
    driver = SquareDriver(square, mode)
    with Simulation.of(WORLD) as simulation:
        robot = simulation.spawn(ROBOT)
        robot.listen("odom", lambda sample: on_odometry(sample.step, planar(sample.pose)))

        def send(command: Command, seconds: float) -> None:
            robot.command("cmd_vel", PlanarCommand(vx=command[0], wz=command[1]))
            simulation.run_for(seconds)

        simulation.run_for(rest)
        corners = 0
        while True:
            pose = planar(robot.pose())
            command = driver.command(pose)
            if command is None:
                break
            if driver.sides_done == corners:
                corners += 1
                on_corner(pose)
            send(command, 1.0 / driver.rate)
        send((0.0, 0.0), rest)
        on_corner(planar(robot.pose()))
        return simulation.seconds


def planar(pose: Pose) -> PlanarPose:
    """Return x, y (m) and yaw (rad), to the bit as nodes read them from a message."""
    x, y, _ = pose.position
    return x, y, yaw_from_quaternion(*pose.quaternion)


NANOSECONDS_PER_STEP = 1_000_000
DEFAULT_ALPHAS = (0.01, 0.001, 0.01, 0.001)


@dataclass(frozen=True)
class SquaresSettings:
    """Settings of a run; the names are those of the job's arguments."""

    std: float = 0.1
    seed: int = 1
    model: str = "report"
    mode: str = OPEN_LOOP
    as_published: bool = False


def run_squares(folder: Path, settings: SquaresSettings) -> Dict[str, Any]:
    """Drive the square and leave paths.csv, paths.png, the TUM files and summary.json.

    The same settings give the same files, byte for byte.

    Args:
        folder: where the files go; made if need be.
        settings: what is run.

    Returns:
        What summary.json says.

    Raises:
        LabError: a setting that makes no sense, or a folder that cannot be written to.
    """
    noise = _Noise(settings)
    recording = PathsRecording(folder)

    def record(step: int, pose: PlanarPose) -> None:
        stamp = step * NANOSECONDS_PER_STEP
        recording.add_perfect(stamp, pose)
        for noisy in noise.add(step, pose):
            recording.add_noisy(stamp, _through_message(noisy))

    seconds = drive_square(Square(), record, settings.mode)
    recording.finish()
    perfect, pairs = recording.perfect(), recording.pairs()
    summary = {
        "job": "squares",
        **asdict(settings),
        "finished": True,
        **squares_summary(perfect, pairs),
        "sim_time_s": seconds,
    }
    write_json(folder / "summary.json", summary)
    save(noise_figure(perfect, pairs), folder / "paths.png")
    return summary


class _Noise:
    """The noise of the settings, as noisy_odom puts it on."""

    def __init__(self, settings: SquaresSettings):
        rule = make_rule(settings.model, settings.std, DEFAULT_ALPHAS)
        self._path = NoisyPath(rule, settings.seed)
        self._published = PublishedNoise(settings.std, settings.seed)
        self._sampler = Sampler(PUBLISHED_RATE) if settings.as_published else None

    def add(self, step: int, pose: PlanarPose) -> List[PlanarPose]:
        """Return the noisy pose for a perfect one, or nothing where none is published."""
        if self._sampler is None:
            return [self._path.update(*pose).pose]
        return [self._published.update(*pose)] if self._sampler.due(step * SECONDS_PER_STEP) else []


def _through_message(pose: PlanarPose) -> PlanarPose:
    """Return a pose as it is after its yaw has gone through the quaternion of a message."""
    x, y, yaw = pose
    return x, y, yaw_from_quaternion(*quaternion_from_yaw(yaw))


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the experiment from the command line; return the exit status."""
    parser = argparse.ArgumentParser(description="Drive the square without ROS.")
    parser.add_argument("out", type=Path, help="folder for the results")
    parser.add_argument("--std", type=float, default=SquaresSettings.std)
    parser.add_argument("--seed", type=int, default=SquaresSettings.seed)
    parser.add_argument("--model", choices=MODELS, default=SquaresSettings.model)
    parser.add_argument("--mode", choices=MODES, default=SquaresSettings.mode)
    parser.add_argument("--as-published", action="store_true")
    values = vars(parser.parse_args(arguments))
    folder = values.pop("out")
    try:
        run_squares(folder, SquaresSettings(**values))
    except LabError as error:
        print(f"squares: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
