"""The job calibrate: its files, its words, and what it refuses."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from shared import cases, refuses
from study_runs import names_in, run_main, summary_of

from bullet_lab.core import se2
from bullet_lab.core.parameters import part_of, read_parameters
from bullet_lab.core.trajectory import CSV_HEADER
from bullet_lab.noise.odometry_noise import ProbabilisticRule, rule_of
from bullet_lab.noise.systematic import (
    SYSTEMATIC,
    SystematicErrors,
    SystematicSpread,
    path_of,
)
from bullet_lab.studies.calibrate import study
from bullet_lab.studies.calibrate.steps import StepSettings, take_steps
from bullet_lab.studies.calibrate.study import (
    DriveSettings,
    calibration_drive,
    coverage,
    made_up,
)

SETTINGS = study.CalibrateSettings(("rate_invariant", "probabilistic"))
LAP = DriveSettings(laps=1)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder, said = tmp_path_factory.mktemp("calibrate"), []
    summary = study.run_calibration(folder, SETTINGS, StepSettings(), LAP, (), said.append)
    return folder, summary, "\n".join(said)


def test_it_leaves_its_files_and_says_what_they_say(done):
    folder, summary, said = done
    assert names_in(folder) == {
        *("noise.yaml", "noise_probabilistic.yaml", "noise_rate_invariant.yaml"),
        *("paths.png", "profiles.png", "residuals.png", "summary.json"),
    }
    assert summary_of(folder) == json.loads(json.dumps(summary))
    for words in (
        *("alpha1 (α1)", "rotation from rotation", "windows of 1 m"),
        *("rate_invariant: predicts worse", "it does NOT fit"),
    ):
        assert words in said


def test_the_made_up_drive_is_recovered(done):
    summary = done[1]
    best, other = summary["models"]
    assert summary["best"] == best["model"] == "probabilistic"
    assert best["goodness"]["fits"] and not other["goodness"]["fits"]
    assert best["prediction"]["density"] > other["prediction"]["density"]
    assert best["step_length"] == (0.0, 0.0) and other["step_length"] != (0.0, 0.0)
    settings = DriveSettings()
    known = {**settings.noise(), **{name: getattr(settings, name) for name in SYSTEMATIC}}
    assert set(best["parameters"]) == set(known)
    outside = 0
    for name, found in best["parameters"].items():
        low, high = found["interval_95"]
        assert low < found["estimate"] < high
        outside += not low <= known[name] <= high
    # Of 8 intervals at 95 %; more than 2 outside have a probability of 0.6 %.
    assert outside <= 2
    assert rule_of("probabilistic", settings.noise()) == ProbabilisticRule()


def test_noisy_odom_loads_the_noise(done):
    rosparam = pytest.importorskip("rosparam")
    pytest.importorskip("bullet_lab.srv")
    from bullet_lab.ros.nodes.noisy_odom import NoisyOdomParameters

    folder, summary, _ = done
    for entry in summary["models"]:
        # What both `rosparam load` and roslaunch read files with.
        ((given, _),) = rosparam.load_file(str(folder / f"noise_{entry['model']}.yaml"))
        values = {f"~{name}": value for name, value in given.items()}
        found = read_parameters(NoisyOdomParameters, values.get, given)
        rule = rule_of(found.model, asdict(found))
        assert rule.name == entry["model"]
        parts = (rule, *(part_of(kind, found) for kind in (SystematicErrors, SystematicSpread)))
        said = {name: value for part in parts for name, value in asdict(part).items()}
        assert set(entry["published"]) < set(said)
        published = {"wheel_base": 0.38, "ticks_per_metre": 0.0, **entry["published"]}
        assert said == pytest.approx(published, rel=1e-8)


@pytest.fixture
def calibrated(tmp_path):
    """Runs the job on a table with a lap; the odometry's steps are scaled."""

    def run(*words, rows=None, scale=(1.0, 1.0, 1.0)):
        recording = made_up(LAP, 3)
        odometry = path_of(se2.steps(recording.odometry.poses) * scale)
        truth = recording.truth
        table = np.column_stack((truth.stamps, truth.poses, odometry))[:rows]
        np.savetxt(
            tmp_path / "paths.csv", table, delimiter=",", header=CSV_HEADER, comments=""
        )
        words = (tmp_path / "out", "--base", tmp_path, "--data", "paths.csv", *words)
        return (*run_main(study.main, *words), tmp_path / "out")

    return run


def test_it_runs_from_the_command_line_on_files(calibrated):
    status, _, err, out = calibrated("--models", "probabilistic", "--systematic", "none")
    assert (status, err) == (0, "")
    (model,) = summary_of(out)["models"]
    assert list(model["parameters"]) == ["alpha1", "alpha2", "alpha3", "alpha4"]
    assert "paths.csv" in (out / "noise.yaml").read_text()


def test_a_path_one_way_cannot_tell_the_gyro_from_the_wheels(calibrated):
    errors = ("diameter_error", "gyro_bias_per_metre")
    _, said, _, _ = calibrated("--models", "report", "--systematic", *errors, rows=90)
    assert "gyro_bias_per_metre is not fitted" in said
    assert "gyro_bias_per_metre " not in said.split("not fitted", 1)[1]


def test_an_estimate_on_its_limit_is_no_result(calibrated):
    # Turns of a gyro whose unit is nearly twice what it should be.
    words = ("--models", "report", "--systematic", "base_error")
    status, _, err, out = calibrated(*words, scale=(1.0, 1.0, 1.9))
    assert status == 2
    assert "base_error of report on the limit" in err
    assert not (out / "noise.yaml").exists()


def test_the_drive_goes_both_ways_and_turns_both_ways():
    poses = calibration_drive(DriveSettings(rate=20.0, laps=1)).poses
    ways = np.diff(poses[:, 2])
    assert len(poses) == 781
    assert (ways > 0.01).any() and (ways < -0.01).any()


def test_coverage_is_counted_and_written(tmp_path, monkeypatch):
    # With fewer parameters it is done in a moment.
    monkeypatch.setattr(study, "SYSTEMATIC", ("scale_error",))
    settings = study.CalibrateSettings(models=("rate_invariant",), coverage=12)
    summary = study.run_coverage(tmp_path, settings, DriveSettings(rate=2.0))
    assert names_in(tmp_path) == {"coverage.csv", "coverage.png", "summary.json"}
    assert [one["parameter"] for one in summary["coverage"]] == ["std", "scale_error"]
    # Fewer than 8 of 12 at 95 % have a probability of 1 in 5000.
    assert all(8 <= one["held"] <= one["paths"] == 12 for one in summary["coverage"])


def test_paths_of_coverage_have_the_noise_that_is_said():
    (found,) = coverage(DriveSettings(std=0.02, laps=1), "report", (), 200, 1)
    # The standard error of the mean of 200 estimates from 585 parts each, 3.3 times.
    assert found["mean_estimate"] == pytest.approx(0.02, rel=3.3 / np.sqrt(2 * 400 * 200) + 1e-3)


@cases("""
path, scale, line:
  - [odometry, [-1.0, -1.0, 1.0], has the opposite sign]
  - [odometry, [1.0, -1.0, -1.0], has the opposite sign]
  - [odometry, [1000.0, 1000.0, 1.0], are both in m]
  - [odometry, [1.0, 1.0, 57.3], are both in rad]
  - [odometry, [0.0, 0.0, 0.0], are both in m]
  - ["true", [1.0, 1.0, 1.0], equals the truth]
""")
def test_odometry_that_cannot_be_is_refused_with_its_likely_cause(path, scale, line):
    taken = take_steps(made_up(DriveSettings(), 3), StepSettings())
    taken.check()
    with refuses(line):
        replace(taken, odometry=getattr(taken, path) * scale).check()
