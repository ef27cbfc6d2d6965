"""Robots on the floor assume the wheels that errors and correction give them."""

import numpy as np
import pytest
from shared import PACKAGE, cases, refuses

from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.simulation.plugins.wheel_drives import DiffDrive
from bullet_lab.studies.umbmark.robots import FloorRobot

TUTORIALS = PACKAGE / "test" / "tutorials"
CART = str(TUTORIALS / "urdf" / "cart.urdf")
CONTROL = str(TUTORIALS / "config" / "cart.yaml")
CAMERA = "package://bullet_lab/urdf/camera_robot.urdf"
NONE = SystematicErrors()
WRONG = SystematicErrors(diameter_error=0.01, base_error=-0.02)


@pytest.fixture
def built():
    robots = []

    def build(*arguments):
        robots.append(FloorRobot(*arguments))
        return robots[-1]

    yield build
    for robot in robots:
        robot.close()


def roll(robot):
    """Drive straight on; return by how much wheels and robot turn (rad) once they are at speed."""
    plugin = next(p for p in robot._robot.plugins if isinstance(p, DiffDrive))

    def measured():
        return np.array((*(wheel.state().position for wheel in plugin.wheels), robot.pose()[2]))

    robot.drive(0.4, 0.0, 0.5)
    before = measured()
    robot.drive(0.4, 0.0, 0.8)
    return measured() - before


@cases(f"""
files, diameter, base:
  - [["{CAMERA}", ""], 0.28, 0.38]
  - [["{CART}", "{CONTROL}"], 0.16, 0.4]
""")
def test_robots_assume_other_wheels_until_they_are_corrected(built, files, diameter, base):
    left, right = WRONG.diameters
    wrong = built(*files, WRONG, NONE)
    assumed = (0.5 * diameter / left, 0.5 * diameter / right, base / 0.98)
    assert (*wrong.radii, wrong.base) == pytest.approx(assumed)
    corrected = built(*files, WRONG, WRONG)
    assert (*corrected.radii, corrected.base) == pytest.approx((diameter / 2, diameter / 2, base))
    wrong.drive(0.2, 0.0, 0.2)
    assert wrong.odometry[-1][0] > 0.02


def test_a_plugin_drives_by_the_wheels_that_it_assumes(built):
    # The larger wheel is thought to be the smaller one: it gets more speed, and the robot turns.
    left, right, turned = roll(built(CAMERA, "", WRONG, NONE))
    assert right / left == pytest.approx(1.01, rel=1e-3)
    assert turned == pytest.approx(0.14 * (right - left) / 0.38, rel=0.02)
    assert roll(built(CAMERA, "", WRONG, WRONG))[2] == pytest.approx(0.0, abs=1e-4)


@pytest.fixture
def changed(tmp_path):
    """Writes the robot with the camera, changed."""

    def write(*changes):
        text = (PACKAGE / "urdf" / "camera_robot.urdf").read_text()
        for change in changes:
            text = text.replace(*change)
        (tmp_path / "changed.urdf").write_text(text)
        return str(tmp_path / "changed.urdf")

    return write


def test_the_pose_is_that_of_the_middle_between_the_wheels(built, changed):
    moved = changed(*((f'xyz="0 {y} -0.06"', f'xyz="0.03 {y} -0.06"') for y in ("0.19", "-0.19")))
    robot = built(moved, "", NONE, NONE)
    x, y, _ = robot.pose()
    assert (x, y) == pytest.approx((0.03, 0.0), abs=2e-3)
    robot.drive(0.0, 1.0, 1.5)
    # It turns about that.
    assert robot.pose()[2] > 1.0
    assert robot.pose()[:2] == pytest.approx((x, y), abs=2e-3)


@cases(f"""
robot, controller, said:
  - ["{CART}", "", there is no plugin libgazebo_ros_diff_drive.so]
  - ["{CAMERA}", "{CONTROL}", there is no plugin libgazebo_ros_control.so]
  - ["{CART}", "{CART}", cannot read|there is no controller]
""")
def test_robots_without_wheels_to_calibrate_are_refused(robot, controller, said):
    with refuses(said):
        FloorRobot(robot, controller, NONE, NONE)


def test_the_log_says_once_why_a_plugin_does_not_work(changed, caplog):
    robot = changed(("<leftJoint>", "<leftJoint>no_", 1))
    with refuses("there is no plugin libgazebo_ros_diff_drive.so that works"):
        FloorRobot(robot, "", NONE, NONE)
    (record,) = caplog.records
    assert "no movable joint 'no_" in record.message
