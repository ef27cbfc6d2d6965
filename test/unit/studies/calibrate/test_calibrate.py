"""The job calibrate: its files, its words, and what it refuses."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from bullet_lab.core import se2
from bullet_lab.core.parameters import part_of, read_parameters
from bullet_lab.core.trajectory import CSV_HEADER, Trajectory
from bullet_lab.errors import LabError
from bullet_lab.noise.odometry_noise import ProbabilisticRule, rule_of
from bullet_lab.noise.prediction import path_of
from bullet_lab.noise.systematic import SYSTEMATIC, SystematicErrors, SystematicSpread
from bullet_lab.studies.calibrate import study
from bullet_lab.studies.calibrate.recordings import (
    DriveSettings,
    Recording,
    calibration_drive,
    coverage,
    made_up,
)
from bullet_lab.studies.calibrate.steps import StepSettings, take_steps
from bullet_lab.studies.calibrate.study import (
    CalibrateSettings,
    main,
    run_calibration,
    run_coverage,
)

FILES = {
    "noise.yaml",
    "noise_probabilistic.yaml",
    "noise_rate_invariant.yaml",
    "paths.png",
    "profiles.png",
    "residuals.png",
    "summary.json",
}
SETTINGS, LAP = CalibrateSettings(("rate_invariant", "probabilistic")), DriveSettings(laps=1)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder, said = tmp_path_factory.mktemp("calibrate"), []
    summary = run_calibration(folder, SETTINGS, StepSettings(), LAP, (), said.append)
    return folder, summary, "\n".join(said)


def test_it_leaves_its_files_and_says_what_they_say(done):
    folder, summary, said = done
    assert {path.name for path in folder.iterdir()} == FILES
    assert json.loads((folder / "summary.json").read_text()) == json.loads(json.dumps(summary))
    assert summary["best"] == "probabilistic"
    assert "alpha1 (α1)" in said and "rotation from rotation" in said
    assert "rate_invariant: predicts worse" in said and "it does NOT fit" in said
    assert "windows of 1 m" in said


def test_the_made_up_drive_is_recovered(done):
    _, summary, _ = done
    best, other = summary["models"]
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
        rule, errors = rule_of(found.model, asdict(found)), part_of(SystematicErrors, found)
        assert rule.name == entry["model"]
        spread = part_of(SystematicSpread, found)
        said = {**asdict(rule), **asdict(errors), **asdict(spread)}
        assert set(entry["published"]) < set(said)
        published = {"wheel_base": 0.38, "ticks_per_metre": 0.0, **entry["published"]}
        assert said == pytest.approx(published, rel=1e-8)


def write_paths(path, recording, rows=None):
    table = np.column_stack(
        (recording.truth.stamps, recording.truth.poses, recording.odometry.poses)
    )[:rows]
    np.savetxt(path, table, delimiter=",", header=CSV_HEADER, comments="")


def run(capsys, *words):
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    out, err = capsys.readouterr()
    return ended.value.code, out, err


def test_it_runs_from_the_command_line_on_files(tmp_path, capsys):
    write_paths(tmp_path / "paths.csv", made_up(LAP, 3))
    status, out, err = run(
        capsys, tmp_path / "out", "--base", tmp_path, "--data", "paths.csv",
        "--models", "probabilistic", "--systematic", "none",
    )  # fmt: skip
    assert (status, err) == (0, "")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert list(summary["models"][0]["parameters"]) == ["alpha1", "alpha2", "alpha3", "alpha4"]
    assert "paths.csv" in (tmp_path / "out" / "noise.yaml").read_text()


def test_a_path_one_way_cannot_tell_the_gyro_from_the_wheels(tmp_path, capsys):
    write_paths(tmp_path / "paths.csv", made_up(LAP, 3), rows=90)
    _, out, _ = run(
        capsys, tmp_path, "--data", tmp_path / "paths.csv", "--models", "probabilistic"
    )
    assert "gyro_bias_per_metre is not fitted" in out
    assert "gyro_bias_per_metre " not in out.split("not fitted", 1)[1]


def test_the_drive_goes_both_ways_and_turns_both_ways():
    poses = calibration_drive(DriveSettings(rate=20.0, laps=1)).poses
    ways = np.diff(poses[:, 2])
    assert len(poses) == 781
    assert (ways > 0.01).any() and (ways < -0.01).any()


def test_coverage_is_counted_and_written(tmp_path, monkeypatch):
    # With fewer parameters it is done in a moment.
    monkeypatch.setattr(study, "SYSTEMATIC", ("scale_error",))
    settings = CalibrateSettings(models=("rate_invariant",), coverage=12)
    said = []
    summary = run_coverage(tmp_path, settings, DriveSettings(rate=2.0), said.append)
    assert {path.name for path in tmp_path.iterdir()} == {
        "coverage.csv",
        "coverage.png",
        "summary.json",
    }
    assert [one["parameter"] for one in summary["coverage"]] == ["std", "scale_error"]
    # Fewer than 8 of 12 at 95 % have a probability of 1 in 5000.
    assert all(8 <= one["held"] <= one["paths"] == 12 for one in summary["coverage"])


def test_paths_of_coverage_have_the_noise_that_is_said():
    (found,) = coverage(DriveSettings(std=0.02, laps=1), "report", (), 200, 1)
    # The standard error of the mean of 200 estimates from 585 parts each, 3.3 times.
    assert found["mean_estimate"] == pytest.approx(0.02, rel=3.3 / np.sqrt(2 * 400 * 200) + 1e-3)


def test_an_estimate_on_its_limit_is_no_result(tmp_path, capsys):
    recording = made_up(LAP, 3)
    # Turns of a gyro whose unit is nearly twice what it should be.
    steps = se2.steps(recording.odometry.poses) * [1.0, 1.0, 1.9]
    poses = path_of(steps)
    wrong = Recording("x", recording.truth, Trajectory(recording.truth.stamps, poses))
    write_paths(tmp_path / "paths.csv", wrong)
    status, _, err = run(
        capsys, tmp_path / "out", "--data", tmp_path / "paths.csv",
        "--models", "report", "--systematic", "base_error",
    )  # fmt: skip
    assert status == 2
    assert "base_error of report on the limit" in err
    assert not (tmp_path / "out" / "noise.yaml").exists()


def test_the_true_noise_of_a_drive_is_that_of_the_node():
    assert rule_of("probabilistic", DriveSettings().noise()) == ProbabilisticRule()


@pytest.mark.parametrize(
    ("scale", "line"),
    [
        ((-1.0, -1.0, 1.0), "has the opposite sign"),
        ((1.0, -1.0, -1.0), "has the opposite sign"),
        ((1000.0, 1000.0, 1.0), "are both in m"),
        ((1.0, 1.0, 57.3), "are both in rad"),
        ((0.0, 0.0, 0.0), "are both in m"),
    ],
)
def test_odometry_that_cannot_be_is_refused_with_its_likely_cause(scale, line):
    taken = take_steps(made_up(DriveSettings(), 3), StepSettings())
    taken.check()
    with pytest.raises(LabError, match=line):
        replace(taken, odometry=taken.odometry * scale).check()


def test_odometry_that_equals_the_truth_is_refused():
    taken = take_steps(made_up(DriveSettings(), 3), StepSettings())
    with pytest.raises(LabError, match="equals the truth"):
        replace(taken, odometry=taken.true).check()
