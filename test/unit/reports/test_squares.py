import math

import numpy as np
import pytest
from recorded_paths import read_paths_csv

from bullet_lab.core.trajectory import CSV_HEADER, read_tum
from bullet_lab.reports import Reading
from bullet_lab.reports.squares import (
    SquaresReport,
    settings_line,
    squares_summary,
)

TICK = 50_000_000
RNG = np.random.default_rng(3)
POSES = [tuple(pose) for pose in RNG.uniform(-3, 3, (40, 3)).tolist()]


@pytest.fixture
def recording(tmp_path):
    return SquaresReport(tmp_path / "out")


def lines(recording, name):
    return (recording.folder / name).read_text().splitlines()


def fill(recording, perfect=20, noisy=15):
    for index in range(perfect):
        recording.add("odom", (index + 1) * TICK, POSES[index])
        if index < noisy:
            recording.add("noisy_odom", (index + 1) * TICK, POSES[-index - 1])


@pytest.mark.parametrize("finish", [False, True])
def test_what_was_recorded_is_read_back_bit_for_bit(recording, finish):
    fill(recording)
    if finish:
        recording.finish()
    assert read_tum(recording.folder / "odom.tum").poses == pytest.approx(np.array(POSES[:20]))
    assert len(read_tum(recording.folder / "noisy_odom.tum")) == 15
    first, second = read_paths_csv(recording.folder / "paths.csv")
    assert first.poses.tolist() == [list(pose) for pose in POSES[:15]]
    assert second.poses.tolist() == [list(POSES[-index - 1]) for index in range(15)]
    in_memory = recording.pairs()
    assert in_memory[1].poses.tolist() == second.poses.tolist()
    assert in_memory[0].stamps.tolist() == first.stamps.tolist()


def test_finish_leaves_out_what_came_later(recording):
    fill(recording)
    assert recording.series["odom"].last == 20 * TICK
    recording.finish(until=12 * TICK)
    assert len(read_tum(recording.folder / "odom.tum")) == 12
    assert len(read_tum(recording.folder / "noisy_odom.tum")) == 12
    assert len(read_paths_csv(recording.folder / "paths.csv")[0]) == 12
    assert len(recording.perfect()) == len(recording.pairs()[0]) == 12
    assert sorted(path.name for path in recording.folder.iterdir()) == [
        "noisy_odom.tum", "odom.tum", "paths.csv",
    ]  # fmt: skip


def test_an_empty_recording(recording):
    assert recording.perfect() is None
    assert recording.pairs() is None
    recording.finish()
    assert lines(recording, "paths.csv") == [CSV_HEADER]
    assert lines(recording, "odom.tum") == []
    summary = squares_summary(None, None)
    assert (summary["side_lengths_m"], summary["pairs"], summary["ape_rmse_m"]) == ([], 0, None)


def test_the_summary_has_the_sides_and_the_errors(recording):
    for number in range(1, 81):
        pose = (0.0125 * number, 0.0, 0.0)
        recording.add("odom", number * TICK, pose)
        recording.add("noisy_odom", number * TICK, tuple(np.add(pose, (0.3, 0.4, 0.1))))
    summary = squares_summary(recording.perfect(), recording.pairs())
    assert summary["side_lengths_m"] == pytest.approx([0.9875])
    assert summary["path_length_m"] == pytest.approx(0.9875)
    assert summary["final_error_m"] == summary["ape_rmse_m"] == pytest.approx(0.5)
    assert summary["final_heading_error_deg"] == pytest.approx(math.degrees(0.1))
    assert summary["pairs"] == 80


def test_time_set_back_begins_a_new_run(recording):
    fill(recording)
    old = []
    recording.on_reset = old.append
    assert recording.take("odom", Reading(3 * TICK, POSES[0]))
    assert old == [recording.folder / "run_1"]
    assert len(read_paths_csv(old[0] / "paths.csv")[0]) == 15
    # A late message of the old run.
    assert not recording.take("noisy_odom", Reading(16 * TICK, POSES[1]))
    assert recording.take("noisy_odom", Reading(3 * TICK, POSES[1]))
    assert recording.pairs()[0].stamps.tolist() == [0.15]
    assert recording.newest() == 3 * TICK


def test_the_report_forgets_the_covariances_of_the_old_run(tmp_path):
    report = SquaresReport(tmp_path)
    resets = []
    report.on_reset = resets.append
    for stamp in (2 * TICK, TICK):
        for topic in ("odom", "noisy_odom"):
            assert report.take(topic, Reading(stamp, POSES[0], ((0.01, 0.0), (0.0, 0.01))))
    assert resets == [tmp_path / "run_1"]
    assert list(report._covariances) == [TICK]
    report.about = {"std": 0.1, "seed": 2}
    figure = report.figures({})["paths.png"]
    assert figure._suptitle.get_text().endswith("\nstd = 0.1, seed = 2")


@pytest.mark.parametrize("as_published, shown", [(False, 1), (True, 0)])
def test_ellipses_are_those_of_the_noise(tmp_path, as_published, shown):
    report = SquaresReport(tmp_path)
    for index in range(5):
        for topic in ("odom", "noisy_odom"):
            covariance = ((0.01, 0.0), (0.0, 0.01))
            report.take(topic, Reading((index + 1) * TICK, POSES[index], covariance))
    report.about = {"as_published": as_published}
    axes = report.figures({})["paths.png"].axes[0]
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert sum("ellipses" in label for label in labels) == shown


@pytest.mark.parametrize(
    "about, line",
    [
        ({}, ""),
        (
            {"std": 0.1, "alpha1": 0.3, "alpha4": 0.0, "model": "probabilistic"},
            "\nalpha1 = 0.3, alpha4 = 0.0, model = probabilistic",
        ),
        (
            {"std": 0.1, "alpha1": 0.3, "model": "probabilistic", "as_published": True},
            "\nstd = 0.1, model = probabilistic, as published",
        ),
        (
            {"std": 0.1, "scale_error": 0.0, "base_error": -0.02, "wheel_base": 0.38},
            "\nstd = 0.1, base_error = -0.02",
        ),
    ],
)
def test_the_title_has_the_settings_that_act(about, line):
    assert settings_line(about) == line
