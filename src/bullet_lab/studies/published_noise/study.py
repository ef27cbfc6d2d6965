"""Which of the report's defects make its figure 1b? All 32 combinations, over many seeds.

Example:
    python3 -m bullet_lab.studies.published_noise.study results/published --std 0.1 --seeds 1000
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Dict, List, NoReturn, Optional, Sequence

import numpy as np

from bullet_lab.core.figures import save
from bullet_lab.core.files import make_folder, write_json
from bullet_lab.core.parameters import integer, number
from bullet_lab.drive.square import OPEN_LOOP_RATE, Square
from bullet_lab.noise.odometry_noise import MIN_TRANSLATION, make_generator
from bullet_lab.noise.published_noise import PUBLISHED_RATE
from bullet_lab.simulation.world.resources import package_share
from bullet_lab.studies.published_noise.defects import (
    ALL,
    DEFECTS,
    NONE,
    Defects,
    combinations,
    noisy_paths,
    sampled,
)
from bullet_lab.studies.published_noise.figures import (
    compare_figure,
    defects_figure,
    first_turns_figure,
    sides_figure,
)
from bullet_lab.studies.published_noise.results import (
    Result,
    combination_rows,
    compare,
    deviation_rows,
    published_summary,
    ranked,
    rounded,
    verdict_lines,
)
from bullet_lab.studies.published_noise.side_deviation import (
    SEEN_AT_END,
    SIDES,
    PublishedFigure,
    read_published_figure,
    side_deviations,
)
from bullet_lab.studies.squares import SquareDrive, drive_square
from bullet_lab.studies.study import (
    MOST_SEED,
    SUMMARY,
    Settings,
    Tell,
    run_from,
    whole_results,
    write_table,
)

FIGURE_DATA = "data/fig1_paths.csv"
# Long enough for the sampling node to look before and after the drive, whatever its phase.
REST_SECONDS = 2.0 / PUBLISHED_RATE + 0.1

LARGEST_STD = 1.0
FEWEST_SEEDS, MOST_SEEDS = 20, 20000
_SEEDS_AT_A_TIME = 500
_EXAMPLES = 12


@dataclass(frozen=True)
class PublishedNoiseSettings(Settings):
    """What is run; the std of figure 1b is 0.1."""

    std: float = number(
        0.1, "standard deviation of the noise per metre and per radian", 0.0, maximum=LARGEST_STD
    )
    seeds: int = integer(1000, "noisy paths for each combination", FEWEST_SEEDS, MOST_SEEDS)
    seed: int = integer(
        1, "seed of the first noisy path; the others have those that follow", 0, MOST_SEED
    )


def replay_drive() -> SquareDrive:
    """Simulate the drive of figure 1a, with a rest before and after it; raises LabError."""
    return drive_square(Square(sides=SIDES), rest=REST_SECONDS)


class Replay:
    """Noisy paths of the drive. Path k has the draws of a live node with the seed `seed` + k.

    Args:
        drive: the perfect path.
        settings: what is run.
    """

    def __init__(self, drive: SquareDrive, settings: PublishedNoiseSettings):
        self.drive = drive
        self._settings = settings
        # Nobody knows when, within its period, the node of figure 1b looked: any time will do.
        phases = np.random.default_rng([settings.seed, 1]).uniform(size=settings.seeds)
        self._messages = sampled(drive.stamps, PUBLISHED_RATE, phases / PUBLISHED_RATE)

    def deviations(self, paths: Sequence[int]) -> Dict[Defects, np.ndarray]:
        """Return the deviations (m) of m paths for each combination, shape (m, 5).

        They are the largest on each of the four sides, and the distance at the end.
        """
        drive, draws = self.drive, self._draws(paths)
        found = {}
        for defects in combinations():
            messages = self.messages(defects, paths)
            noisy = self._noisy(defects, messages, draws)[..., :2]
            at_end = np.hypot(*(noisy[-1] - drive.poses[messages[-1], :2]).T)
            sides = side_deviations(noisy, drive.sides[messages], drive.corners)
            found[defects] = np.column_stack([sides, at_end])
        return found

    def noisy(self, defects: Defects, paths: Sequence[int]) -> np.ndarray:
        """Return noisy poses, shape (n, m, 3), of the m paths with these numbers."""
        return self._noisy(defects, self.messages(defects, paths), self._draws(paths))

    def messages(self, defects: Defects, paths: Sequence[int]) -> np.ndarray:
        """Return the indices of the perfect poses that the algorithm sees, (n, m) or (n, 1)."""
        if defects.sampled:
            return self._messages[:, paths]
        return np.arange(len(self.drive.steps))[:, np.newaxis]

    def _noisy(self, defects: Defects, messages: np.ndarray, draws: np.ndarray) -> np.ndarray:
        poses = self.drive.poses[messages]
        return noisy_paths(poses, draws[: len(poses) - 1], self._settings.std, defects)

    def _draws(self, paths: Sequence[int]) -> np.ndarray:
        steps = len(self.drive.steps) - 1
        generators = [make_generator(self._settings.seed + int(path)) for path in paths]
        return np.stack([g.standard_normal((steps, 3)) for g in generators], axis=1)


def run_published_noise(folder: Path, settings: PublishedNoiseSettings) -> Dict[str, Any]:
    """Run the experiment, leave pictures, tables and summary.json, and return what that says.

    The same settings give the same files. Nothing is written before all is known.

    Raises:
        LabError: a folder that cannot be written to, or files of the package that are missing.
    """
    make_folder(folder)
    drive = replay_drive()
    figure = read_published_figure(package_share() / FIGURE_DATA, drive.corners)
    replay = Replay(drive, settings)
    results = ranked(_results(replay, figure, settings))
    summary = published_summary(
        asdict(settings), _figure_facts(figure, drive), figure.deviations, results
    )
    pictures = _pictures(replay, figure, results, settings)
    with whole_results(folder) as part:
        for name, picture in pictures.items():
            save(picture, part / name)
        write_table(part / "combinations.csv", combination_rows(results))
        write_table(part / "deviations.csv", deviation_rows(results, settings.seed))
        write_json(part / SUMMARY, summary)
    return summary


def _results(
    replay: Replay, figure: PublishedFigure, settings: PublishedNoiseSettings
) -> List[Result]:
    blocks = [
        replay.deviations(range(start, min(start + _SEEDS_AT_A_TIME, settings.seeds)))
        for start in range(0, settings.seeds, _SEEDS_AT_A_TIME)
    ]
    results = []
    for defects in combinations():
        deviations = np.concatenate([block[defects] for block in blocks])
        likeness = compare(figure.deviations, deviations, settings.seed)
        results.append(Result(defects, deviations, likeness))
    return results


def _figure_facts(figure: PublishedFigure, drive: SquareDrive) -> Dict[str, Any]:
    simulated, drawn = (
        float(np.hypot(*(corners[3] - corners[2]))) for corners in (drive.corners, figure.corners)
    )
    speed = simulated * OPEN_LOOP_RATE / Square().side_commands
    return {
        "side_deviation_m": rounded(figure.deviations[:SIDES]),
        "end_deviation_m": SEEN_AT_END,
        "third_side_steps": figure.third_side_steps,
        "sampling_rate_hz": round(speed * figure.third_side_steps / drawn, 3),
    }


def _pictures(
    replay: Replay,
    figure: PublishedFigure,
    results: List[Result],
    settings: PublishedNoiseSettings,
) -> Dict[str, Any]:
    drive = replay.drive
    likeness = {result.defects: result.likeness for result in results}
    nearest = [likeness[ALL].nearest]
    best = results[0].defects
    # All, the best, none, each alone, all but each.
    alone = [Defects(**{name: True}) for name in DEFECTS]
    all_but = [Defects(**{n: n != name for n in DEFECTS}) for name in DEFECTS]
    examples = range(min(_EXAMPLES, settings.seeds))
    shown = {
        defects: (replay.noisy(defects, examples)[..., :2], likeness[defects].p_value)
        for defects in dict.fromkeys([ALL, best, NONE, *alone, *all_but])
    }
    ways = np.hypot(*np.diff(drive.poses[:, :2], axis=0, prepend=np.nan).T)
    third = drive.stamps[(drive.sides == 2) & (ways > MIN_TRANSLATION)]
    turns = {}
    for defects in (ALL, Defects(**{n: n != "unwrapped" for n in DEFECTS})):
        seen = replay.messages(defects, nearest)[:, 0]
        turns[defects] = drive.stamps[seen], drive.poses[seen], replay.noisy(defects, nearest)[:, 0]
    replays = [replay.noisy(defects, nearest)[:, 0, :2] for defects in (ALL, NONE)]
    return {
        "compare.png": compare_figure(figure, drive.corners, replays, settings.seed + nearest[0]),
        "defects.png": defects_figure(figure, drive.corners, shown, best, settings.std),
        "first_turns.png": first_turns_figure(turns, (third[0], third[-1])),
        "sides.png": sides_figure(results, figure.deviations),
    }


def _run(folder: Path, settings: PublishedNoiseSettings, _tell: Tell) -> None:
    print("\n".join(verdict_lines(run_published_noise(folder, settings))))


def main(words: Optional[Sequence[str]] = None) -> NoReturn:
    """Run the experiment from the command line; see `run_from`."""
    run_from("published_noise", __doc__, (PublishedNoiseSettings,), _run, words)


if __name__ == "__main__":
    main()
