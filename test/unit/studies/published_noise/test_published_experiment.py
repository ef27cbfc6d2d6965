"""The answer to the report's open question, with fewer seeds than the job."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from study_runs import names_in, run_main, summary_of

from bullet_lab.noise.published_noise import ALL, DEFECTS, NONE, Defects, PublishedNoise
from bullet_lab.studies.published_noise.study import (
    PublishedNoiseSettings,
    Replay,
    main,
    replay_drive,
    run_published_noise,
)
from bullet_lab.studies.squares import NO_SIDE

SEEDS = 20


@pytest.fixture(scope="module")
def drive():
    return replay_drive()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder, summary and lines of a study from the command line."""
    folder = tmp_path_factory.mktemp("published")
    status, said, _ = run_main(main, folder, "--seeds", SEEDS)
    assert status == 0
    return folder, summary_of(folder), said


def by_name(summary):
    return {
        " + ".join(name for name in DEFECTS if row[name]) or "none": row
        for row in summary["combinations"]
    }


def test_the_drive_is_the_square_of_figure_1a(drive):
    assert len(drive.stamps) == len(drive.poses) == len(drive.sides)
    assert drive.sides[0] == NO_SIDE and drive.sides[-1] == 3
    sides = np.hypot(*np.diff(drive.corners, axis=0).T)
    np.testing.assert_allclose(sides, 1.902, atol=0.003)
    # It rests for two periods of the sampling node before and after.
    moving = np.hypot(*np.diff(drive.poses[:, :2], axis=0).T) > 1e-4
    assert np.flatnonzero(moving)[0] >= 44 and not moving[-44:].any()


def replay_of(drive, seeds=20, **settings):
    return Replay(drive, PublishedNoiseSettings(seeds=seeds, **settings))


def test_a_replay_is_what_the_live_algorithm_does(drive):
    replay = replay_of(drive, seed=5)
    np.testing.assert_allclose(replay.corners, drive.corners, atol=1e-3)
    messages = replay.messages(ALL, [3])[:, 0]
    live = PublishedNoise(0.1, 5 + 3)
    expected = np.array([live.update(*pose) for pose in drive.poses[messages].tolist()])
    np.testing.assert_allclose(replay.noisy(ALL, [3])[:, 0], expected, atol=1e-9)
    assert np.diff(drive.stamps[messages]) == pytest.approx(1 / 0.9, abs=0.051)
    assert replay.messages(NONE, [3]).shape == (len(drive.stamps), 1)
    phases = drive.stamps[replay.messages(ALL, range(20))[0]]
    assert phases.max() <= 1.2 and np.ptp(phases) > 0.5


def test_without_aliasing_the_first_corner_is_off_as_the_closed_form_has_it(drive):
    """Independent errors of the steps add up by their squares, and nothing takes them back."""
    seeds = 200
    replay = replay_of(drive, seeds, reading=0.0)
    defects = Defects(sampled=True, unbent=True)
    messages = replay.messages(defects, range(seeds))
    at_corner = np.argmax(drive.sides[messages] == 1, axis=0) - 1
    errors = replay.noisy(defects, range(seeds))[at_corner, np.arange(seeds), 0] - 1.902
    steps = np.diff(drive.poses[messages, 0], axis=0)
    on_side = np.arange(len(steps))[:, np.newaxis] < at_corner
    sigmas = 0.1 * np.sqrt(np.sum(np.where(on_side, steps, 0.0) ** 2, axis=0))
    np.testing.assert_allclose(sigmas, 0.1 * 1.902 / 3.0, rtol=0.1)
    squares = np.sum((errors / sigmas) ** 2)
    # 99.9 % of the time.
    assert chi2.ppf(5e-4, seeds) < squares < chi2.isf(5e-4, seeds)
    # And it is read as such.
    lengths = replay.lengths(defects, range(seeds))
    assert np.all(lengths[:, 5] > 0.98 * np.abs(errors) - 1e-3)


def test_points_are_read_with_the_error_that_is_set(drive):
    replay = replay_of(drive, 100, std=0.0, reading=0.002)
    found = replay.lengths(Defects(aliasing=True), range(100))[:, 5]
    # The largest of three distances with a Rayleigh distribution, sigma = 2 mm for either point.
    quarters = 0.002 * np.sqrt(-4.0 * np.log(1.0 - np.array([0.25, 0.75]) ** (1 / 3)))
    np.testing.assert_allclose(np.quantile(found, (0.25, 0.75)), quarters, rtol=0.15)


def test_the_report_explains_its_figure(run):
    _, summary, said = run
    rows = by_name(summary)
    assert rows[str(ALL)]["p_all"] > 0.2
    assert summary["figure_1b"]["sampling_rate_hz"] == pytest.approx(0.9, abs=0.01)
    assert rows[str(replace(ALL, unbent=False))]["p_all"] == rows[str(ALL)]["p_all"]
    assert "figure 1b strays" in said and "too few seeds" in said


@pytest.mark.long
def test_four_defects_made_figure_1b(tmp_path):
    summary = run_published_noise(tmp_path, PublishedNoiseSettings())
    assert summary["needed"] == ["aliasing", "unwrapped", "noise_at_rest", "sampled"]
    assert summary["cannot_be_told"] == ["unbent"]
    assert set(summary["explained_by"]) == {str(ALL), str(replace(ALL, unbent=False))}
    for evidence in ("sides", "start", "corners"):
        assert summary["verdicts"][evidence]["aliasing"] == "needed"


def test_each_of_three_defects_has_its_own_mark_on_the_third_side(run):
    rows = by_name(run[1])
    third = {name: row["side3_q50_m"] for name, row in rows.items()}
    best = third["aliasing + unwrapped + sampled"]
    assert 0.1 < best < 0.25
    assert third["aliasing + sampled"] < 0.05 * best
    assert third["aliasing + unwrapped"] < 0.1 * best


def test_tables(run, as_before):
    folder, _, _ = run
    told = sorted(names_in(folder))
    for name, every in (("combinations", 3), ("lengths", 31)):
        lines = (folder / f"{name}.csv").read_text().replace(",", " ").splitlines()
        told += [f"{len(lines)}", *lines[::every]]
    # They are rounded to 1e-5.
    as_before(told, "tables.txt", within=2e-5)


def test_blocks_do_not_show(drive):
    replay = replay_of(drive)
    whole, part = replay.lengths(ALL, range(9)), replay.lengths(ALL, range(4, 7))
    np.testing.assert_allclose(part, whole[4:7], atol=1e-9)


@pytest.mark.long
def test_noise_that_is_not_there_explains_nothing(tmp_path):
    _, said, _ = run_main(main, tmp_path, "--seeds", "400", "--std", "0")
    assert "no combination explains figure 1b" in said
