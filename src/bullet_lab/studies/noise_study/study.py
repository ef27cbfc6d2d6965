"""Statistics of thousands of noisy versions of a path, at several levels of noise, without ROS.

Example:
    bullet_lab noise_study paths:=10000
    bullet_lab noise_study path:=odom.tum levels:="0.05 0.1"
"""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Sequence

import numpy as np
from matplotlib.figure import Figure

from bullet_lab.core.parameters import choices, integer, number, numbers, text
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.drive import Square
from bullet_lab.noise.noisy_paths import study_generator
from bullet_lab.noise.odometry_noise import MODELS
from bullet_lab.studies.noise_study.figures import (
    banana_figure,
    distance_figure,
    distances_figure,
    levels_figure,
    rates_figure,
    regions_figure,
)
from bullet_lab.studies.noise_study.regions import MEANT, METHODS, right_up_to
from bullet_lab.studies.noise_study.statistics import (
    Case,
    by_model_of,
    find_laps,
    noisy_levels,
    study_case,
)
from bullet_lab.studies.paths import check_path, read_path, resample, tum_text
from bullet_lab.studies.squares import drive_square
from bullet_lab.studies.study import (
    MOST_SEED,
    Record,
    Settings,
    Summary,
    Tell,
    run_from,
    write_results,
)

LARGEST_STD = 10.0
"""At this level the heading is random after some centimetres."""

MOST_PATHS = 10_000_000
SIDES_PER_LAP = 4
_DISTANCES_PER_CASE = 100

STUDIED = ("report", "rate_invariant", "probabilistic")
"""Models by default."""


@dataclass(frozen=True)
class StudySettings(Settings):
    """Noise and number of paths; a level is std, per metre and per radian.

    For the rate-invariant model it is per square root of them.
    """

    levels: tuple[float, ...] = numbers(
        (0.0, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5),
        "levels of noise, values of std",
        0.0,
        maximum=LARGEST_STD,
    )
    models: tuple[str, ...] = choices(STUDIED, "rules that scale the noise", MODELS)
    rates: tuple[float, ...] = numbers((0.9, 5.0, 20.0), "message rates, Hz", above=0.0)
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
    """Return the odometry of the report's square from the simulation, at 20 Hz."""
    drive = drive_square(Square(sides=SIDES_PER_LAP * laps), rest=0.0)
    return Trajectory(drive.stamps, drive.poses)


def study(trajectory: Trajectory, settings: StudySettings, tell: Tell = print) -> list[Case]:
    """Return a case for each model, rate and level, in this order, without writing files.

    Raises LabError if the path is not usable, or a setting does not suit it.
    """
    check_path(trajectory)
    cases: list[Case] = []
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
    """Describe the level up to which each method's 95 % region is right at the end of the path."""
    noisy = noisy_levels(cases)
    levels = [case.std for case in noisy]
    limits = []
    for method, title in METHODS.items():
        limit = right_up_to(levels, [case.regions.found[method][-1] for case in noisy])
        if limit is not None:
            limits.append(f"{title} {f'up to {limit:g}' if limit else 'nowhere'}")
    return f"95 % regions are right at the end: {', '.join(limits)}" if limits else "no regions"


def run_study(
    folder: Path,
    settings: StudySettings,
    trajectory: Trajectory,
    source: str,
    tell: Tell,
) -> Summary:
    """Study a path; write tables, figures, TUM files and summary.json; return the summary.

    The source names the origin of the path. Raises LabError if the path is not usable, a setting
    does not suit it, or the folder cannot be written to.
    """
    cases = study(trajectory, settings, tell)
    records = case_records(cases)
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
            "laps": len(find_laps(cases[0].trajectory)[0]),
        },
        "cases": records,
    }
    tables = {
        "metrics.csv": records,
        "error_by_distance.csv": distance_records(cases),
        "regions.csv": [{**c.key, **record} for c in cases for record in c.regions.records()],
        "where_right.csv": where_right_records(cases),
    }
    fastest = [case for case in cases if case.rate == max(settings.rates)]
    # The first noisy path of each model and level, and the perfect one.
    perfect = fastest[0].trajectory
    noisy = {
        f"tum/{c.model}_std_{c.std:g}.tum": Trajectory(perfect.stamps, c.kept[0]) for c in fastest
    }
    paths = {**noisy, "tum/perfect.tum": perfect}
    texts = {name: tum_text(path) for name, path in paths.items()}
    figures = _figures(cases, fastest, trajectory, settings.seed)
    return write_results(folder, summary, tables, figures, texts)


def case_records(cases: Sequence[Case]) -> list[Record]:
    """Return a record of each case: metrics, coverage, NEES, errors of first order."""
    # At a low rate a lap may be missing.
    fullest = max((case.metrics for case in cases), key=len)
    records = []
    for case in cases:
        known, published = case.theory, case.regions.found["published"][-1]
        records.append(
            {
                **case.key,
                "paths": case.regions.paths,
                **{name: case.metrics.get(name) for name in fullest},
                **{f"coverage_{name}": share for name, share in case.coverage.items()},
                "nees_mean": published and published.nees,
                "nees_within_95": published and published.coverage[MEANT],
                "mean_missed_by_std": known.shift(),
                "area_over_exact": known.area_ratio(),
                "quadratic_share": known.quadratic_share(),
                "gaussian_enough": known.gaussian_enough(),
            }
        )
    return records


def distance_records(cases: Sequence[Case]) -> list[Record]:
    """Return records with the rms distance from the perfect path, sampled and exact."""
    records = []
    for case in cases:
        columns = {
            "travelled_m": case.trajectory.travelled(),
            "sample_rms_m": case.rms_distance,
            "exact_rms_m": case.theory.exact.rms_distance(),
            "first_order_rms_m": case.theory.first_order.rms_distance(),
        }
        last = len(case.trajectory) - 1
        places = np.linspace(0, last, min(_DISTANCES_PER_CASE, last + 1)).round().astype(int)
        for index in np.unique(places):
            own = {name: float(column[index]) for name, column in columns.items()}
            records.append({**case.key, **own})
    return records


def where_right_records(cases: Sequence[Case]) -> list[Record]:
    """Return a record for each case: the distance (m) up to which 95 % regions are right.

    A region is right as long as the band around its share overlaps 95 ± 1 %. None: it has no
    volume.
    """
    return [
        {
            **case.key,
            "length_m": case.trajectory.length(),
            "quadratic_share": case.theory.quadratic_share(),
            **{f"{name}_right_until_m": case.regions.right_until(name) for name in METHODS},
        }
        for case in cases
    ]


def _figures(
    cases: Sequence[Case], fastest: Sequence[Case], trajectory: Trajectory, seed: int
) -> dict[str, Figure]:
    figures = {
        f"levels_{model}.png": levels_figure(of_model)
        for model, of_model in by_model_of(fastest).items()
    }
    figures["error_by_distance.png"] = distance_figure(fastest)
    figures["message_rate.png"] = rates_figure(cases, trajectory)
    figures["regions.png"] = regions_figure(fastest)
    figures["regions_by_distance.png"] = distances_figure(fastest)
    if any(case.std > 0.0 for case in fastest):
        figures["banana.png"] = banana_figure(fastest, seed)
    return figures


def _run(folder: Path, settings: StudySettings, perfect: PathSettings, tell: Tell) -> None:
    if perfect.path:
        source = str(Path(perfect.base) / perfect.path)
        trajectory = read_path(Path(source), perfect.topic)
        if trajectory.remark:
            tell(f"{source}: {trajectory.remark}")
    else:
        source = "the report's square, simulated"
        trajectory = simulated_square(perfect.laps)
    run_study(folder, settings, trajectory, source, tell)


main = functools.partial(run_from, "noise_study", __doc__, (StudySettings, PathSettings), _run)
