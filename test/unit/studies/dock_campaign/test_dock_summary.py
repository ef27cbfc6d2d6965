"""The figures of a campaign."""

import json

import pytest

from bullet_lab.studies.dock_campaign.results import (
    campaign_summary,
    error_figures,
)


def record(index, result="docked", **values):
    return {
        "index": index,
        "world": "docking",
        "light": "default",
        "odometry": "odom",
        "result": result,
        "distance_error_m": 0.001,
        "lateral_error_m": -0.002,
        "yaw_error_deg": 0.1,
        "wall_contacts": 0,
        "retries": 1,
        "sim_time_s": 30.0,
        "renderer": "egl",
        "distance_tolerance_m": 0.005,
        "lateral_tolerance_m": 0.003,
        "yaw_tolerance_deg": 0.4,
        **values,
    }


def crashed(index):
    nothing = ("distance_error_m", "lateral_error_m", "yaw_error_deg")
    rest = ("wall_contacts", "retries", "sim_time_s", "renderer")
    return record(index, "crashed", **dict.fromkeys((*nothing, *rest)))


def test_all_succeeded():
    found = campaign_summary([record(i) for i in range(100)])
    assert (found["dockings"], found["docked"], found["success_rate"]) == (100, 100, 1.0)
    assert found["success_rate_lower_95"] == pytest.approx(0.05**0.01)
    assert (found["failures"], found["failed_indices"]) == ({}, [])
    assert found["lateral_error_m"] == {"median": 0.002, "p95": 0.002, "p99": 0.002, "max": 0.002}
    assert (found["retries"], found["sim_time_s"]) == (100, 3000.0)


def test_failures_are_counted_by_reason_and_their_errors_are_not():
    records = [
        record(0),
        record(1, "not_detected", lateral_error_m=3.0),
        crashed(2),
        record(3, "wall_contact", wall_contacts=4, world="docking_dots"),
        record(4, "not_detected"),
    ]
    found = campaign_summary(records)
    assert found["docked"] == 1
    assert found["success_rate"] == 0.2
    assert found["failures"] == {"crashed": 1, "not_detected": 2, "wall_contact": 1}
    assert found["failed_indices"] == [1, 2, 3, 4]
    assert found["lateral_error_m"]["max"] == 0.002
    assert (found["wall_contacts"], found["dockings_with_contact"]) == (4, 1)
    assert found["by_world"] == {"docking": "1 of 4", "docking_dots": "0 of 1"}
    assert found["renderers"] == {"egl": 4}


def test_errors_are_of_all_that_say_they_have_docked():
    found = campaign_summary([record(0), record(1, "inaccurate", lateral_error_m=0.0031)])
    assert (found["docked"], found["lateral_error_m"]["max"]) == (1, 0.0031)
    most = {"distance_error_m": 0.005, "lateral_error_m": 0.003, "yaw_error_deg": 0.4}
    assert found["tolerances"] == {"docking": most}


def test_nothing_succeeded():
    found = campaign_summary([crashed(0)])
    assert found["success_rate_lower_95"] == 0.0
    assert found["yaw_error_deg"] == dict.fromkeys(("median", "p95", "p99", "max"))
    assert found["longest_sim_time_s"] is None
    json.dumps(found, allow_nan=False)


def test_error_figures_are_of_magnitudes():
    found = error_figures([-3.0, 1.0, 2.0, 0.0])
    assert found == pytest.approx({"median": 1.5, "p95": 2.85, "p99": 2.97, "max": 3.0})
