import json
import math

import pytest
from alike import lines_of, lines_of_figure
from shared import cases, refuses

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


def test_a_report_of_sensors_is_as_before(recording, tmp_path, as_before):
    recording.take("bumper", Reading(200 * MS, (0, 0.0, 0.0, 0.0), ["crate", "box", "crate"]))
    figures = recording.summary(True, {})
    figure = recording.figures(figures)["sensors.png"]
    told = [*lines_of(figures, "summary"), *lines_of_figure(figure)]
    # The robot is at (0.2, 0) and looks along y: the first ray goes along x, the third along -x.
    told += lines_of(recording.scan_points(), "scan")
    as_before(told, "sensors.txt")


def test_a_scan_before_all_odometry_is_left_out(tmp_path):
    found = SensorsReport(tmp_path, 1)
    figures = found.summary(True, {})
    assert figures["median_push_N"] is figures["nearest_scan_m"] is None
    found.series["scan"].add(0, (1.0,))
    assert found.scan_points().shape == (0, 2)
    found.series["odom"].add(50 * MS, (0.0, 0.0, 0.0))
    assert found.scan_points().shape == (0, 2)


BEACONS = {"a": (3.0, 4.0), "b": (-1.0, 0.0)}


def measure(recording, stamp, pose, *distances):
    recording.take("odom", Reading(stamp, pose))
    for beacon, distance in zip(BEACONS, distances):
        recording.take(f"{beacon}/range", Reading(stamp, (distance,)))


def test_a_report_of_beacons_is_as_before(tmp_path, as_before):
    report, told = BeaconsReport(tmp_path, BEACONS), []

    def tell():
        told.extend((tmp_path / DISTANCES).read_text().splitlines())
        told.append(f"newest: {report.newest()}")

    # A row is there once all of it is.
    report.take("a/range", Reading(100, (5.25,)))
    report.take("odom", Reading(100, (0.0, 0.0, 0.5)))
    tell()
    report.take("b/range", Reading(100, (1.0,)))
    tell()
    for stamp in (50, 200, 150):
        measure(report, stamp, (1.0, 0.0, 0.0), 4.0, 2.0)
    # The end sorts and trims.
    report.finish(until=150)
    tell()
    summary = report.summary(True, {})
    json.dumps(summary, allow_nan=False)
    told += lines_of(summary, "summary")
    told += lines_of_figure(report.figures(summary)["distances.png"])
    (tmp_path / "empty").mkdir()
    told += lines_of(BeaconsReport(tmp_path / "empty", BEACONS).summary(True, {}), "empty")
    told = [line.replace(",", " ") for line in told]
    as_before(told, "beacons.txt")


@cases("bad: [.inf, .nan]")
def test_distances_are_finite(tmp_path, bad):
    with refuses(f"^a distance of {bad}$"):
        BeaconsReport(tmp_path, BEACONS).take("a/range", Reading(100, (bad,)))
