"""What the study leaves behind."""

import numpy as np
import pytest
from study_runs import csv_rows, run_main, summary_of

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
FILES = {
    "banana.png",
    "error_by_distance.csv",
    "error_by_distance.png",
    "levels_rate_invariant.png",
    "levels_report.png",
    "message_rate.png",
    "metrics.csv",
    "perfect.tum",
    "rate_invariant_std_0.1.tum",
    "rate_invariant_std_0.tum",
    "report_std_0.1.tum",
    "regions.csv",
    "regions.png",
    "regions_by_distance.png",
    "report_std_0.tum",
    "summary.json",
    "where_right.csv",
}


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


def test_all_files_are_there_and_nothing_else(results):
    folder, _, lines = results
    assert {path.name for path in folder.rglob("*") if path.is_file()} == FILES
    assert {path.name for path in folder.iterdir() if path.is_dir()} == {"tum"}
    assert len(lines) == 4
    assert "report at 5 Hz: 2 levels, 20 paths of 41 messages" in lines[1]
    for path in folder.glob("*.png"):
        assert path.read_bytes().startswith(b"\x89PNG")


def test_summary_and_metrics_hold_each_level_model_and_rate(results):
    folder, summary, _ = results
    assert (summary["seed"], summary["paths"]) == (3, 20)
    cases, rows = summary["cases"], csv_rows(folder / "metrics.csv")
    assert len({(case["model"], case["rate_hz"], case["std"]) for case in cases}) == 8
    assert len(cases) == len(rows) == 8
    for row, case in zip(rows, cases):
        assert (case["nees_mean"] is None) == (case["std"] == 0.0)
        assert (row["model"], float(row["std"])) == (case["model"], case["std"])
        assert float(row["drift_percent_p95"]) == case["drift_percent_p95"]
        assert None not in row.values()


def test_metrics_of_a_lap_that_a_low_rate_does_not_see():
    # The heading goes round once and half back again, in a second.
    heading = np.concatenate([np.linspace(0.0, 6.4, 60), np.linspace(6.4, 3.2, 30)])
    stamps = np.arange(90) / 90.0
    poses = np.column_stack([3.0 * stamps, 0.0 * stamps, heading])
    settings = StudySettings(
        levels=(0.1,), models=("report",), rates=(2.0, 90.0), paths=10, delta=1.5
    )
    cases = study(Trajectory(stamps, poses), settings)
    assert [len(case.perfect_closure) for case in cases] == [0, 1]
    low, high = case_records(cases)
    assert low["closure_error_lap_1_m_mean"] is None
    assert high["closure_error_lap_1_m_mean"] > 0.0


def test_error_by_distance_ends_with_the_path(results):
    rows = [row for row in csv_rows(results[0] / "error_by_distance.csv") if row["std"] == "0.1"]
    ends = [row for row in rows if float(row["travelled_m"]) == pytest.approx(8.0, abs=0.05)]
    assert len({(row["model"], row["rate_hz"]) for row in ends}) == 4
    for row in ends:
        assert float(row["sample_rms_m"]) == pytest.approx(float(row["exact_rms_m"]), rel=0.6)


def test_tum_files_share_their_stamps(results):
    folder, _, _ = results
    perfect = read_tum(folder / "tum" / "perfect.tum")
    noisy = read_tum(folder / "tum" / "report_std_0.1.tum")
    np.testing.assert_array_equal(perfect.stamps, noisy.stamps)
    clean = read_tum(folder / "tum" / "report_std_0.tum")
    np.testing.assert_allclose(clean.poses, perfect.poses, atol=1e-12)


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
    assert len(case.perfect_closure) == 1
    assert case.perfect_closure[0] < 0.1
