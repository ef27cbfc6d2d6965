"""Tests of two campaigns side by side."""

import json
from dataclasses import replace

from alike import lines_of
from scipy import stats
from shared import cases, refuses
from study_runs import csv_rows
from test_dock_campaign import fake_trial
from test_dock_summary import record

from bullet_lab.core.files import FileError
from bullet_lab.studies.dock_campaign.compare import (
    compare,
    figures_of,
    paired_figures,
    quantile,
)
from bullet_lab.studies.dock_campaign.results import LOG, DockLog
from bullet_lab.studies.dock_campaign.study import DockCampaignSettings
from bullet_lab.studies.dock_campaign.trial import DrawSettings, draw_scenario


def logged(folder, dockings, **draw):
    folder.mkdir()
    settings = DockCampaignSettings(dockings=dockings, **draw)
    log = DockLog(folder / LOG, settings.drawn_from())
    for index in range(dockings):
        log.append(fake_trial(settings, index))
    log.close()


def test_what_is_drawn_does_not_depend_on_the_controller():
    for index in range(20):
        ours = draw_scenario(DrawSettings(), index)
        other = draw_scenario(DrawSettings(controller="graceful"), index)
        assert other == replace(ours, controller="graceful")


@cases("part, count: [[0.5, 15], [0.5, 200], [0.9, 100], [0.99, 1000]]")
def test_intervals_of_quantiles_are_the_narrowest_with_the_confidence(part, count):
    # The number of values below the quantile, whatever their law, has a binomial distribution.
    found, below = quantile(range(count), part), stats.binom(count, part)
    low, high = int(found["low"]), int(found["high"])
    assert below.cdf(low) < 0.025 <= below.cdf(low + 1)
    assert below.cdf(high - 1) < 0.975 <= below.cdf(high)


def test_few_values_leave_the_far_end_open():
    found = quantile(range(100), 0.99)
    assert found["high"] is None
    assert found["low"] < found["value"]
    assert quantile([], 0.5) == {"value": None, "low": None, "high": None}


def test_figures_of_one_campaign_and_of_pairs_are_as_before(as_before):
    records = [
        record(0, distance_error_m=0.0),
        record(1, "inaccurate", lateral_error_m=0.02),
        record(2, "inaccurate", lateral_error_m=-0.06),
        record(3, "wall_contact", wall_contacts=1),
        record(4, "not_detected", retries=0),
    ]
    told = [*lines_of(figures_of(records), "one")]
    docked, lost, late = record(0), record(0, "not_detected"), record(0, "timed_out")
    faster = record(0, sim_time_s=27.0)
    paired = paired_figures([docked, docked, lost, late], [faster, lost, docked, late])
    told += lines_of(paired, "pairs")
    told += lines_of(paired_figures([docked] * 6, [late] * 6), "late")
    as_before(told, "compared.txt")


def test_table_picture_and_numbers_are_left(tmp_path):
    logged(tmp_path / "ours", 12)
    logged(tmp_path / "other", 12, controller="graceful")
    lines = compare(tmp_path / "other", tmp_path / "ours" / LOG, 12)
    assert "ours" in lines[0]
    assert "graceful" in lines[0]
    (first, *_) = csv_rows(tmp_path / "other" / "comparison.csv")
    numbers = json.loads((tmp_path / "other" / "comparison.json").read_text())
    figure = numbers["controllers"]["ours"][first["figure"]]
    assert float(first["ours value"]) == figure["value"]
    assert numbers["seed"] == 1
    assert (tmp_path / "other" / "comparison.png").read_bytes().startswith(b"\x89PNG")


def test_other_dockings_are_refused(tmp_path):
    logged(tmp_path / "one", 3)
    logged(tmp_path / "two", 3, seed=2)
    logged(tmp_path / "more", 5)
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / LOG).write_text("{}\n")
    for folder, beside, dockings, said in (
        ("two", "one", 3, "other dockings"),
        ("more", "one", 5, "lacks 2 of 5"),
        ("more", "broken", 5, "not the log"),
    ):
        with refuses(said):
            compare(tmp_path / folder, tmp_path / beside / LOG, dockings)
    with refuses("cannot read", FileError):
        compare(tmp_path / "more", tmp_path / "nowhere", 5)
