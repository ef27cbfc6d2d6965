import math

import numpy as np
import pytest

from bullet_lab.reports import Reading
from bullet_lab.reports.robot import (
    ODOMETRY,
    TRUTH,
    Controller,
    Count,
    Leg,
    PluginRow,
    Robot,
    RobotReport,
    Way,
)

WHEELS = PluginRow("wheels", "libwheels.so", "", True, 20.0, ("/go",), ("/odom",), ("warp",))
SONAR = PluginRow("sonar", "libsonar.so", "nose", False, 0.0, (), (), ())
ROBOT = Robot(
    "cart",
    ("base", "left"),
    ("hinge",),
    (WHEELS, SONAR),
    (Controller("arm", "position_controllers/JointPositionController", "running"),),
    "/go",
    "/odom",
    ("model 'cart': something is odd",),
)
KINDS = {"/odom": "nav_msgs/Odometry", "/joint_states": "sensor_msgs/JointState"}


def way(*poses):
    made = Way()
    for pose in poses:
        made.add(pose)
    return made


def leg(said, true, quantity="ahead_m", asked=1.0):
    figures = {"ahead_m": 0.0, "aside_m": 0.0, "turned_deg": 0.0}
    odometry = None if said is None else {**figures, **said}
    return Leg("metre", quantity, asked, odometry, {**figures, **true}, 5.0)


def test_a_way_is_measured_along_the_first_heading():
    figures = way((1.0, 2.0, math.pi / 2), (1.1, 2.5, 1.0)).figures()
    assert figures["ahead_m"] == pytest.approx(0.5)
    assert figures["aside_m"] == pytest.approx(-0.1)


def test_whole_turns_are_counted():
    turning = way(*((0.0, 0.0, math.remainder(0.1 * k, math.tau)) for k in range(100)))
    assert turning.figures()["turned_deg"] == pytest.approx(math.degrees(9.9))


def test_a_way_of_nothing_has_no_figures():
    assert Way().figures() is None


@pytest.mark.parametrize(
    ("one", "error"),
    [
        (leg({"ahead_m": 0.98}, {"ahead_m": 1.0}), 2.0),
        # A robot that comes off its line is off, too.
        (leg({"ahead_m": 1.0}, {"ahead_m": 1.0, "aside_m": 0.03}), 3.0),
        (leg({"turned_deg": 364.0}, {"turned_deg": 350.0}, "turned_deg", 360.0), 4.0),
        (leg(None, {"ahead_m": 1.0}), None),
        (leg({"ahead_m": 1.0}, {"ahead_m": 0.01}), None),
    ],
)
def test_the_error_of_odometry(one, error):
    assert one.error() == (error if error is None else pytest.approx(error))


def test_a_robot_that_stands_is_said_to():
    assert "it does not move" in leg({"ahead_m": 1.0}, {"ahead_m": 0.01}).line()
    assert "turned by 3.00° on the way" in leg(None, {"ahead_m": 1.0, "turned_deg": 3.0}).line()


def test_a_rate_is_that_of_the_stamps():
    count = Count("a/B", 20.0)
    for stamp in range(5):
        count.note(stamp * 50_000_000)
    assert count.rate() == pytest.approx(20.0)
    few = Count("a/B", 20.0)
    few.note(0)
    assert few.rate() is None


@pytest.fixture
def report(tmp_path):
    return RobotReport(tmp_path, ROBOT, KINDS)


def test_the_table_says_what_acts_and_what_does_not(report):
    for stamp in range(4):
        report.counts["/odom"].note(stamp * 100_000_000)
    report.legs.append(leg({"ahead_m": 1.0}, {"ahead_m": 1.0}))
    lines = report.table().splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert ["wheels", "libwheels.so", "yes", "/go", "/odom", "20", "warp"] in cells
    assert ["sonar", "libsonar.so", "**no**", "", "", "", ""] in cells
    assert ["/odom", "nav_msgs/Odometry", "20", "10.00", "4"] in cells
    assert ["arm", "position_controllers/JointPositionController", "running"] in cells
    assert "- model 'cart': something is odd" in lines
    assert report.off_rate() == ["/odom"]
    assert report.left_out() == ["sonar (libsonar.so)"]


def test_a_topic_that_stays_silent_is_named(report):
    assert report.silent() == ["/odom"]


def test_what_it_leaves(report, tmp_path):
    for name in (TRUTH, ODOMETRY):
        for step in range(3):
            assert report.take(name, Reading(step, (0.1 * step, 0.0, 0.0)))
        assert not report.take(name, Reading(2, (9.0, 0.0, 0.0)))
    report.picture = np.zeros((6, 8, 3), np.uint8)
    report.finish()
    summary = report.summary(True, {"more": 1})
    assert summary["robot"]["plugins"][0]["tags_not_simulated"] == ("warp",)
    assert summary["more"] == 1
    assert set(report.figures(summary)) == {"robot.png"}
    assert (tmp_path / "robot.md").read_text() == report.table()
    assert len((tmp_path / "truth.tum").read_text().splitlines()) == 3


def test_a_robot_without_a_drive_is_shown(tmp_path):
    report = RobotReport(tmp_path, Robot("lamp"), {})
    assert "shown, not driven" in report.line({})
    assert "nothing listens to any" in report.table()
