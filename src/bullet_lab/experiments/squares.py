"""The squares, without ROS: world, robot, driver, noise and files in one process.

Example:
    python3 -m bullet_lab.experiments.squares results/plain --std 0.1 --seed 1
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence

from bullet_lab.errors import LabError
from bullet_lab.experiments.square_drive import MODES, SECONDS_PER_STEP, drive_square
from bullet_lab.numerics.angles import quaternion_from_yaw, yaw_from_quaternion
from bullet_lab.numerics.odometry_noise import MODELS, NoisyPath, make_rule
from bullet_lab.numerics.published_noise import PUBLISHED_RATE, PublishedNoise, Sampler
from bullet_lab.numerics.square_driver import Square
from bullet_lab.plotting.noise_figure import noise_figure
from bullet_lab.plotting.style import save
from bullet_lab.recording.files import write_json
from bullet_lab.recording.paths import PathsRecording, PlanarPose
from bullet_lab.recording.squares_summary import squares_summary

NANOSECONDS_PER_STEP = 1_000_000
DEFAULT_ALPHAS = (0.01, 0.001, 0.01, 0.001)


@dataclass(frozen=True)
class SquaresSettings:
    """What is run; the names are those of the job's arguments."""

    std: float = 0.1
    seed: int = 1
    model: str = "report"
    mode: str = "open_loop"
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
