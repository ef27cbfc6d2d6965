import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from alike import lines_of, lines_of_figure
from bullet_lab.msg import PluginDescription
from shared import cases

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
    outputs=("/odom", "/bump"), tags_not_simulated=("warp",),
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
# Events have no rate.
KINDS = {
    "/odom": "nav_msgs/Odometry",
    "/joint_states": "sensor_msgs/JointState",
    "/bump": "kobuki_msgs/BumperEvent",
}


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


def test_a_rate_is_that_of_the_stamps():
    count = Count("a/B", 20.0)
    for stamp in range(5):
        count.note(stamp * 50_000_000)
    assert count.rate() == pytest.approx(20.0)
    few = Count("a/B", 20.0)
    few.note(0)
    assert few.rate() is None


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
    assert shared.summary(True, {})["off_rate"] == []


# Parts of a drive: what the odometry reports, what is true, and more of it.
WELL = """
- [metre, 1.0, 0.9, {}]
- [turn, 365.0, 330.0, {}]
- [turn, 361.0, 240.0, {}]
# It is slow to brake, and knows it.
- [metre, 2.5, 2.6, {}]
- [metre, null, 1.3, {turned: 3.0}]
# A robot that comes off its line is off, too.
- [metre, 1.0, 1.0, {aside: 0.03}]
"""
BADLY = """
- [metre, 0.71, 0.71, {late: true, touched: [wall]}]
- [metre, 1.0, 0.61, {touched: ["r1::base"]}]
- [metre, 0.32, 0.32, {late: true}]
- [metre, null, -0.5, {late: true}]
# The odometry is wrong by far.
- [metre, 0.4, 1.5, {}]
- [metre, 1.0, 0.01, {}]
- [metre, null, 0.0, {late: true, causes: [none of its joints turn, it stands on base]}]
- [turn, -1636.8, -1636.8, {late: true}]
# A turn may slip where nothing is touched, a metre may not.
- [turn, 361.0, 240.0, {touched: [wall]}]
- [turn, 361.0, 100.0, {}]
- [metre, 1.0, 0.6, {}]
"""


def legs(text):
    """Return the parts of a drive."""
    kinds = {"metre": metre, "turn": turn}
    return [kinds[kind](*poses, **more) for kind, *poses, more in yaml.safe_load(text)]


def reports(folder):
    """Reports of a robot that is driven, of one that cannot be, and of one to look at."""
    cart = RobotReport(folder, ROBOT, KINDS)
    for stamp in range(4):
        cart.counts["/odom"].note(stamp * 100_000_000)
    for step, name in itertools.product(range(3), (TRUTH, ODOMETRY)):
        assert cart.take(name, Reading(step, (0.1 * step, 0.0, 0.0)))
        assert not cart.take(name, Reading(step, (9.0, 0.0, 0.0)))
    cart.picture = np.zeros((6, 8, 3), np.uint8)
    cart.legs += legs(WELL)
    refused = PluginDescription(acts=True, refused=("arm (effort_controllers/Arm)",))
    arm = RobotReport(folder, Robot("ur5", plugins=(refused,), choice=("ur5", "ur6")), KINDS)
    arm.not_started, arm.pauses = ["tf/view: there is no ROS package 'tf'"], 2
    arm.legs = legs(BADLY)
    return cart, arm, RobotReport(folder, Robot("lamp", plugins=(WHEELS, SONAR)), KINDS)


def test_all_that_is_told_of_a_robot_is_as_before(tmp_path, as_before):
    told = []
    for report, fails in zip(reports(tmp_path), (False, True, False)):
        report.finish()
        assert (tmp_path / "robot.md").read_text() == report.table()
        summary = report.summary(True, {"more": 1})
        figure = report.figures(summary)["robot.png"]
        told += [report.table(), *lines_of(summary, "summary"), *lines_of_figure(figure)]
        errors = [leg.figures()["odometry_error_percent"] for leg in report.legs]
        told += [report.line(summary), *lines_of(errors, "errors")]
        assert report.has_failed(summary) == fails
        assert [leg.figures()["failed"] for leg in report.legs] == [fails] * len(report.legs)
    as_before(told, "robot.txt")


def test_the_truth_decides_while_odometry_pauses():
    part = metre(0.5, 1.1)
    assert not part.is_done(odometry_pauses=False)
    assert part.is_done(odometry_pauses=True)


@cases("turned, done: [[-80.0, false], [-91.0, true], [300.0, false]]")
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
