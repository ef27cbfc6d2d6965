"""Thousands of noisy versions of one path, at every level of noise, without ROS.

Example:
    python3 -m bullet_lab.studies.noise_study.study results/noise_study --paths 10000
    python3 -m bullet_lab.studies.noise_study.study results/mine --path odom.tum --levels 0.05 0.1
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Iterator, List, NoReturn, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.figures import save
from bullet_lab.core.files import make_folder, write_json
from bullet_lab.core.parameters import choices, integer, number, numbers, text
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.drive.square import Square
from bullet_lab.noise.noisy_paths import study_generator
from bullet_lab.noise.odometry_noise import MODELS
from bullet_lab.studies.noise_study.figures import (
    coverage_figure,
    distance_figure,
    levels_figure,
    rates_figure,
)
from bullet_lab.studies.noise_study.paths import check_path, read_path, resample, write_tum
from bullet_lab.studies.noise_study.region_figures import (
    banana_figure,
    distances_figure,
    regions_figure,
)
from bullet_lab.studies.noise_study.regions import HEADER, MEANT, METHODS
from bullet_lab.studies.noise_study.statistics import Case, study_case
from bullet_lab.studies.squares import drive_square
from bullet_lab.studies.study import (
    MOST_SEED,
    SUMMARY,
    Settings,
    Tell,
    run_from,
    silent,
    whole_results,
    write_table,
)

LARGEST_STD = 10.0
"""At this level a robot has lost its heading after some centimetres."""

MOST_PATHS = 10_000_000
KEPT_PATHS = 60
SIDES_PER_LAP = 4
_DISTANCES_PER_CASE = 100


@dataclass(frozen=True)
class StudySettings(Settings):
    """What is studied; a level is std, per metre and per radian (per roots: rate_invariant)."""

    levels: Tuple[float, ...] = numbers(
        (0.0, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5),
        "levels of noise, values of std",
        0.0,
        maximum=LARGEST_STD,
    )
    models: Tuple[str, ...] = choices(tuple(MODELS), "rules that scale the noise", MODELS)
    rates: Tuple[float, ...] = numbers((0.9, 5.0, 20.0), "message rates, Hz", above=0.0)
    paths: int = integer(3000, "noisy paths for each level, model and rate", 2, MOST_PATHS)
    seed: int = integer(1, "seed of all that is random", 0, MOST_SEED)
    delta: float = number(
        1.0, "distance over which relative errors and drift are measured, m", above=0.0
    )


@dataclass(frozen=True)
class PathSettings:
    """The perfect path."""

    path: str = text("", "TUM, CSV or bag file; else the simulated square")
    topic: str = text("/odom", "odometry topic of a bag")
    base: str = text("", "folder that a relative path starts from")
    laps: int = integer(1, "times round the simulated square", 1)


def simulated_square(laps: int = 1) -> Trajectory:
    """Return the odometry of the square that the report drives, from the simulation, at 20 Hz."""
    drive = drive_square(Square(sides=SIDES_PER_LAP * laps), rest=0.0)
    return Trajectory(drive.stamps, drive.poses)


def study(trajectory: Trajectory, settings: StudySettings, tell: Tell = silent) -> List[Case]:
    """Study every level, model and rate on a path; nothing is written.

    Returns:
        A case for each, by model, then rate, then level, in the order of the settings.

    Raises:
        LabError: a path or a setting that makes no sense.
    """
    check_path(trajectory)
    cases: List[Case] = []
    for model in settings.models:
        for rate in settings.rates:
            start = time.monotonic()
            at_rate = resample(trajectory, rate)
            cases += [
                study_case(
                    at_rate,
                    (model, std, rate),
                    study_generator(settings.seed, model, std, rate),
                    settings.paths,
                    settings.delta,
                    KEPT_PATHS,
                )
                for std in settings.levels
            ]
            seconds = time.monotonic() - start
            tell(
                f"{model} at {rate:g} Hz: {len(settings.levels)} levels, {settings.paths} paths "
                f"of {len(at_rate)} messages each, {seconds:.1f} s; "
                f"{_verdict(cases[-len(settings.levels) :])}"
            )
    return cases


def _verdict(cases: Sequence[Case]) -> str:
    """Say in words up to which level each method's 95 % region is right at the end of the path."""
    noisy = sorted((case for case in cases if case.std > 0.0), key=lambda case: case.std)
    said = []
    for method, title in METHODS.items():
        regions = [(case.std, case.sample.regions.found[method][-1]) for case in noisy]
        known = [(std, region) for std, region in regions if region is not None]
        wrong = [number for number, (_, region) in enumerate(known) if region.wrong()]
        if known:
            last = known[-1 if not wrong else wrong[0] - 1][0]
            said.append(f"{title} {'nowhere' if wrong[:1] == [0] else f'up to {last:g}'}")
    if not said:
        return "no regions"
    return f"95 % regions are right at the end: {', '.join(said)}"


def run_study(
    folder: Path,
    settings: StudySettings,
    trajectory: Trajectory,
    source: str = "",
    tell: Tell = silent,
) -> Dict[str, Any]:
    """Study a path, leave tables, pictures, TUM files and summary.json, and return what that says.

    The same settings and path give the same tables. Nothing is written before all is computed.
    The source says where the path is from.

    Raises:
        LabError: a path or a setting that makes no sense, or a folder that cannot be written to.
    """
    cases = study(trajectory, settings, tell)
    summary = {
        "job": "noise_study",
        "seed": settings.seed,
        "paths": settings.paths,
        "levels": list(settings.levels),
        "models": list(settings.models),
        "rates_hz": list(settings.rates),
        "delta_m": settings.delta,
        "path": {
            "source": source,
            "poses": len(trajectory),
            "length_m": trajectory.length(),
            "duration_s": float(trajectory.stamps[-1] - trajectory.stamps[0]),
            "laps": len(cases[0].perfect_closure),
        },
        "cases": [case.summary() for case in cases],
    }
    with whole_results(folder) as part:
        write_json(part / SUMMARY, summary)
        write_table(part / "metrics.csv", metrics_rows(cases))
        write_table(part / "error_by_distance.csv", distance_rows(cases))
        write_table(part / "regions.csv", region_rows(cases))
        write_table(part / "where_right.csv", where_right_rows(cases))
        _write_tum_files(part / "tum", cases, max(settings.rates))
        _draw(part, cases, trajectory, settings)
    return summary


def metrics_rows(cases: Sequence[Case]) -> List[List[Any]]:
    """Return a header and a row for each case: metrics, coverage, NEES, how far off first order."""
    # At a low rate a lap may be missing.
    fullest = max((case.sample.metrics for case in cases), key=len)
    metrics = [(name, part) for name, parts in fullest.items() for part in parts]
    header = [
        *("model", "rate_hz", "std", "paths", *(f"{name}_{part}" for name, part in metrics)),
        *("coverage_first_order", "coverage_exact", "coverage_published"),
        *("nees_mean", "nees_within_95", "mean_missed_by_std", "area_over_exact"),
        *("quadratic_share", "gaussian_enough"),
    ]
    rows: List[List[Any]] = [header]
    for case in cases:
        sample, known = case.sample, case.theory
        published = sample.regions.found["published"][-1]
        rows.append(
            [
                *(case.model, case.rate, case.std, sample.paths),
                *(sample.metrics.get(name, {}).get(part) for name, part in metrics),
                *(sample.coverage[name] for name in ("first_order", "exact", "published")),
                *((published.nees, published.coverage[MEANT]) if published else (None, None)),
                *(known.shift(), known.area_ratio(), known.quadratic_share()),
                str(known.gaussian_enough()).lower(),
            ]
        )
    return rows


def distance_rows(cases: Sequence[Case]) -> Iterator[List[Any]]:
    """Yield a header and rows with the rms distance from the perfect path, sampled and exact."""
    names = ("travelled_m", "sample_rms_m", "exact_rms_m", "first_order_rms_m")
    yield ["model", "rate_hz", "std", *names]
    for case in cases:
        travelled, theory = case.trajectory.travelled(), case.theory
        moments = (theory.exact, theory.first_order)
        columns = (travelled, case.sample.rms_distance, *(m.rms_distance() for m in moments))
        count = min(_DISTANCES_PER_CASE, len(travelled))
        for index in np.unique(np.linspace(0, len(travelled) - 1, count).round().astype(int)):
            yield [case.model, case.rate, case.std, *(float(column[index]) for column in columns)]


def region_rows(cases: Sequence[Case]) -> Iterator[List[Any]]:
    """Yield a header and rows with the regions of each case, method and pose; see `Regions`."""
    yield ["model", "rate_hz", "std", *HEADER]
    for case in cases:
        yield from ([case.model, case.rate, case.std, *row] for row in case.sample.regions.rows())


def where_right_rows(cases: Sequence[Case]) -> Iterator[List[Any]]:
    """Yield a header and a row for each case: how far, in m, the 95 % region of a method is right.

    It is right as long as the band around its share overlaps 95 ± 1 %. None: it has no volume.
    """
    yield [
        *("model", "rate_hz", "std", "length_m", "quadratic_share"),
        *(f"{method}_right_until_m" for method in METHODS),
    ]
    for case in cases:
        until = (case.sample.regions.right_until(method) for method in METHODS)
        length, share = case.trajectory.length(), case.theory.quadratic_share()
        yield [case.model, case.rate, case.std, length, share, *until]


def _write_tum_files(folder: Path, cases: Sequence[Case], rate: float) -> None:
    """Write the first noisy path of each model and level at a rate, and the perfect one."""
    folder.mkdir()
    for case in cases:
        if case.rate == rate:
            write_tum(folder / "perfect.tum", case.trajectory)
            write_tum(folder / f"{case.model}_std_{case.std:g}.tum", case.kept_path(0))


def _draw(
    folder: Path, cases: Sequence[Case], trajectory: Trajectory, settings: StudySettings
) -> None:
    fastest = [case for case in cases if case.rate == max(settings.rates)]
    for model in settings.models:
        of_model = [case for case in fastest if case.model == model]
        save(levels_figure(of_model), folder / f"levels_{model}.png")
    save(distance_figure(fastest), folder / "error_by_distance.png")
    save(rates_figure(cases, trajectory), folder / "message_rate.png")
    save(coverage_figure(cases), folder / "coverage.png")
    save(regions_figure(fastest), folder / "regions.png")
    save(distances_figure(fastest), folder / "regions_by_distance.png")
    if any(case.std > 0.0 for case in fastest):
        save(banana_figure(fastest, settings.seed), folder / "banana.png")


def _run(folder: Path, settings: StudySettings, perfect: PathSettings, tell: Tell) -> None:
    if perfect.path:
        source = str(Path(perfect.base) / perfect.path)
        trajectory = read_path(Path(source), perfect.topic)
    else:
        source = "the report's square, simulated"
        trajectory = simulated_square(perfect.laps)
    # Better known now than after the work.
    make_folder(folder)
    run_study(folder, settings, trajectory, source, tell)


def main(words: Optional[Sequence[str]] = None) -> NoReturn:
    """Run the study from the command line; see `run_from`."""
    run_from("noise_study", __doc__, (StudySettings, PathSettings), _run, words)


if __name__ == "__main__":
    main()
