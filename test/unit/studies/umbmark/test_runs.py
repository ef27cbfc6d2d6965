"""Recorded runs come out of files as they went into them."""

import math

import numpy as np
import pytest
from shared import cases, refuses

from bullet_lab.core import se2
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.drive import Square
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.studies.paths import tum_text
from bullet_lab.studies.umbmark.estimate import fit, perfect_square, read_runs
from bullet_lab.studies.umbmark.robots import NO_ERRORS, IdealRobot, drive_square

TOPICS = ("/truth", "/odom")
WRONG = SystematicErrors(diameter_error=0.004, base_error=-0.02)
ELSEWHERE = np.array((3.0, -1.0, 2.0))


def recorded(turn):
    """True and reported path of a square, the true one in a frame of its own."""
    robot = IdealRobot(0.38, WRONG, NO_ERRORS)
    true = [robot.pose()]
    drive = robot.drive

    def follow(*command):
        drive(*command)
        true.append(robot.pose())

    robot.drive = follow
    run = drive_square(robot, Square(side=1.0, speed=1.0, turn_speed=turn), "run")
    stamps = 0.05 * np.arange(len(true))
    return Trajectory(stamps, se2.compose(ELSEWHERE, true)), Trajectory(stamps, run.odometry)


def write_pair(folder, name, true, reported):
    (folder / f"{name}_truth.tum").write_text(tum_text(true))
    (folder / f"{name}_odom.tum").write_text(tum_text(reported))


def test_files_of_both_ways_say_what_the_wheels_are(tmp_path):
    for name, turn in (("a", 0.5), ("b", -0.5)):
        write_pair(tmp_path, name, *recorded(turn))
    runs = read_runs(tmp_path, TOPICS, 1.0, 0.38)
    assert [run.direction for run in runs] == ["ccw", "cw"]
    found = fit(runs).errors
    assert found.diameter_error == pytest.approx(WRONG.diameter_error, rel=1e-3)
    assert found.base_error == pytest.approx(WRONG.base_error, rel=1e-3)


@cases("shift, share: [[1000.0, 1.0], [0.0, 0.7]]")
def test_a_truth_of_another_time_is_refused(shift, share, tmp_path):
    true, reported = recorded(0.5)
    count = int(share * len(true.stamps))
    write_pair(tmp_path, "a", Trajectory(true.stamps[:count] + shift, true.poses[:count]), reported)
    with refuses("are both of one run and one clock"):
        read_runs(tmp_path, TOPICS, 1.0, 0.4)


def test_a_table_of_what_was_measured_with_a_rule(tmp_path):
    rows = [("ccw", 0.1, -0.2, 0.03), ("cw", -0.1, 0.05, -0.02)]
    text = "\n".join(",".join(map(str, row)) for row in rows)
    (tmp_path / "returns.csv").write_text(f"direction,x,y,yaw\n{text}\n")
    runs = read_runs(tmp_path / "returns.csv", TOPICS, 2.0, 0.4)
    for run, (way, *end) in zip(runs, rows):
        assert run.direction == way
        assert run.return_error() == pytest.approx(end)
        assert run.odometry == pytest.approx(perfect_square(2.0, way))


def test_a_perfect_square_comes_back():
    for way, sign in (("ccw", 1.0), ("cw", -1.0)):
        square = perfect_square(2.0, way)
        assert square[-1] == pytest.approx((0.0, 0.0, sign * math.tau), abs=1e-12)
        assert square[6][:2] == pytest.approx((2.0, sign * 2.0))


@cases(r"""
text, said:
  - ["direction,x,y,yaw\nleft,0,0,0\n", "line 2: the direction has to be one of cw, ccw"]
  - ["direction,x,y,yaw\ncw,0,nan,0\n", line 2]
  - ["", "no bag, no table"]
  - - "stamp,x,y,yaw,noisy_x,noisy_y,noisy_yaw\n0,0,0,0,0,0,0\n1,1,0,0,1,0,0\n"
    - not once round
""")
def test_what_cannot_be_used_is_refused(text, said, tmp_path):
    (tmp_path / "run.csv").write_text(text)
    with refuses(said):
        read_runs(tmp_path, TOPICS, 1.0, 0.4)
