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
    name="wheels", filename="libwheels.so", acts=True, rate=20.0, inputs=("/go",),
    outputs=("/odom",), tags_not_simulated=("warp",),
)  # fmt: skip
SONAR = PluginDescription(name="sonar", filename="libsonar.so")
ARM_TYPE = "position_controllers/JointPositionController"
ARM = SimpleNamespace(name="arm", type=ARM_TYPE, state="running")
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


def metre(reported, true, aside=0.0, turned=0.0, seconds=5.0, **more):
    """Return a part of a metre; `reported` is None without odometry."""
    odometry = [] if reported is None else moved(reported)
    return Leg("metre", "ahead_m", 1.0, odometry, moved(true, aside, turned), seconds, **more)


def turn(reported, true, **more):
    odometry, truth = moved(turned=reported), moved(turned=true)
    return Leg("turn", "turned_deg", 360.0, odometry, truth, 43.7, **more)


def moved(ahead=0.0, aside=0.0, turned=0.0):
    """Return poses of a robot that moves so far (m, m, degrees)."""
    yaws = np.radians(np.linspace(0.0, turned, 100))
    return [(0.0, 0.0, 0.0), *((ahead, aside, yaw) for yaw in yaws.tolist())]


def test_a_displacement_is_measured_along_the_first_heading_and_counts_whole_turns():
    figures = displacement([(1.0, 2.0, math.pi / 2), (1.1, 2.5, 1.0)])
    assert (figures["ahead_m"], figures["aside_m"]) == pytest.approx((0.5, -0.1))
    turning = [(0.0, 0.0, math.remainder(0.1 * k, math.tau)) for k in range(100)]
    assert displacement(turning)["turned_deg"] == pytest.approx(math.degrees(9.9))


@pytest.mark.parametrize(
    "one, error",
    [
        (metre(0.98, 1.0), 2.0),
        # A robot that comes off its line is off, too.
        (metre(1.0, 1.0, aside=0.03), 3.0),
        (turn(364.0, 350.0), 4.0),
        (metre(None, 1.0), None),
        (metre(1.0, 0.01), None),
    ],
)
def test_the_error_of_odometry(one, error):
    assert one.error() == (error if error is None else pytest.approx(error))


def test_a_rate_is_that_of_the_stamps():
    count = Count("a/B", 20.0)
    for stamp in range(5):
        count.note(stamp * 50_000_000)
    assert count.rate() == pytest.approx(20.0)
    few = Count("a/B", 20.0)
    few.note(0)
    assert few.rate() is None


def test_events_have_no_rate():
    assert Count("kobuki_msgs/BumperEvent", 50.0).figures()["declared_hz"] is None


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
    report.legs.append(metre(1.0, 1.0))
    cells = cells_of(report)
    assert ["wheels", "libwheels.so", "yes", "/go", "/odom", "20", "warp"] in cells
    assert ["sonar", "libsonar.so", "**no**", "", "", "", ""] in cells
    assert ["/odom", "nav_msgs/Odometry", "20", "10.00", "4"] in cells
    assert ["arm", ARM_TYPE, "running"] in cells
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
    slow, fast, own = (
        PluginDescription(rate=rate, outputs=topics)
        for rate, topics in (
            (20.0, ("/joint_states", "/odom")), (100.0, ("/joint_states",)), (0.0, ("/odom",)),
        )
    )  # fmt: skip
    assert declared_rates((slow, fast, own)) == {"/joint_states": 120.0, "/odom": 0.0}
    # The other robot's plugin publishes on the topic, too.
    shared = RobotReport(tmp_path, Robot("cart", plugins=(slow,)), KINDS, (fast,))
    for stamp in range(12):
        shared.counts["/joint_states"].note(stamp * 10**9 // 120)
    assert shared.off_rate() == []


@pytest.mark.parametrize(
    "one, line",
    [
        (
            metre(0.71, 0.71, late=True, touched=("wall",)),
            "metre: 0.71 of 1 m: touches wall, out of time",
        ),
        (metre(1.0, 0.61, touched=("r1::base",)), "metre: 0.61 of 1 m: touches r1::base"),
        (metre(0.32, 0.32, late=True), "metre: 0.32 of 1 m: out of time after 5 s"),
        (metre(None, -0.5, late=True), "metre: -0.50 of 1 m: drove the other way, out of time"),
        # The odometry is wrong by far.
        (metre(0.4, 1.5), "metre: 1.50 of 1 m, turned by"),
        (metre(1.0, 0.01), "metre: it does not move (0.010 m of 1)"),
        (
            metre(None, 0.0, late=True, causes=("none of its joints turn", "it stands on base")),
            "metre: it does not move (0.000 m of 1): none of its joints turn, it stands on base, "
            "out of time after 5 s",
        ),
        (
            turn(-1636.8, -1636.8, late=True),
            "turn: -1636.80 of 360 °: turned the other way, out of time after 44 s",
        ),
        # A turn may slip where nothing is touched, a metre may not.
        (turn(361.0, 240.0, touched=("wall",)), "turn: 240.00 of 360 °: touches wall;"),
        (turn(361.0, 100.0), "turn: 100.00 of 360 °;"),
        (metre(1.0, 0.6), "metre: 0.60 of 1 m, turned by"),
    ],
)
def test_a_robot_that_did_not_do_what_it_was_asked(one, line):
    assert one.has_failed() and one.figures()["failed"]
    assert one.line().startswith(line)


@pytest.mark.parametrize(
    "one, line",
    [
        (metre(1.0, 0.9), "metre: 0.900 m, turned by 0.00° on the way;"),
        (turn(365.0, 330.0), "turn: 330.000 °;"),
        (turn(361.0, 240.0), "turn: 240.00 of 360 °: wheels slip; its odometry says 361.000 °"),
        # It is slow to brake, and knows it.
        (metre(2.5, 2.6), "metre: 2.600 m,"),
        (metre(None, 1.3, turned=3.0), "metre: 1.300 m, turned by 3.00° on the way;"),
    ],
)
def test_a_robot_that_did_what_it_was_asked(one, line, report):
    assert not one.has_failed()
    assert one.reasons() == (["wheels slip"] if "slip" in line else [])
    assert one.line().startswith(line)
    report.legs.append(one)
    assert not report.has_failed({})


def test_what_could_not_be_is_in_the_report(tmp_path):
    kind = "effort_controllers/JointTrajectoryController"
    row = PluginDescription(acts=True, refused=(f"arm ({kind})",))
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
    part = metre(0.5, 1.1)
    assert not part.is_done(odometry_pauses=False)
    assert part.is_done(odometry_pauses=True)


@pytest.mark.parametrize("turned, done", [(-80.0, False), (-91.0, True), (300.0, False)])
def test_a_turn_the_other_way_ends_early(turned, done):
    assert turn(0.0, turned).is_done(odometry_pauses=True) == done


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
