import json
import math

import pytest
from numpy.testing import assert_allclose
from shared import cases

from bullet_lab.core.files import LabError
from bullet_lab.reports import Reading
from bullet_lab.reports.sensors import DISTANCES, BeaconsReport, SensorsReport

MS = 1_000_000


@pytest.fixture
def recording(tmp_path):
    found = SensorsReport(tmp_path, 4)
    for k in range(4):
        found.series["odom"].add(50 * k * MS, (0.1 * k, 0.0, math.pi / 2))
        found.series["imu"].add((50 * k + 1) * MS, (0.0, 0.0, 9.8, 0.0, 0.0, -0.1 * k))
        found.series["sonar"].add(50 * k * MS, (3.0 - k,))
        found.series["bumper"].add(50 * k * MS, (k // 2, -3.0 * (k // 2), 4.0 * (k // 2), 0.0))
    ranges = (1.0, math.inf, 2.0, -math.inf)
    found.take("scan", Reading(100 * MS, ranges, (-math.pi / 2, math.pi / 2)))
    return found


def test_scans_are_placed_by_the_pose_of_their_moment(recording):
    points = recording.scan_points()
    # The robot is at (0.2, 0) and looks along y: the first ray goes along x, the third along -x.
    assert_allclose(points, [(1.2, 0.0), (-1.8, 0.0)], atol=1e-12)


def test_a_scan_before_all_odometry_is_left_out(tmp_path):
    found = SensorsReport(tmp_path, 1)
    figures = found.summary(True, {})
    assert figures["median_push_N"] is figures["nearest_scan_m"] is None
    found.series["scan"].add(0, (1.0,))
    assert found.scan_points().shape == (0, 2)
    found.series["odom"].add(50 * MS, (0.0, 0.0, 0.0))
    assert found.scan_points().shape == (0, 2)


def test_summary(recording):
    recording.take("bumper", Reading(200 * MS, (0, 0.0, 0.0, 0.0), ["crate", "box", "crate"]))
    figures = recording.summary(True, {})
    assert figures["messages"] == {"odom": 4, "scan": 1, "range": 4, "imu": 4, "bumper": 5}
    assert figures["touched"] == ["box", "crate"]
    expected = {
        "nearest_scan_m": 1.0,
        "nearest_range_m": 0.0,
        "mean_upward_acceleration_mps2": 9.8,
        "greatest_turn_rate_radps": 0.3,
        "first_touch_s": 0.1,
        "median_push_N": 5.0,
    }
    assert {name: figures[name] for name in expected} == pytest.approx(expected)


def test_the_picture_has_a_panel_for_each_sensor(recording):
    figure = recording.figures({})["sensors.png"]
    assert len(figure.axes) == 6
    assert all(axes.lines for axes in figure.axes)


BEACONS = {"a": (3.0, 4.0), "b": (-1.0, 0.0)}


@pytest.fixture
def beacons(tmp_path):
    recording = BeaconsReport(tmp_path, BEACONS)
    measure(recording, 100, (0.0, 0.0, 0.5), 5.25, 1.0)
    return recording


def measure(recording, stamp, pose, *distances):
    recording.take("odom", Reading(stamp, pose))
    for beacon, distance in zip(BEACONS, distances):
        recording.take(f"{beacon}/range", Reading(stamp, (distance,)))


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


def test_the_end_sorts_and_trims(beacons, tmp_path):
    for stamp in (50, 200):
        measure(beacons, stamp, (1.0, 0.0, 0.0), 1.0, 2.0)
    beacons.finish(until=150)
    assert [float(row[0]) for row in rows(tmp_path)[1:]] == [5e-8, 1e-7]


def test_summary_measures_against_the_truth(beacons, tmp_path):
    summary = beacons.summary(True, {})
    assert summary["closest_m"] == [5.25, 1.0]
    assert summary["largest_error_m"] == [0.25, 0.0]
    json.dumps(summary, allow_nan=False)
    assert BeaconsReport(tmp_path, BEACONS).summary(True, {})["rows"] == 0


@cases("bad: [.inf, .nan]")
def test_distances_are_finite(beacons, bad):
    with pytest.raises(LabError, match=f"^a distance of {bad}$"):
        beacons.take("a/range", Reading(100, (bad,)))


def test_figure_has_a_curve_over_the_truth_for_each_beacon(beacons):
    measure(beacons, 200, (1.0, 0.0, 0.5), 4.0, 2.0)
    below = beacons.figures({})["distances.png"].axes[1]
    drawn = [line.get_ydata() for line in below.lines if len(line.get_ydata())]
    assert_allclose(drawn[:2], [[5.0, math.hypot(2.0, 4.0)], [5.25, 4.0]])
    assert len(drawn) == 4
