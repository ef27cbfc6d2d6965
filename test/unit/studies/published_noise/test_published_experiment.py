"""The answer to the report's open question, with fewer seeds than the job."""

import csv
import json

import numpy as np
import pytest

from bullet_lab.errors import LabError
from bullet_lab.noise.published_noise import PublishedNoise
from bullet_lab.studies.published_noise.defects import ALL, DEFECTS, NONE, combinations
from bullet_lab.studies.published_noise.side_deviation import (
    SideError,
    read_published_figure,
)
from bullet_lab.studies.published_noise.study import (
    PublishedNoiseSettings,
    Replay,
    main,
    replay_drive,
    run_published_noise,
)
from bullet_lab.studies.squares import NO_SIDE

SEEDS = 100
FILES = {
    "combinations.csv",
    "compare.png",
    "defects.png",
    "deviations.csv",
    "first_turns.png",
    "sides.png",
    "summary.json",
}


@pytest.fixture(scope="module")
def drive():
    return replay_drive()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("published")
    return folder, run_published_noise(folder, PublishedNoiseSettings(seeds=SEEDS))


def by_name(summary):
    return {row["name"]: row for row in summary["combinations"]}


def test_the_drive_is_the_square_of_figure_1a(drive):
    assert len(drive.stamps) == len(drive.poses) == len(drive.sides)
    assert drive.sides[0] == NO_SIDE and drive.sides[-1] == 3
    sides = np.hypot(*np.diff(drive.corners, axis=0).T)
    np.testing.assert_allclose(sides, 1.902, atol=0.003)
    # It rests for two periods of the sampling node before and after.
    moving = np.hypot(*np.diff(drive.poses[:, :2], axis=0).T) > 1e-4
    assert np.flatnonzero(moving)[0] >= 44 and not moving[-44:].any()


def test_what_figure_1b_shows(drive, package):
    figure = read_published_figure(package / "data" / "fig1_paths.csv", drive.corners)
    assert figure.deviations * 1e3 == pytest.approx([1.6, 3.0, 213.6, 1.4, 0.0], abs=0.1)
    assert figure.third_side_steps == 9


def test_a_replay_is_what_the_live_algorithm_does(drive):
    replay = Replay(drive, PublishedNoiseSettings(seeds=20, seed=5))
    messages = replay.messages(ALL, [3])[:, 0]
    live = PublishedNoise(0.1, 5 + 3)
    expected = np.array([live.update(*pose) for pose in drive.poses[messages].tolist()])
    np.testing.assert_allclose(replay.noisy(ALL, [3])[:, 0], expected, atol=1e-9)
    assert np.diff(drive.stamps[messages]) == pytest.approx(1 / 0.9, abs=0.051)
    assert replay.messages(NONE, [3]).shape == (len(drive.stamps), 1)
    phases = drive.stamps[replay.messages(ALL, range(20))[0]]
    assert phases.max() <= 1.2 and np.ptp(phases) > 0.5


def test_three_defects_explain_figure_1b_and_two_change_nothing(run):
    _, summary = run
    assert summary["explained"]
    assert summary["needed"] == ["aliasing", "unwrapped", "sampled"]
    assert summary["cannot_be_told"] == ["noise_at_rest", "unbent"]
    assert len(summary["winners"]) == 4
    assert all({*summary["needed"]} <= {*name.split(" + ")} for name in summary["winners"])
    assert summary["defects"]["unbent"]["changes_nothing_in_the_best"]
    assert summary["combinations"][0]["p_value"] > 0.2
    for row in summary["combinations"][4:]:
        assert row["log10_likelihood_to_best"] < -4.0 and row["p_value"] < 0.05
    assert len(summary["robustness"]) == 9
    for judgement in summary["robustness"]:
        assert judgement["log10_likelihood_without_all_needed"] < -2.0
    assert summary["figure_1b"]["sampling_rate_hz"] == pytest.approx(0.9, abs=0.01)


def test_each_needed_defect_has_its_own_mark(run):
    """The median deviation on the third side: what each of the three makes of it."""
    rows = by_name(run[1])
    third = {name: row["side_deviation_m"]["q50"][2] for name, row in rows.items()}
    best = third["aliasing + unwrapped + sampled"]
    assert 0.1 < best < 0.25
    assert third["aliasing + sampled"] < 0.02 * best
    assert third["aliasing + unwrapped"] < 0.1 * best
    without_aliasing = rows["unwrapped + sampled"]["side_deviation_m"]["q50"]
    assert min(without_aliasing[1:]) > 0.05


def test_the_error_at_the_end_is_that_of_all_the_drive(drive):
    replay = Replay(drive, PublishedNoiseSettings(seeds=20))
    expected = np.hypot(*(replay.noisy(NONE, range(4))[-1] - drive.poses[-1])[:, :2].T)
    np.testing.assert_allclose(replay.deviations(range(4))[NONE][:, 4], expected)


def test_tables(run):
    folder, summary = run
    assert {path.name for path in folder.iterdir()} == FILES
    assert json.loads((folder / "summary.json").read_text()) == summary
    with (folder / "combinations.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 32
    for row, about in zip(rows, summary["combinations"]):
        assert [name for name in DEFECTS if row[name] == "1"] == about["defects"]
        assert float(row["side3_q50_m"]) == about["side_deviation_m"]["q50"][2]
    with (folder / "deviations.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 32 * SEEDS
    best = [row for row in rows if [row[name] for name in DEFECTS] == list("11010")]
    assert [int(row["seed"]) for row in best] == list(range(1, SEEDS + 1))
    median = np.median([float(row["side3_m"]) for row in best])
    found = by_name(summary)["aliasing + unwrapped + sampled"]["side_deviation_m"]["q50"][2]
    assert median == pytest.approx(found, abs=1e-5)


@pytest.mark.long
def test_same_settings_same_files(run, tmp_path):
    folder, _ = run
    run_published_noise(tmp_path, PublishedNoiseSettings(seeds=SEEDS))
    for name in FILES:
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes(), name


def test_blocks_do_not_show(drive):
    replay = Replay(drive, PublishedNoiseSettings(seeds=20))
    whole, part = replay.deviations(range(9)), replay.deviations(range(4, 7))
    assert set(whole) == set(combinations())
    for defects, deviations in whole.items():
        np.testing.assert_allclose(part[defects], deviations[4:7], atol=1e-9)


@pytest.mark.parametrize(
    "words, said",
    [
        (["--std", "-0.1"], "--std is '-0.1': it must be a number >= 0 and <= 1"),
        (["--std", "nan"], "--std is 'nan'"),
        (["--std", "1e30"], "--std is '1e30'"),
        (["--seeds", "3"], "--seeds is '3': it must be a whole number from 20 to 20000"),
        (["--seeds", "many"], "--seeds is 'many'"),
        (["--seed", "-1"], "--seed is '-1'"),
        (["--noise"], "unrecognized arguments: --noise"),
    ],
)
def test_bad_input_is_one_line_and_status_2(tmp_path, capsys, words, said):
    out = tmp_path / "out"
    with pytest.raises(SystemExit) as end:
        main([str(out), *words])
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert not out.exists()


def test_an_unwritable_folder_is_one_line_and_status_2(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    with pytest.raises(SystemExit) as end:
        main([str(tmp_path / "file" / "out")])
    assert end.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_the_words_that_roslaunch_adds_are_ignored(tmp_path, capsys):
    words = ["--seeds", "20", "__name:=published_noise", "__log:=/tmp/a b.log"]
    with pytest.raises(SystemExit) as end:
        main([str(tmp_path), *words])
    assert end.value.code == 0
    assert {path.name for path in tmp_path.iterdir()} == FILES
    assert "figure 1b strays" in capsys.readouterr().out


@pytest.mark.long
def test_noise_that_is_not_there_explains_nothing(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main([str(tmp_path), "--seeds", "20", "--std", "0"])
    assert "no combination explains figure 1b" in capsys.readouterr().out


@pytest.mark.parametrize(
    "text, error",
    [
        ("", "no path"),
        ("a,b\n1,2\n", "not a table"),
        ("series,x_m,y_m\nfig1b_noisy,1\n", "not a table"),
        ("series,x_m,y_m\nfig1b_noisy,1,here\n", "not a table"),
        ("series,x_m,y_m\nfig1b_noisy,1,nan\n", "not finite"),
    ],
)
def test_a_bad_figure_file(tmp_path, drive, text, error):
    path = tmp_path / "figure.csv"
    path.write_text(text)
    with pytest.raises(LabError, match=error):
        read_published_figure(path, drive.corners)


def test_a_figure_of_something_else(tmp_path, drive):
    path = tmp_path / "figure.csv"
    path.write_text("series,x_m,y_m\nfig1b_noisy,0,0\nfig1b_noisy,1,1\n")
    with pytest.raises(SideError, match="corner 1"):
        read_published_figure(path, drive.corners)
    with pytest.raises(LabError, match="cannot read"):
        read_published_figure(tmp_path / "none.csv", drive.corners)
