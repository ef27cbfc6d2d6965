import math

import numpy as np
import pytest

from bullet_lab.reports import Reading
from bullet_lab.reports.sensors import SensorsReport

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
    np.testing.assert_allclose(points, [(1.2, 0.0), (-1.8, 0.0)], atol=1e-12)


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
    assert figures["nearest_scan_m"] == 1.0
    assert figures["nearest_range_m"] == 0.0
    assert figures["mean_upward_acceleration_mps2"] == pytest.approx(9.8)
    assert figures["greatest_turn_rate_radps"] == pytest.approx(0.3)
    assert (figures["touched"], figures["first_touch_s"]) == (["box", "crate"], 0.1)
    assert figures["median_push_N"] == pytest.approx(5.0)


def test_the_picture_has_a_panel_for_each_sensor(recording):
    figure = recording.figures({})["sensors.png"]
    assert len(figure.axes) == 6
    assert all(axes.lines for axes in figure.axes)
