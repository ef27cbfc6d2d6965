"""The figures of a campaign."""

import json

from alike import lines_of

from bullet_lab.studies.dock_campaign.results import campaign_summary


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


def campaigns():
    """Names and records of campaigns: dockings that succeed, and some that do not."""
    yield "docked", [record(index) for index in range(100)]
    # Errors of dockings that fail do not count, but those of all that say they have docked.
    not_docked = [
        record(1, "not_detected", lateral_error_m=3.0),
        crashed(2),
        record(3, "wall_contact", wall_contacts=4, world="docking_dots"),
        record(4, "not_detected"),
    ]
    yield "mixed", [record(0), *not_docked]
    yield "inaccurate", [record(0), record(1, "inaccurate", lateral_error_m=0.0031)]
    yield "crashed", [crashed(0)]


def test_summaries_are_as_before(as_before):
    told = []
    for name, records in campaigns():
        summary = campaign_summary(records)
        json.dumps(summary, allow_nan=False)
        told += lines_of(summary, name)
    as_before(told, "summaries.txt")
