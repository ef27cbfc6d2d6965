"""A campaign of dockings: its files, whatever happens on the way to them."""

import os
import random
import shutil
import signal
from multiprocessing import get_context

import numpy as np
import pytest
from shared import cases
from study_runs import csv_rows, summary_of

from bullet_lab.docking.database import ERRORS
from bullet_lab.docking.types import DockingError, DockingResult
from bullet_lab.studies.dock_campaign.study import (
    DockCampaignSettings,
    describe,
    run_campaign,
)
from bullet_lab.studies.dock_campaign.trial import (
    MEASURED,
    DrawSettings,
    draw_scenario,
    run_trial,
)
from bullet_lab.studies.study import TaskLostError

FILES = ("dockings.jsonl", "campaign.csv", "campaign.png")


def outcome_of(scenario, **values):
    """What a docking of this scenario might have come to; every tenth or so fails."""
    rng = np.random.default_rng(scenario.image_seed)
    docked = rng.random() < 0.9
    distance, lateral, yaw = rng.normal(0.0, 1.0, 3) * (0.002, 0.001, 0.1)
    end = (3.44 + distance, lateral, yaw) if docked else scenario.start
    said = {
        "error_name": "NONE" if docked else "NOT_DETECTED",
        "distance_error_m": distance,
        "lateral_error_m": lateral,
        "yaw_error_deg": yaw,
        "wall_contacts": 0,
        "sim_time_s": float(rng.uniform(30.0, 60.0)),
        "calibration": None,
        **values,
    }
    error = DockingError[said["error_name"]]
    result = DockingResult(error, "", calibration=said["calibration"])
    errors = [said[name] for name in ERRORS]
    values = *errors, said["wall_contacts"], 0, said["sim_time_s"], *end, "egl"
    return result, dict(zip(MEASURED, values))


def fake_trial(settings, index):
    return run_trial(settings, index, outcome_of)


def in_order(trial, indices):
    """Run made-up dockings with the settings of a trial."""
    return ((index, fake_trial(*trial.args, index)) for index in indices)


def shuffled(trial, indices):
    indices = list(indices)
    random.Random(1).shuffle(indices)
    return in_order(trial, indices)


def stopping_after(count, stop):
    def run(trial, indices):
        for number, found in enumerate(shuffled(trial, indices)):
            if number == count:
                stop()
            yield found

    return run


def interrupt():
    raise KeyboardInterrupt


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def nothing(trial, indices):
    pytest.fail("something was run again")


def campaign(folder, run=in_order, dockings=30):
    return run_campaign(folder, DockCampaignSettings(dockings=dockings), run)


def assert_same_results(one, other):
    for name in FILES:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    summaries = [{**summary_of(folder), "run": None} for folder in (one, other)]
    assert summaries[0] == summaries[1]


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reference")
    campaign(folder)
    return folder


def test_files_say_what_happened(reference):
    summary, rows = summary_of(reference), csv_rows(reference / "campaign.csv")
    assert [int(row["index"]) for row in rows] == list(range(30))
    docked = [row for row in rows if row["result"] == "docked"]
    assert summary["docked"] == len(docked) < 30
    assert all(abs(float(row["lateral_error_m"])) <= 0.004 for row in docked)
    assert (summary["seed"], summary["run"]["dockings"]) == (1, 30)
    assert summary["run"]["sim_time_s"] == pytest.approx(summary["sim_time_s"])
    assert (reference / "campaign.png").read_bytes().startswith(b"\x89PNG")
    scenario = draw_scenario(DrawSettings(), 7)
    assert tuple(float(rows[7][f"start_{axis}_m"]) for axis in "xy") == scenario.start[:2]


def test_a_stopped_campaign_goes_on_where_it_was_and_the_order_does_not_matter(
    reference, tmp_path
):
    # A finished one can be enlarged.
    campaign(tmp_path, dockings=4)
    (tmp_path / "summary.json").unlink()
    for count in (9, 0):
        with pytest.raises(KeyboardInterrupt):
            campaign(tmp_path, stopping_after(count, interrupt))
        assert not (tmp_path / "summary.json").exists()
    done = []

    def remember(trial, indices):
        done.extend(indices)
        return shuffled(trial, indices)

    campaign(tmp_path, remember)
    assert len(done) == 30 - 13
    assert_same_results(tmp_path, reference)


@cases("dockings: [30, 10]")
def test_a_finished_campaign_runs_nothing_again(reference, tmp_path, dockings):
    shutil.copy(reference / "dockings.jsonl", tmp_path)
    summary = campaign(tmp_path, nothing, dockings)
    assert summary["dockings"] == dockings
    assert summary["run"]["real_time_factor"] is None
    assert describe(summary)[0].startswith(f"{summary['docked']} of {dockings} docked")
    assert len((tmp_path / "dockings.jsonl").read_text().splitlines()) == 31


def test_what_has_crashed_is_reported_and_the_rest_goes_on(tmp_path):
    def run(trial, indices):
        for index, record in in_order(trial, indices):
            yield index, TaskLostError("killed\nit") if index == 2 else record

    summary = campaign(tmp_path, run, dockings=5)
    assert summary["failures"]["crashed"] == 1
    assert 2 in summary["failed_indices"]
    row = csv_rows(tmp_path / "campaign.csv")[2]
    assert (row["result"], row["message"], row["end_x_m"]) == ("crashed", "killed it", "")


def test_an_error_of_the_docking_itself_is_a_crash_too():
    def broken(scenario):
        raise ZeroDivisionError("division by zero")

    record = run_trial(DrawSettings(), 3, broken)
    assert record["result"] == "crashed"
    assert record["message"] == "ZeroDivisionError: division by zero"
    assert list(record) == list(fake_trial(DrawSettings(), 3))


@cases("""
values, result:
  - [{}, docked]
  - [{wall_contacts: 1}, wall_contact]
  - [{error_name: TIMED_OUT}, timed_out]
  - [{lateral_error_m: -0.0031}, inaccurate]
""")
def test_a_docking_counts_only_if_it_is_true(values, result):
    right = {"error_name": "NONE", "lateral_error_m": 0.0, "yaw_error_deg": 0.0}

    def dock(scenario):
        return outcome_of(scenario, **{**right, "distance_error_m": 0.0, **values})

    assert run_trial(DrawSettings(), 0, dock)["result"] == result


def trials_in_turn(indices):
    return [run_trial(DrawSettings(5), index) for index in indices]


@pytest.mark.long
def test_a_docking_does_not_depend_on_those_before_it():
    with get_context("spawn").Pool(2, maxtasksperchild=1) as pool:
        alone, after_others = pool.map(trials_in_turn, [(7,), (1, 0, 7)], chunksize=1)
    assert alone[-1] == after_others[-1]


def test_killed_it_goes_on_with_what_it_has(reference, tmp_path):
    run = stopping_after(9, die)
    killed = get_context("fork").Process(target=campaign, args=(tmp_path, run))
    killed.start()
    killed.join()
    assert killed.exitcode == -signal.SIGKILL
    log = tmp_path / "dockings.jsonl"
    # The machine itself may fail as well, within a line.
    log.write_bytes(log.read_bytes()[:-7])
    assert campaign(tmp_path)["run"]["dockings"] == 30 - 8
    assert_same_results(tmp_path, reference)
