"""How the finds of the marker are judged, and what comes of it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from alike import lines_of, lines_of_figure
from shared import cases
from study_runs import backwards, csv_rows, names_in, summary_of
from test_trial import CAMERA, cell

from bullet_lab.simulation.rendering import driver_name
from bullet_lab.studies.detection_range.study import (
    RangeSettings,
    describe,
    found_range,
    heat_map,
    range_figure,
    ranges_of,
    run_detection_range,
    tasks,
)
from bullet_lab.studies.detection_range.trial import (
    WORLDS,
    Frame,
    MarkerImage,
    PrintedMarker,
    camera_pose,
    cell_row,
    in_optical_frame,
    judge,
)
from bullet_lab.studies.worlds import LIGHTS
from bullet_lab.vision.marker_pose import ObservedMarker, estimate_pose

WANTED = WORLDS["docking"][0]
# Places of other markers.
LEFT, RIGHT = (3.3, 0.9, 0.5), (3.3, -0.9, 0.5)


def seen(printed, pose, identifier=0, shift=0.0):
    """Return what a perfect detector would say of a marker; `shift` moves one corner, px."""
    corners = CAMERA.project(in_optical_frame(pose, printed.corners()))
    corners[2] += shift
    estimate = estimate_pose(corners, printed.size, CAMERA)
    return ObservedMarker(identifier, corners, 0, 1.0, np.eye(8), printed.size, estimate)


def judged(pose, *markers, others=()):
    return judge(list(markers), pose, (WANTED, *others), CAMERA)


def counts(frame):
    return frame.found, frame.others, frame.doubles, frame.false


# ---- Judging ----


def test_a_perfect_find_has_no_errors():
    pose = camera_pose(1.0, math.radians(20.0), 0.03)
    frame = judged(pose, seen(WANTED, pose))
    assert counts(frame) == (True, 0, 0, 0)
    assert abs(frame.distance_error) < 1e-4 and frame.lateral_error < 1e-4
    assert frame.rotation_error < 1e-3 and not frame.flipped


def test_errors_are_measured_against_the_truth():
    pose = camera_pose(1.0, 0.3)
    nearer = judged(pose, seen(WANTED, camera_pose(0.99, 0.3)))
    assert nearer.distance_error == pytest.approx(-0.01, abs=2e-4)
    turned = judged(pose, seen(WANTED, camera_pose(1.0, 0.3, 0.01)))
    assert turned.lateral_error == pytest.approx(0.01, rel=0.03)
    assert turned.rotation_error == pytest.approx(0.01, rel=0.05)


def test_detections_are_assigned_by_their_position():
    pose = camera_pose(3.0, 0.0)
    other, elsewhere = (PrintedMarker(*one) for one in ((0.35, LEFT), (0.2, RIGHT)))
    found = [seen(marker, pose) for marker in (other, WANTED, WANTED, elsewhere)]
    frame = judged(pose, *found, others=(other,))
    assert counts(frame) == (True, 1, 1, 1)
    frame = judged(pose, found[0], others=(other,))
    assert counts(frame) == (False, 1, 0, 0)
    assert math.isnan(frame.distance_error)


@cases("""
"off":
  - {identifier: 3}
  - {shift: 20.0}
""")
def test_another_id_or_corners_that_are_off_are_false(off):
    pose = camera_pose(1.0, 0.0)
    frame = judged(pose, seen(WANTED, pose, **off))
    assert counts(frame) == (False, 0, 0, 1)


def test_a_cell_comes_down_to_rates_and_spreads(as_before):
    frames = (
        Frame(True, 1, 0, 0, 0.01, 0.002, math.radians(2.0)),
        Frame(True, 0, 1, 0, -0.03, 0.004, math.radians(4.0), True),
        Frame(False, 0, 0, 2),
    )
    told = []
    for place, seen_there in ((cell(2.0, 30.0), frames), (cell(2.0), frames[2:])):
        told += lines_of(cell_row(place, True, seen_there, 6.25), "cell")
    as_before(told, "cells.txt")


# ---- Ranges ----


def rows_of(rates, bearing=0.0, world="marker_panel", light="default"):
    return [
        {
            "world": world,
            "light": light,
            "distance_m": distance,
            "bearing_deg": bearing,
            "frames": 20,
            "found": round(rate * 20),
            "rate": rate,
            "visible": True,
            **{f"{kind}_detections": 0 for kind in ("other", "double", "false")},
        }
        for distance, rate in rates.items()
    ]


@cases("""
rates, bearing, closest, farthest:
  # Shares of finds by distance, the bearing that is asked for, and the ends of the range.
  - - {0.3: 1.0, 0.4: 0.9, 0.5: 0.95, 2.0: 1.0, 4.0: 1.0, 5.0: 0.94, 6.0: 1.0, 7.0: 1.0}
    - 0
    - 0.5
    - 4.0
  - [{0.3: 0.1, 0.4: 1.0, 0.5: 0.0}, 0, 0.4, 0.4]
  - [{0.3: 0.1}, 0, null, null]
  - [{0.3: 1.0, 4.0: 1.0}, 30, null, null]
""")
def test_the_range_is_the_longest_without_a_gap(rates, bearing, closest, farthest):
    assert found_range(rows_of(rates), bearing) == (closest, farthest)


def test_the_summary_has_the_ranges_of_each_world_and_light(as_before):
    rows = rows_of({0.34: 1.0, 4.0: 1.0, 5.0: 1.0, 6.0: 0.5})
    rows += rows_of({1.0: 1.0, 4.0: 0.95}, bearing=30.0)
    rows += rows_of({1.0: 1.0}, light="dark")
    rows += rows_of({1.0: 0.0}, world="docking")
    ranges = ranges_of(rows)
    lines = describe({"ranges": ranges, "dots": {"frames": 8, "false_detections": 2}})
    as_before([*lines_of(dict(enumerate(ranges)), "range"), *lines], "ranges.txt")


# ---- Figures ----


def test_the_picture_is_drawn_of_whatever_was_tried():
    rows = [
        *rows_of({1.0: 0.0}, light="dark"),
        *rows_of({1.0: 0.0}, bearing=30.0, light="dark"),
        *rows_of({1.0: 0.5}, world="docking", light="dark"),
    ]
    figure = range_figure(rows, {})
    assert "found from nowhere" in figure._suptitle.get_text()
    assert len(heat_map("marker_panel", rows[:2]).axes) == 1


def test_the_picture_names_the_ends_of_the_range_and_shows_what_is_seen_from_there(as_before):
    rows = rows_of({0.5: 1.0, 1.0: 1.0, 2.0: 1.0, 3.0: 0.2, 4.0: 0.0})
    picture = np.zeros((480, 640), np.uint8)
    corners = np.array([[[300, 200], [340, 200], [340, 240], [300, 240]]], dtype=float)
    found, missed = MarkerImage(picture, corners), MarkerImage(picture, np.zeros((0, 4, 2)))
    pictures = {
        ("marker_panel", row["distance_m"]): found if row["found"] > 10 else missed for row in rows
    }
    figure = range_figure(rows, pictures)
    assert "from 0.5 m to 2 m" in figure._suptitle.get_text()
    as_before(lines_of_figure(figure), "range.txt")


def test_a_heat_map_tells_hidden_cells_from_those_where_nothing_is_found(as_before):
    rows = rows_of({1.0: 0.0, 2.0: 0.0, 3.0: 0.955})
    rows[1]["visible"] = False
    as_before(lines_of_figure(heat_map("docking", rows)), "heat_map.txt")


# ---- The job ----

SMALL = RangeSettings(("marker_panel", "docking"), ("default",), (0.5, 4.0), (0.0, 30.0), 2, 3, 5)


def test_worlds_but_two_are_tried_in_their_own_light():
    settings = RangeSettings(distances=(1.0,), bearings=(0.0,), dots=60)
    of_cells, of_dots = tasks(settings)
    cells = [task.args[0] for task in of_cells]
    assert [c.light for c in cells if c.world == "docking"] == list(LIGHTS)
    assert [c.light for c in cells if c.world == "docking_dots"] == ["default"]
    assert [task.args[2] for task in of_dots] == [25, 25, 10]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("range")
    return folder, run_detection_range(folder, SMALL)


def test_the_job_leaves_table_maps_picture_and_summary(results):
    folder, summary = results
    assert names_in(folder) == {
        *("summary.json", "cells.csv", "detection_range.png"),
        *("heat_map_marker_panel.png", "heat_map_docking.png"),
    }
    assert summary_of(folder) == summary
    panel, docking = summary["ranges"]
    assert (panel["farthest_frontal_m"], docking["farthest_30deg_m"]) == (4.0, 0.5)
    assert (summary["seed"], summary["frames_per_cell"]) == (5, 2)
    assert summary["renderer"] == driver_name()
    assert (summary["dots"]["frames"], summary["dots"]["false_detections"]) == (3, 0)
    rows = csv_rows(folder / "cells.csv")
    assert len(rows) == 8
    (hidden,) = [row for row in rows if row["visible"] == "false"]
    assert (hidden["distance_m"], hidden["bearing_deg"], hidden["found"]) == ("4", "30", "0")


def test_a_world_without_room_has_no_heat_map(tmp_path):
    settings = replace(SMALL, worlds=("docking", "marker_panel"), distances=(1.0,), dots=0)
    run_detection_range(tmp_path, replace(settings, bearings=(30.0,), frames=1))
    assert "heat_map_marker_panel.png" in names_in(tmp_path)
    assert "heat_map_docking.png" not in names_in(tmp_path)


def test_the_order_of_the_work_makes_no_difference(results, tmp_path):
    run_detection_range(tmp_path, SMALL, backwards)
    assert names_in(results[0]) == names_in(tmp_path)
    for name in names_in(tmp_path):
        assert (tmp_path / name).read_bytes() == (results[0] / name).read_bytes(), name
