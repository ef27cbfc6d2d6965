"""Which of the report's defects make its figure 1b? All 32 combinations, over many seeds.

Example:
    python3 -m bullet_lab.studies.published_noise results/published --std 0.1 --seeds 1000
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Dict, List, NoReturn, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.figures import save
from bullet_lab.core.files import make_folder, write_json
from bullet_lab.core.parameters import check_parameters, integer, number
from bullet_lab.core.se2 import PlanarPose
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
    Row,
    Sheet,
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
    groups_of_same,
    log10_to_best,
    published_summary,
    ranked,
    rounded,
    verdict_lines,
)
from bullet_lab.studies.published_noise.side_deviation import (
    NO_SIDE,
    SEEN_AT_END,
    SIDES,
    PublishedFigure,
    read_published_figure,
    side_deviations,
)
from bullet_lab.studies.squares import SECONDS_PER_STEP, drive_square
from bullet_lab.studies.study import (
    MOST_SEED,
    SUMMARY,
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
class PublishedNoiseSettings:
    """What is run; the std of figure 1b is 0.1."""

    std: float = number(
        0.1, "standard deviation of the noise per metre and per radian", 0.0, maximum=LARGEST_STD
    )
    seeds: int = integer(1000, "noisy paths for each combination", FEWEST_SEEDS, MOST_SEEDS)
    seed: int = integer(
        1, "seed of the first noisy path; the others have those that follow", 0, MOST_SEED
    )

    def __post_init__(self) -> None:
        """Raise ParameterError where a value is not allowed."""
        check_parameters(self)


@dataclass(frozen=True, eq=False)
class SquareDrive:
    """The perfect odometry of the square, driven as in listing 9.

    Attributes:
        stamps: s, shape (n,).
        poses: x (m), y (m), yaw (rad), shape (n, 3).
        sides: 0 to 3 for each message, the turn after it included; `NO_SIDE` before; (n,).
        corners: where the sides start and the last one ends (m), shape (5, 2).
    """

    stamps: np.ndarray
    poses: np.ndarray
    sides: np.ndarray
    corners: np.ndarray


def replay_drive() -> SquareDrive:
    """Simulate the drive of figure 1a, with a rest before and after it.

    Raises:
        LabError: the simulation cannot be run.
    """
    stamps: List[float] = []
    poses: List[PlanarPose] = []
    sides: List[int] = []
    corners: List[Tuple[float, float]] = []

    def record(step: int, pose: PlanarPose) -> None:
        stamps.append(step * SECONDS_PER_STEP)
        poses.append(pose)
        sides.append(len(corners) - 1 if corners else NO_SIDE)

    drive_square(
        Square(sides=SIDES),
        record,
        rest=REST_SECONDS,
        on_corner=lambda pose: corners.append(pose[:2]),
    )
    return SquareDrive(np.array(stamps), np.array(poses), np.array(sides), np.array(corners))


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
        draws = self._draws(paths)
        return {defects: self._deviations(defects, paths, draws) for defects in combinations()}

    def _deviations(self, defects: Defects, paths: Sequence[int], draws: np.ndarray) -> np.ndarray:
        drive, messages = self.drive, self.messages(defects, paths)
        noisy = self._noisy(defects, messages, draws)[..., :2]
        at_end = np.hypot(*(noisy[-1] - drive.poses[messages[-1], :2]).T)
        sides = side_deviations(noisy, drive.sides[messages], drive.corners)
        return np.column_stack([sides, at_end])

    def noisy(self, defects: Defects, paths: Sequence[int]) -> np.ndarray:
        """Return noisy poses, shape (n, m, 3), of the m paths with these numbers."""
        messages = self.messages(defects, paths)
        return self._noisy(defects, messages, self._draws(paths))

    def messages(self, defects: Defects, paths: Sequence[int]) -> np.ndarray:
        """Return the indices of the perfect poses that the algorithm sees, (n, m) or (n, 1)."""
        if defects.sampled:
            return self._messages[:, paths]
        return np.arange(len(self.drive.stamps))[:, np.newaxis]

    def _noisy(self, defects: Defects, messages: np.ndarray, draws: np.ndarray) -> np.ndarray:
        poses = self.drive.poses[messages]
        return noisy_paths(poses, draws[: len(poses) - 1], self._settings.std, defects)

    def _draws(self, paths: Sequence[int]) -> np.ndarray:
        steps = len(self.drive.stamps) - 1
        generators = [make_generator(self._settings.seed + int(path)) for path in paths]
        return np.stack([g.standard_normal((steps, 3)) for g in generators], axis=1)


def run_published_noise(folder: Path, settings: PublishedNoiseSettings) -> Dict[str, Any]:
    """Run the experiment and leave its pictures, tables and summary.json.

    The same settings give the same files. Nothing is written before all is known.

    Args:
        folder: where the files go; made if need be.
        settings: what is run.

    Returns:
        What summary.json says.

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
    by_defects = {result.defects: result for result in results}
    nearest = [by_defects[ALL].likeness.nearest]
    sheet = Sheet(replay.drive.corners, figure.points, figure.corners, settings.std)
    examples = range(min(_EXAMPLES, settings.seeds))
    shown = {
        defects: (replay.noisy(defects, examples)[..., :2], by_defects[defects].likeness.p_value)
        for defects in _telling(results[0].defects)
    }
    ways = np.hypot(*np.diff(replay.drive.poses[:, :2], axis=0, prepend=np.nan).T)
    third = replay.drive.stamps[(replay.drive.sides == 2) & (ways > MIN_TRANSLATION)]
    turns = {
        defects: (
            replay.drive.stamps[replay.messages(defects, nearest)[:, 0]],
            replay.drive.poses[replay.messages(defects, nearest)[:, 0]],
            replay.noisy(defects, nearest)[:, 0],
        )
        for defects in (ALL, Defects(**{n: n != "unwrapped" for n in DEFECTS}))
    }
    return {
        "compare.png": compare_figure(
            sheet,
            replay.noisy(ALL, nearest)[:, 0, :2],
            replay.noisy(NONE, nearest)[:, 0, :2],
            settings.seed + nearest[0],
        ),
        "defects.png": defects_figure(sheet, shown, results[0].defects),
        "first_turns.png": first_turns_figure(turns, (third[0], third[-1])),
        "sides.png": sides_figure(_rows(results), figure.deviations),
    }


def _telling(best: Defects) -> List[Defects]:
    """Return the combinations for the sheet: all, the best, none, each alone, all but each."""
    alone = [Defects(**{name: True}) for name in DEFECTS]
    all_but = [Defects(**{n: n != name for n in DEFECTS}) for name in DEFECTS]
    return list(dict.fromkeys([ALL, best, NONE, *alone, *all_but]))


def _rows(results: List[Result]) -> List[Row]:
    ratios = dict(zip((result.defects for result in results), log10_to_best(results)))
    return [
        Row(
            [_switch([getattr(r.defects, name) for r in group]) for name in DEFECTS],
            group[0].quantiles(),
            ratios[group[0].defects],
            group[0].likeness.p_value,
        )
        for group in groups_of_same(results)
    ]


def _switch(values: List[bool]) -> Optional[bool]:
    return values[0] if len(set(values)) == 1 else None


def _run(folder: Path, settings: PublishedNoiseSettings, _tell: Tell) -> None:
    print("\n".join(verdict_lines(run_published_noise(folder, settings))))


def main(words: Optional[Sequence[str]] = None) -> NoReturn:
    """Run the experiment from the command line; see `run_from`."""
    run_from("published_noise", __doc__, (PublishedNoiseSettings,), _run, words)
