"""What the study leaves behind."""

import re

import numpy as np
import pytest
from study_runs import run_main, summary_of

from bullet_lab.core.trajectory import Trajectory, read_tum
from bullet_lab.studies.noise_study.figures import (
    banana_figure,
    distances_figure,
    regions_figure,
)
from bullet_lab.studies.noise_study.study import (
    StudySettings,
    case_records,
    main,
    simulated_square,
    study,
    where_right_records,
)
from bullet_lab.studies.paths import tum_text

WORDS = "--path bend.tum --levels 0 0.1 --models report rate_invariant --rates 0.9 5 --paths 20"
TABLES = "metrics", "regions", "where_right", "error_by_distance"


def bend():
    """Two sides of 3 m with an arc between, at 10 Hz."""
    heading = np.concatenate([np.zeros(30), np.linspace(0.0, 1.5, 20), np.full(30, 1.5)])
    steps = 0.1 * np.exp(1j * heading)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    poses = np.column_stack([way.real, way.imag, np.concatenate([heading, [1.5]])])
    return Trajectory(0.1 * np.arange(len(way)), poses)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Folder, summary and lines of a study from the command line."""
    folder, base = (tmp_path_factory.mktemp(name) for name in ("study", "in"))
    (base / "bend.tum").write_text(tum_text(bend()))
    status, said, _ = run_main(main, folder, "--base", base, *WORDS.split(), "--seed", "3")
    assert status == 0
    summary = summary_of(folder)
    assert summary["path"]["source"] == str(base / "bend.tum")
    return folder, summary, said.splitlines()


def test_files_and_tables_are_as_before(results, as_before):
    folder, _, said = results
    told = [re.sub(r" [\d.]+ s;", "", line) for line in said]
    told += sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))
    for name in TABLES:
        told += (folder / f"{name}.csv").read_text().replace(",", " ").splitlines()[::3]
    for path in sorted(folder.rglob("*.tum")):
        told += path.read_text().splitlines()[::40]
    as_before(told, "results.txt")


def test_metrics_of_a_lap_that_a_low_rate_does_not_see():
    # The heading goes round once and half back again, in a second.
    heading = np.concatenate([np.linspace(0.0, 6.4, 60), np.linspace(6.4, 3.2, 30)])
    stamps = np.arange(90) / 90.0
    poses = np.column_stack([3.0 * stamps, 0.0 * stamps, heading])
    settings = StudySettings(
        levels=(0.1,), models=("report",), rates=(2.0, 90.0), paths=10, delta=1.5
    )
    cases = study(Trajectory(stamps, poses), settings)
    low, high = case_records(cases)
    assert low["closure_error_lap_1_m_mean"] is None
    assert high["closure_error_lap_1_m_mean"] > 0.0


@pytest.fixture(scope="module")
def alone(results):
    settings = StudySettings(levels=(0.1,), models=("report",), rates=(5.0,), paths=20, seed=3)
    (case,) = study(read_tum(results[0] / "tum" / "perfect.tum"), settings)
    return case


def test_a_case_does_not_depend_on_what_else_is_studied(results, alone):
    key = ("report", 5.0, 0.1)
    (same,) = [c for c in results[1]["cases"] if (c["model"], c["rate_hz"], c["std"]) == key]
    # The path has been rounded to the digits of its file.
    (record,) = case_records([alone])
    assert record == pytest.approx(same)


def test_where_regions_have_no_volume_there_are_figures_too(alone):
    for draw in (regions_figure, distances_figure):
        assert draw([alone]).axes
    assert banana_figure([alone], 3).axes


def test_the_table_says_how_far_each_method_is_right():
    ahead = 0.1 * np.arange(41.0)
    line = Trajectory(ahead, np.column_stack([ahead, 0.0 * ahead, 0.0 * ahead]))
    settings = StudySettings(levels=(0.5,), models=("rate_invariant",), rates=(10.0,), paths=4000)
    (values,) = where_right_records(study(line, settings))
    assert values["first_order_right_until_m"] == 0.0
    assert values["length_m"] == pytest.approx(4.0)


def test_the_simulated_square():
    trajectory = simulated_square()
    assert trajectory.length() == pytest.approx(7.6, abs=0.1)
    assert 1.0 / np.diff(trajectory.stamps).mean() == pytest.approx(1000.0 / 51, rel=0.01)
    (case,) = study(
        trajectory, StudySettings(levels=(0.1,), models=("report",), rates=(20.0,), paths=10)
    )
    assert sum(name.startswith("closure_error_lap") for name in case.metrics) == 3
    assert np.hypot(*(trajectory.poses[-1] - trajectory.poses[0])[:2]) < 0.1
