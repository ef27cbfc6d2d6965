"""What the study reads and writes, and what it says to bad input."""

import builtins
import csv
import json
import math

import numpy as np
import pytest

from bullet_lab.core.files import FileError
from bullet_lab.core.trajectory import Trajectory, read_tum
from bullet_lab.errors import LabError
from bullet_lab.studies.noise_study.study import (
    StudySettings,
    main,
    metrics_rows,
    run_study,
    simulated_square,
    study,
)
from bullet_lab.studies.paths import PathFileError, read_path, tum_text
from bullet_lab.studies.study import whole_results, write_table

SMALL = StudySettings(levels=(0.0, 0.1), rates=(0.9, 5.0), paths=20)
FILES = {
    "banana.png",
    "coverage.png",
    "error_by_distance.csv",
    "error_by_distance.png",
    "levels_probabilistic.png",
    "levels_rate_invariant.png",
    "levels_report.png",
    "message_rate.png",
    "metrics.csv",
    "perfect.tum",
    "probabilistic_std_0.1.tum",
    "probabilistic_std_0.tum",
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


def files_below(folder):
    return {path.name for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    lines = []
    summary = run_study(folder, SMALL, bend(), "a bend", lines.append)
    return folder, summary, lines


def test_all_files_are_there_and_nothing_else(results):
    folder, _, lines = results
    assert files_below(folder) == FILES
    assert {path.name for path in folder.iterdir() if path.is_dir()} == {"tum"}
    assert len(lines) == 6
    for path in folder.glob("*.png"):
        assert path.read_bytes().startswith(b"\x89PNG")


def test_summary_holds_each_level_model_and_rate(results):
    folder, summary, _ = results
    assert json.loads((folder / "summary.json").read_text()) == json.loads(json.dumps(summary))
    keys = {(case["model"], case["rate_hz"], case["std"]) for case in summary["cases"]}
    assert len(keys) == len(summary["cases"]) == 12
    for case in summary["cases"]:
        pose = case["final_pose_error"]
        assert np.shape(pose["sample_mean"]) == np.shape(pose["exact_mean"]) == (3,)
        for name in ("sample", "exact", "first_order"):
            assert np.shape(pose[f"{name}_covariance"]) == (3, 3)
        assert (case["nees"]["mean"] is None) == (case["std"] == 0.0)


def test_metrics_have_a_row_for_each_case(results):
    folder, summary, _ = results
    with (folder / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 12
    for row, case in zip(rows, summary["cases"]):
        assert (row["model"], float(row["std"])) == (case["model"], case["std"])
        assert float(row["drift_percent_p95"]) == case["metrics"]["drift_percent"]["p95"]
        assert None not in row.values()


def test_metrics_of_a_lap_that_a_low_rate_does_not_see(tmp_path):
    # The heading goes round once and half back again, in a second.
    heading = np.concatenate([np.linspace(0.0, 6.4, 60), np.linspace(6.4, 3.2, 30)])
    stamps = np.arange(90) / 90.0
    poses = np.column_stack([3.0 * stamps, 0.0 * stamps, heading])
    settings = StudySettings(
        levels=(0.1,), models=("report",), rates=(2.0, 90.0), paths=10, delta=1.5
    )
    cases = study(Trajectory(stamps, poses), settings)
    assert [len(case.perfect_closure) for case in cases] == [0, 1]
    write_table(tmp_path / "metrics.csv", metrics_rows(cases))
    with (tmp_path / "metrics.csv").open() as file:
        low, high = csv.DictReader(file)
    assert low["closure_error_lap_1_m_mean"] == ""
    assert float(high["closure_error_lap_1_m_mean"]) > 0.0
    assert low["gaussian_enough"] and high["gaussian_enough"]


def test_error_by_distance_ends_with_the_path(results):
    folder, _, _ = results
    with (folder / "error_by_distance.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["std"] == "0.1"]
    ends = [row for row in rows if float(row["travelled_m"]) == pytest.approx(8.0, abs=0.05)]
    assert len({(row["model"], row["rate_hz"]) for row in ends}) == 6
    for row in ends:
        assert float(row["sample_rms_m"]) == pytest.approx(float(row["exact_rms_m"]), rel=0.6)


def test_tum_files_share_their_stamps(results):
    folder, _, _ = results
    perfect = read_tum(folder / "tum" / "perfect.tum")
    noisy = read_tum(folder / "tum" / "report_std_0.1.tum")
    np.testing.assert_array_equal(perfect.stamps, noisy.stamps)
    clean = read_tum(folder / "tum" / "report_std_0.tum")
    np.testing.assert_allclose(clean.poses, perfect.poses, atol=1e-12)


@pytest.mark.long
def test_the_same_settings_give_the_same_tables(results, tmp_path):
    folder, _, _ = results
    run_study(tmp_path, SMALL, bend(), "a bend")
    for name in ("summary.json", "metrics.csv", "error_by_distance.csv"):
        assert (tmp_path / name).read_text() == (folder / name).read_text()


def test_a_case_does_not_depend_on_what_else_is_studied():
    both = study(bend(), SMALL)
    settings = StudySettings(levels=(0.1,), models=("report",), rates=(5.0,), paths=20)
    (alone,) = study(bend(), settings)
    (same,) = [c for c in both if (c.model, c.rate, c.std) == ("report", 5.0, 0.1)]
    np.testing.assert_array_equal(alone.covariance, same.covariance)
    assert alone.metrics == same.metrics


def test_the_simulated_square():
    trajectory = simulated_square()
    assert trajectory.length() == pytest.approx(7.6, abs=0.1)
    assert 1.0 / np.diff(trajectory.stamps).mean() == pytest.approx(20.0, rel=0.01)
    (case,) = study(
        trajectory, StudySettings(levels=(0.1,), models=("report",), rates=(20.0,), paths=10)
    )
    assert len(case.perfect_closure) == 1
    assert case.perfect_closure[0] < 0.1


# ---- Reading ----


def test_the_formats_hold_the_same_path(tmp_path):
    (tmp_path / "a.tum").write_text(tum_text(bend()))
    table = zip(bend().stamps.tolist(), bend().poses.tolist())
    rows = [f"{yaw!r},{x!r},{y!r},{stamp!r},7" for stamp, (x, y, yaw) in table]
    (tmp_path / "a.csv").write_text("\n".join(["yaw,x,y,stamp,more", *rows]) + "\n")
    for name in ("a.tum", "a.csv"):
        trajectory = read_path(tmp_path / name)
        np.testing.assert_allclose(trajectory.stamps, bend().stamps, atol=1e-9)
        np.testing.assert_allclose(trajectory.poses, bend().poses, atol=1e-12)


def bag_with(path, kind, stamps=(1.0, 2.0, 3.0)):
    rosbag = pytest.importorskip("rosbag")
    rospy = pytest.importorskip("rospy")
    with rosbag.Bag(str(path), "w") as bag:
        for number, stamp in enumerate(stamps):
            message = kind()
            if hasattr(message, "pose"):
                message.header.stamp = rospy.Time.from_sec(stamp)
                message.pose.pose.position.x = 0.5 * number
                message.pose.pose.orientation.w = 1.0
            bag.write("/odom", message, rospy.Time.from_sec(10.0 + number))


def test_a_bag(tmp_path):
    odometry = pytest.importorskip("nav_msgs.msg").Odometry
    bag_with(tmp_path / "a.bag", odometry)
    trajectory = read_path(tmp_path / "a.bag")
    np.testing.assert_array_equal(trajectory.stamps, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(trajectory.poses[:, 0], [0.0, 0.5, 1.0])
    with pytest.raises(PathFileError, match="nothing on the topic /nix; odometry is on /odom"):
        read_path(tmp_path / "a.bag", "/nix")


def test_a_topic_of_a_bag_is_the_same_with_and_without_its_slash(tmp_path):
    odometry = pytest.importorskip("nav_msgs.msg").Odometry
    bag_with(tmp_path / "a.bag", odometry)
    assert len(read_path(tmp_path / "a.bag", "odom").stamps) == 3


def test_a_bag_with_something_else_or_a_repeated_stamp(tmp_path):
    odometry = pytest.importorskip("nav_msgs.msg").Odometry
    text = pytest.importorskip("std_msgs.msg").String
    bag_with(tmp_path / "a.bag", text)
    with pytest.raises(PathFileError, match="not nav_msgs/Odometry"):
        read_path(tmp_path / "a.bag")
    bag_with(tmp_path / "b.bag", odometry, (1.0, 1.0))
    with pytest.raises(LabError, match="stamps must increase"):
        read_path(tmp_path / "b.bag")


def test_what_a_bag_says_of_its_messages_is_not_believed(tmp_path):
    odometry = pytest.importorskip("nav_msgs.msg").Odometry

    class Foreign(odometry):
        _md5sum, _full_text = 32 * "0", "int32 x"

    bag_with(tmp_path / "a.bag", Foreign)
    with pytest.raises(PathFileError, match="is of another nav_msgs/Odometry"):
        read_path(tmp_path / "a.bag")
    Foreign._md5sum = odometry._md5sum
    bag_with(tmp_path / "b.bag", Foreign)
    assert len(read_path(tmp_path / "b.bag")) == 3


@pytest.mark.parametrize("content", [b"", b"no bag at all\n", b"#ROSBAG V2.0\n\x01\x02"])
def test_an_unreadable_bag(tmp_path, content):
    pytest.importorskip("rosbag")
    (tmp_path / "a.bag").write_bytes(content)
    with pytest.raises(PathFileError, match="^cannot read .*a.bag: "):
        read_path(tmp_path / "a.bag")


def test_a_bag_without_rosbag(tmp_path, monkeypatch):
    real = builtins.__import__

    def fail(name, *args, **kwds):
        if name == "rosbag":
            raise ImportError("No module named 'rosbag'")
        return real(name, *args, **kwds)

    monkeypatch.setattr(builtins, "__import__", fail)
    with pytest.raises(PathFileError, match="without ROS's rosbag"):
        read_path(tmp_path / "a.bag")


GOOD = "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n"
BAD_PATHS = {
    "nan.tum": (GOOD + "2 nan 0 0 0 0 0 1\n", "line 3: a value is not finite"),
    "back.tum": (GOOD + "0.5 2 0 0 0 0 0 1\n", "stamps must increase"),
    "twice.tum": (GOOD + "1 2 0 0 0 0 0 1\n", "stamps must increase"),
    "one.tum": ("0 0 0 0 0 0 0 1\n", "only one pose"),
    "none.tum": ("", "no poses"),
    "still.tum": ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "shorter than 0.001 m"),
    "far.tum": (GOOD + "2 1e200 0 0 0 0 0 1\n", "longer than 1e+07 m"),
    "short.tum": (GOOD + "2 1\n", "8 values needed"),
    "text.tum": ("\x00\xff", "line 1: 8 values needed"),
    "nan.csv": ("stamp,x,y,yaw\n0,0,0,0\n1,1,nan,0\n", "line 3: a value is not finite"),
    "word.csv": ("stamp,x,y,yaw\n0,0,0,0\n1,1,a,0\n", "line 3: a value is not a number"),
    "short.csv": ("stamp,x,y,yaw\n0,0,0,0\n1,1\n", "line 3: a value is not a number"),
    "twice.csv": ("stamp,x,y,yaw\n0,0,0,0\n0,1,0,0\n", "stamps must increase"),
    "one.csv": ("stamp,x,y,yaw\n0,0,0,0\n", "only one pose"),
    "none.csv": ("", "has to name the columns"),
    "head.csv": ("t,x,y\n0,0,0\n", "has to name the columns"),
}


@pytest.mark.parametrize("name", BAD_PATHS)
def test_a_bad_path_ends_with_one_line_and_nothing_written(tmp_path, capfd, name):
    content, message = BAD_PATHS[name]
    path = tmp_path / name
    path.write_text(content)
    assert_refused(tmp_path, capfd, ["--path", str(path)], message)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--levels", "-0.1"], "--levels is '-0.1': it must be different numbers >= 0 and <= 10"),
        (["--levels", "1e9"], "--levels is"),
        (["--levels", "nan"], "--levels is"),
        (["--levels", "0.1", "0.1"], "it must be different numbers"),
        (["--levels", "much"], "--levels is 'much'"),
        (["--rates", "0"], "--rates is '0': it must be different numbers > 0"),
        (["--rates", "1e9"], "too many messages"),
        (["--models", "magic"], "--models is 'magic': it must be different words of report"),
        (["--paths", "1"], "--paths is '1': it must be a whole number from 2 to 10000000"),
        (["--paths", "100000000"], "--paths is"),
        (["--seed", "-1"], "--seed is '-1'"),
        (["--delta", "0"], "--delta is '0': it must be a number > 0"),
        (["--delta", "50"], "no two poses are 50 m apart"),
        (["--laps", "0"], "--laps is '0'"),
        (["--path", "nix.tum"], "cannot read nix.tum: No such file"),
        (["--path", "nix.csv"], "cannot read nix.csv: No such file"),
        (["--nix"], "unrecognized arguments: --nix"),
    ],
)
def test_bad_words_end_with_one_line_and_nothing_written(tmp_path, capfd, words, message):
    if not {"--path", "--laps"} & set(words):
        (tmp_path / "bend.tum").write_text(tum_text(bend()))
        words = ["--path", str(tmp_path / "bend.tum"), *words]
    assert_refused(tmp_path, capfd, words, message)


def assert_refused(folder, capfd, words, message):
    with pytest.raises(SystemExit) as end:
        main([str(folder / "out"), *words])
    assert end.value.code == 2
    printed = capfd.readouterr()
    assert printed.out == ""
    assert message in printed.err
    assert printed.err.startswith("noise_study: ")
    assert printed.err.count("\n") == 1
    assert not (folder / "out").exists() or not list((folder / "out").iterdir())


def test_the_command_line(tmp_path, capfd):
    (tmp_path / "bend.tum").write_text(tum_text(bend()))
    words = ["--path", "bend.tum", "--base", str(tmp_path), "--levels", "0.1", "--rates", "5"]
    words += ["--models", "report", "--paths", "10", "--seed", "3"]
    words += ["__name:=noise_study", "__log:=/tmp/a b.log"]
    with pytest.raises(SystemExit) as end:
        main([str(tmp_path / "out"), *words])
    assert end.value.code == 0
    assert "report at 5 Hz: 1 levels, 10 paths of 41 messages" in capfd.readouterr().out
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["seed"], summary["paths"], len(summary["cases"])) == (3, 10, 1)
    assert summary["path"]["source"] == str(tmp_path / "bend.tum")


def test_an_interrupted_study_leaves_what_was_there(tmp_path, monkeypatch):
    (tmp_path / "bend.tum").write_text(tum_text(bend()))
    (tmp_path / "metrics.csv").write_text("old")

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("bullet_lab.studies.results.save", interrupt)
    with pytest.raises(SystemExit) as end:
        words = "--paths 10 --levels 0.1 --rates 5 --models report"
        main([str(tmp_path), "--path", str(tmp_path / "bend.tum"), *words.split()])
    assert end.value.code == 130
    assert files_below(tmp_path) == {"bend.tum", "metrics.csv"}
    assert (tmp_path / "metrics.csv").read_text() == "old"


# ---- Writing ----


def test_results_are_put_in_place_when_whole(tmp_path):
    (tmp_path / "a").write_text("old")
    with whole_results(tmp_path) as part:
        (part / "a").write_text("new")
        (part / "below").mkdir()
        (part / "below" / "b").write_text("b")
        assert (tmp_path / "a").read_text() == "old"
    assert (tmp_path / "a").read_text() == "new"
    assert files_below(tmp_path) == {"a", "b"}
    assert {path.name for path in tmp_path.iterdir()} == {"a", "below"}


def test_results_that_cannot_be_written_leave_the_old_ones(tmp_path):
    (tmp_path / "a").write_text("old")
    with pytest.raises(FileError, match="^cannot write to "), whole_results(tmp_path) as part:
        (part / "a").write_text("new")
        (part / "nix" / "b").write_text("b")
    assert (tmp_path / "a").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_the_summary_comes_last(tmp_path):
    (tmp_path / "z" / "in the way").mkdir(parents=True)
    with pytest.raises(FileError), whole_results(tmp_path) as part:
        (part / "summary.json").write_text("{}")
        (part / "z").write_text("z")
    assert not (tmp_path / "summary.json").exists()


def test_every_refusal_is_a_lab_error():
    with pytest.raises(LabError):
        study(Trajectory([0.0], [[0.0, 0.0, 0.0]]), SMALL)
    with pytest.raises(LabError):
        StudySettings(levels=(math.inf,))
