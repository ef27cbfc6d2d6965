import json
import math

import numpy as np
import pytest

from bullet_lab.core.files import SeriesError
from bullet_lab.reports import Reading
from bullet_lab.reports.sensors import DISTANCES, BeaconsReport

BEACONS = {"a": (3.0, 4.0), "b": (-1.0, 0.0)}


def recorded(folder):
    recording = BeaconsReport(folder, BEACONS)
    recording.take("odom", Reading(100, (0.0, 0.0, 0.5)))
    recording.take("a/range", Reading(100, (5.25,)))
    recording.take("b/range", Reading(100, (1.0,)))
    return recording


def rows(folder):
    return [line.split(",") for line in (folder / DISTANCES).read_text().splitlines()]


def test_a_row_is_there_once_all_of_it_is(tmp_path):
    recording = BeaconsReport(tmp_path, BEACONS)
    recording.take("a/range", Reading(100, (5.25,)))
    recording.take("odom", Reading(100, (0.0, 0.0, 0.5)))
    assert len(rows(tmp_path)) == 1
    assert recording.newest() is None
    recording.take("b/range", Reading(100, (1.0,)))
    assert rows(tmp_path)[0] == ["stamp", "x", "y", "yaw", "a", "b", "true_a", "true_b"]
    assert [float(v) for v in rows(tmp_path)[1]] == [1e-7, 0.0, 0.0, 0.5, 5.25, 1.0, 5.0, 1.0]
    assert recording.newest() == 100


def test_the_end_sorts_and_trims(tmp_path):
    recording = recorded(tmp_path)
    for stamp in (50, 200):
        recording.take("odom", Reading(stamp, (1.0, 0.0, 0.0)))
        recording.take("a/range", Reading(stamp, (1.0,)))
        recording.take("b/range", Reading(stamp, (2.0,)))
    recording.finish(until=150)
    assert [float(row[0]) for row in rows(tmp_path)[1:]] == [5e-8, 1e-7]


def test_summary_measures_against_the_truth(tmp_path):
    recording = recorded(tmp_path)
    summary = recording.summary(True, {})
    assert summary["closest_m"] == [5.25, 1.0]
    assert summary["largest_error_m"] == [0.25, 0.0]
    json.dumps(summary, allow_nan=False)
    assert BeaconsReport(tmp_path, BEACONS).summary(True, {})["rows"] == 0


@pytest.mark.parametrize("bad", [math.inf, math.nan])
def test_distances_are_finite(tmp_path, bad):
    recording = BeaconsReport(tmp_path, BEACONS)
    with pytest.raises(SeriesError, match=f"^a distance of {bad}$"):
        recording.take("a/range", Reading(100, (bad,)))


def test_figure_has_a_curve_over_the_truth_for_each_beacon(tmp_path):
    recording = recorded(tmp_path)
    recording.take("odom", Reading(200, (1.0, 0.0, 0.5)))
    recording.take("a/range", Reading(200, (4.0,)))
    recording.take("b/range", Reading(200, (2.0,)))
    below = recording.figures({})["distances.png"].axes[1]
    drawn = [line.get_ydata() for line in below.lines if len(line.get_ydata())]
    np.testing.assert_allclose(drawn[0], [5.0, math.hypot(2.0, 4.0)])
    np.testing.assert_allclose(drawn[1], [5.25, 4.0])
    assert len(drawn) == 4
