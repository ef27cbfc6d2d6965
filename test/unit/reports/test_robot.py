import math
from types import SimpleNamespace

import numpy as np
import pytest
from bullet_lab.msg import PluginDescription

from bullet_lab.reports import Reading
from bullet_lab.reports.robot import (
    ODOMETRY,
    STEERED,
    TRUTH,
    Count,
    Leg,
    Robot,
    RobotReport,
    declared_rates,
    displacement,
)

WHEELS = PluginDescription(
    "wheels", "libwheels.so", "", True, 20.0, ("/go",), ("/odom",), ("warp",), ()
)
SONAR = PluginDescription("sonar", "libsonar.so", "nose", False, 0.0, (), (), (), ())
ARM = SimpleNamespace(
    name="arm", type="position_controllers/JointPositionController", state="running"
)
ROBOT = Robot(
    "cart",
    ("base", "left"),
    ("hinge",),
    (WHEELS, SONAR),
    (ARM,),
    "/go",
    "/odom",
    ("model 'cart': something is odd",),
)
KINDS = {"/odom": "nav_msgs/Odometry", "/joint_states": "sensor_msgs/JointState"}


def leg(reported, true, quantity="ahead_m", asked=1.0, seconds=5.0, **more):
    odometry = [] if reported is None else moved(**reported)
    return Leg("metre", quantity, asked, odometry, moved(**true), seconds, **more)


def moved(ahead_m=0.0, aside_m=0.0, turned_deg=0.0):
    """Return poses of a robot that moves so far."""
    yaws = np.radians(np.linspace(0.0, turned_deg, 100))
    return [(0.0, 0.0, 0.0), *((ahead_m, aside_m, yaw) for yaw in yaws.tolist())]


def test_a_displacement_is_measured_along_the_first_heading():
    figures = displacement([(1.0, 2.0, math.pi / 2), (1.1, 2.5, 1.0)])
    assert figures["ahead_m"] == pytest.approx(0.5)
    assert figures["aside_m"] == pytest.approx(-0.1)


def test_whole_turns_are_counted():
    turning = [(0.0, 0.0, math.remainder(0.1 * k, math.tau)) for k in range(100)]
    assert displacement(turning)["turned_deg"] == pytest.approx(math.degrees(9.9))


@pytest.mark.parametrize(
    "one, error",
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


def test_the_line_of_a_robot_that_stands():
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


def cells_of(report):
    rows = [line.strip("|").split("|") for line in report.table().splitlines()]
    return [[cell.strip() for cell in row] for row in rows]


def test_the_table_lists_what_is_simulated(report):
    assert report.silent() == ["/odom"]
    for stamp in range(4):
        report.counts["/odom"].note(stamp * 100_000_000)
    report.legs.append(leg({"ahead_m": 1.0}, {"ahead_m": 1.0}))
    cells = cells_of(report)
    assert ["wheels", "libwheels.so", "yes", "/go", "/odom", "20", "warp"] in cells
    assert ["sonar", "libsonar.so", "**no**", "", "", "", ""] in cells
    assert ["/odom", "nav_msgs/Odometry", "20", "10.00", "4"] in cells
    assert ["arm", "position_controllers/JointPositionController", "running"] in cells
    assert ["- model 'cart': something is odd"] in cells
    assert report.off_rate() == ["/odom"]
    assert report.left_out() == ["sonar (libsonar.so)"]


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


def test_rates_of_plugins_that_share_a_topic_add_up(tmp_path):
    slow = PluginDescription("slow", "a.so", "", True, 20.0, (), ("/joint_states", "/odom"), (), ())
    fast = PluginDescription("fast", "b.so", "", True, 100.0, (), ("/joint_states",), (), ())
    own = PluginDescription("own", "c.so", "", True, 0.0, (), ("/odom",), (), ())
    assert declared_rates((slow, fast, own)) == {"/joint_states": 120.0, "/odom": 0.0}
    # The other robot's plugin publishes on the topic, too.
    shared = RobotReport(tmp_path, Robot("cart", plugins=(slow,)), KINDS, (fast,))
    for stamp in range(12):
        shared.counts["/joint_states"].note(stamp * 10**9 // 120)
    assert shared.off_rate() == []


@pytest.mark.parametrize(
    "reported, true, late, touched, line",
    [
        (0.71, 0.71, True, ("wall",), "metre: 0.71 of 1 m: touches wall, out of time"),
        (1.0, 0.61, False, ("r1::base",), "metre: 0.61 of 1 m: touches r1::base"),
        (0.32, 0.32, True, (), "metre: 0.32 of 1 m: out of time after 5 s"),
        (None, -0.5, True, (), "metre: -0.50 of 1 m: drove the other way, out of time"),
        # The odometry is wrong by far.
        (0.4, 1.5, False, (), "metre: 1.50 of 1 m, turned by"),
    ],
)
def test_a_robot_that_did_not_do_what_it_was_asked(reported, true, late, touched, line):
    odometry = None if reported is None else {"ahead_m": reported}
    one = leg(odometry, {"ahead_m": true}, late=late, touched=touched)
    assert one.has_failed()
    assert one.figures()["failed"]
    assert one.line().startswith(line)


def test_a_turn_the_other_way():
    turned = {"turned_deg": -1636.8}
    one = leg(turned, turned, "turned_deg", 360.0, 43.7, late=True)
    assert "-1636.80 of 360 °: turned the other way, out of time after 44 s" in one.line()


@pytest.mark.parametrize(
    "turned, touched, line",
    [
        (240.0, (), ": 240.00 of 360 °: wheels slip; its odometry says 361.000 °"),
        (100.0, (), ""),
        (240.0, ("wall",), ": 240.00 of 360 °: touches wall;"),
    ],
)
def test_a_turn_may_slip_where_nothing_is_touched(turned, touched, line):
    reported, true = {"turned_deg": 361.0}, {"turned_deg": turned}
    one = leg(reported, true, "turned_deg", 360.0, touched=touched)
    assert one.has_failed() == ("slip" not in line)
    assert line in one.line()
    # A metre does not slip.
    assert leg({"ahead_m": 1.0}, {"ahead_m": 0.6}).has_failed()


@pytest.mark.parametrize(
    "one",
    [
        leg({"ahead_m": 1.0}, {"ahead_m": 0.9}),
        leg({"turned_deg": 365.0}, {"turned_deg": 330.0}, "turned_deg", 360.0),
        # It is slow to brake, and knows it.
        leg({"ahead_m": 2.5}, {"ahead_m": 2.6}),
        leg(None, {"ahead_m": 1.3}),
    ],
)
def test_a_robot_that_did_what_it_was_asked(one, report):
    assert not one.has_failed()
    assert one.reasons() == []
    report.legs.append(one)
    assert not report.has_failed({})


def test_the_line_has_the_reasons():
    causes = ("none of its joints turn", "it stands on base")
    one = leg(None, {}, seconds=16.0, late=True, causes=causes)
    assert one.line() == (
        "metre: it does not move (0.000 m of 1): none of its joints turn, it stands on base, "
        "out of time after 16 s"
    )


def test_what_could_not_be_is_in_the_report(tmp_path):
    kind = "effort_controllers/JointTrajectoryController"
    row = PluginDescription("c", "control.so", "", True, 0.0, (), (), (), (f"arm ({kind})",))
    robot = Robot("ur5", plugins=(row,), choice=("ur5", "ur6"))
    report = RobotReport(tmp_path, robot, {})
    report.not_started = ["tf/view: there is no ROS package 'tf'"]
    report.pauses = 2
    cells = cells_of(report)
    assert ["arm", kind, "**refused**"] in cells
    assert ["- tf/view: there is no ROS package 'tf'"] in cells
    assert ["- drives ur5 of ur5, ur6: model:=NAME chooses another"] in cells
    assert ["- odometry: none (pauses: 2)"] in cells
    summary = report.summary(True, {})
    assert summary["left_out"] == [f"arm ({kind})"]
    assert summary["not_started"] == report.not_started


def test_the_truth_decides_while_odometry_pauses():
    part = Leg("metre", "ahead_m", 1.0)
    part.odometry += [(0.0, 0.0, 0.0), (0.5, 0.0, 0.0)]
    part.truth += [(0.0, 0.0, 0.0), (1.1, 0.0, 0.0)]
    assert not part.is_done(odometry_pauses=False)
    assert part.is_done(odometry_pauses=True)


@pytest.mark.parametrize("turned, done", [(-80.0, False), (-91.0, True), (300.0, False)])
def test_a_turn_the_other_way_ends_early(turned, done):
    part = Leg("turn", "turned_deg", 360.0, truth=moved(turned_deg=turned))
    assert part.is_done(odometry_pauses=False) == done


@pytest.mark.parametrize(
    "part, steered",
    [
        ({"controllers": (SimpleNamespace(type=STEERED[1]),)}, True),
        ({"plugins": (SimpleNamespace(filename=STEERED[0]),)}, True),
        ({"plugins": (WHEELS,), "controllers": (ARM,)}, False),
    ],
)
def test_which_robots_cannot_turn_on_the_spot(part, steered):
    assert Robot("cart", **part).is_steered() is steered
