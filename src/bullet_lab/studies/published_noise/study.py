"""Which of the report's defects make its figure 1b? All 32 combinations, over many seeds.

Example:
    bullet_lab published_noise std:=0.1 seeds:=1000
"""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Sequence

import numpy as np
from numpy import ndarray

from bullet_lab.core.parameters import integer, number
from bullet_lab.drive import OPEN_LOOP_RATE, Square
from bullet_lab.noise.odometry_noise import MIN_TRANSLATION
from bullet_lab.noise.published_noise import (
    ALL,
    NONE,
    PUBLISHED_RATE,
    Defects,
    combinations,
    noisy_paths,
    sampled,
)
from bullet_lab.simulation.world.resources import package_share
from bullet_lab.studies.published_noise.figures import (
    compare_figure,
    corners_figure,
    defects_figure,
    first_turns_figure,
    lengths_figure,
)
from bullet_lab.studies.published_noise.results import (
    LENGTHS,
    SIDES,
    PublishedFigure,
    PValue,
    Result,
    combination_records,
    drawn,
    find_corners,
    length_records,
    measure,
    nearest,
    published_summary,
    ranked,
    read_published_figure,
    rounded,
    verdict_lines,
)
from bullet_lab.studies.squares import SquareDrive, drive_square
from bullet_lab.studies.study import (
    MOST_SEED,
    Settings,
    Summary,
    Tell,
    progress,
    run_from,
    write_results,
)

FIGURE_DATA = "data/fig1_paths.csv"
# Long enough for the sampling node to poll before and after the drive, with any phase.
REST_SECONDS = 2.0 / PUBLISHED_RATE + 0.1

LARGEST_STD = 1.0
FEWEST_SEEDS, MOST_SEEDS = 20, 20000
_SEEDS_AT_A_TIME = 500
# Not more than `FEWEST_SEEDS`.
_EXAMPLES = 12


@dataclass(frozen=True)
class PublishedNoiseSettings(Settings):
    """Noise and number of paths; the std of figure 1b is 0.1."""

    std: float = number(
        0.1, "standard deviation of the noise per metre and per radian", 0.0, maximum=LARGEST_STD
    )
    seeds: int = integer(2000, "noisy paths for each combination", FEWEST_SEEDS, MOST_SEEDS)
    reading: float = number(
        2e-4, "standard deviation with which x and y are read from a figure, m", 0.0, maximum=0.1
    )
    seed: int = integer(
        1, "seed of the first noisy path; the others have those that follow", 0, MOST_SEED
    )


def replay_drive() -> SquareDrive:
    """Simulate the drive of figure 1a, with a rest before and after it; raises LabError."""
    return drive_square(Square(sides=SIDES), rest=REST_SECONDS)


class Replay:
    """Noisy paths of the drive. Path k has the draws of a live node with the seed `seed` + k.

    Attributes:
        corners: of the perfect path, as drawn (m), shape (5, 2).
    """

    def __init__(self, drive: SquareDrive, settings: PublishedNoiseSettings):
        self.drive = drive
        self._settings = settings
        # The phase at which the node of figure 1b polled is unknown.
        phases = np.random.default_rng([settings.seed, 1]).uniform(size=settings.seeds)
        self._messages = sampled(drive.stamps, PUBLISHED_RATE, phases / PUBLISHED_RATE)
        perfect = drawn(drive.poses[:, :2])
        self.corners = perfect[find_corners(perfect)]

    def lengths(self, defects: Defects, paths: Sequence[int]) -> ndarray:
        """Return the `LENGTHS` (m) read from the drawings of m paths, shape (m, 6)."""
        noisy = self.noisy(defects, paths)[..., :2]
        return np.array([self._read(noisy[:, k], path) for k, path in enumerate(paths)])

    def _read(self, points: ndarray, path: int) -> ndarray:
        # The errors of reading the perfect path's corners do not depend on the defects.
        errors = np.random.default_rng([self._settings.seed, 2, path])
        corners, vertices = (
            true + self._settings.reading * errors.standard_normal(true.shape)
            for true in (self.corners, drawn(points))
        )
        return measure(vertices, corners)

    def noisy(self, defects: Defects, paths: Sequence[int]) -> ndarray:
        """Return noisy poses, shape (n, m, 3), of the m paths with these numbers."""
        poses = self.drive.poses[self.messages(defects, paths)]
        generators = [np.random.default_rng(self._settings.seed + int(path)) for path in paths]
        draws = np.stack([g.standard_normal((len(poses) - 1, 3)) for g in generators], axis=1)
        return noisy_paths(poses, draws, self._settings.std, defects)

    def messages(self, defects: Defects, paths: Sequence[int]) -> ndarray:
        """Return the indices of the perfect poses that the algorithm sees, (n, m) or (n, 1)."""
        if defects.sampled:
            return self._messages[:, paths]
        return np.arange(len(self.drive.steps))[:, np.newaxis]


def run_published_noise(
    folder: Path, settings: PublishedNoiseSettings, tell: Tell = print
) -> Summary:
    """Run the study; write figures, tables and summary.json; return the summary.

    The same settings give the same files. Raises LabError if the folder cannot be written to, or
    files of the package are missing.
    """
    figure = read_published_figure(package_share() / FIGURE_DATA)
    replay = Replay(replay_drive(), settings)
    results = ranked(_results(replay, figure, settings, tell))
    records, facts = combination_records(results), _figure_facts(figure, replay.drive)
    summary = published_summary(asdict(settings), facts, results, records)
    tables = {
        "combinations.csv": records,
        "lengths.csv": length_records(results, settings.seed),
    }
    figures = _figures(replay, figure, results, settings)
    return write_results(folder, summary, tables, figures, {})


def _results(
    replay: Replay, figure: PublishedFigure, settings: PublishedNoiseSettings, tell: Tell
) -> list[Result]:
    starts = range(0, settings.seeds, _SEEDS_AT_A_TIME)
    blocks = [range(start, min(start + _SEEDS_AT_A_TIME, settings.seeds)) for start in starts]
    # With aliasing, `unbent` changes nothing, to the last bit.
    every = [d for d in combinations() if not (d.aliasing and d.unbent)]
    todo = [(defects, block) for defects in every for block in blocks]
    lengths: dict[Defects, list[ndarray]] = {defects: [] for defects in every}
    for defects, block in progress(todo, "blocks", len(todo), tell):
        lengths[defects].append(replay.lengths(defects, block))
    results = [
        Result.of(defects, np.concatenate(parts), figure.lengths)
        for defects, parts in lengths.items()
    ]
    aliased = [result for result in results if result.defects.aliasing]
    return [*results, *(replace(r, defects=replace(r.defects, unbent=True)) for r in aliased)]


def _figure_facts(figure: PublishedFigure, drive: SquareDrive) -> Summary:
    simulated, shown = (
        float(np.hypot(*(corners[3] - corners[2])))
        for corners in (drive.corners, figure.perfect_corners)
    )
    speed = simulated * OPEN_LOOP_RATE / Square().side_commands
    return {
        "lengths_m": dict(zip(LENGTHS, rounded(figure.lengths))),
        "third_side_steps": figure.third_side_steps,
        "sampling_rate_hz": round(speed * figure.third_side_steps / shown, 3),
    }


def _figures(
    replay: Replay,
    figure: PublishedFigure,
    results: list[Result],
    settings: PublishedNoiseSettings,
) -> Summary:
    drive, corners = replay.drive, replay.corners
    by_defects = {result.defects: result for result in results}
    example = nearest(figure.lengths, by_defects[ALL].lengths)

    def examples(defects: Defects) -> ndarray:
        return replay.noisy(defects, range(_EXAMPLES))[..., :2]

    def shown(defects: Defects) -> tuple[ndarray, PValue]:
        return examples(defects), by_defects[defects].p_values["all"]

    moved = np.hypot(*np.diff(drive.poses[:, :2], axis=0, prepend=np.nan).T)
    third = drive.stamps[(drive.sides == 2) & (moved > MIN_TRANSLATION)]
    turns = {}
    for defects in (ALL, replace(ALL, unwrapped=False)):
        seen = replay.messages(defects, [example])[:, 0]
        noisy = replay.noisy(defects, [example])[:, 0]
        turns[defects] = drive.stamps[seen], drive.poses[seen], noisy
    replays = [replay.noisy(defects, [example])[:, 0, :2] for defects in (ALL, NONE)]
    aliasing = {
        "as published": examples(ALL),
        "all but aliasing": examples(replace(ALL, aliasing=False)),
    }
    best, std = results[0].defects, settings.std
    return {
        "compare.png": compare_figure(figure, corners, replays, settings.seed + example),
        "corners.png": corners_figure(figure, corners, aliasing),
        "defects.png": defects_figure(figure, corners, shown, best, std),
        "first_turns.png": first_turns_figure(turns, (third[0], third[-1])),
        "lengths.png": lengths_figure(results, figure.lengths),
    }


def _run(folder: Path, settings: PublishedNoiseSettings, tell: Tell) -> None:
    # A table, without the program's name in front of its lines.
    print("\n".join(verdict_lines(run_published_noise(folder, settings, tell))))


main = functools.partial(run_from, "published_noise", __doc__, (PublishedNoiseSettings,), _run)
