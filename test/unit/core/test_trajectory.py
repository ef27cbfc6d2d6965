"""Paths of poses, their files and their errors."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from shared import cases

from bullet_lab.core.trajectory import (
    Trajectory,
    TrajectoryError,
    path_error,
    read_tum,
    tum_row,
)

STAMPS = [0.05, 0.1, 1700000000.123456789]
POSES = [[0.0, 1 / 3, -1e-17], [1e-5, -2.0, 3.0], [math.pi, 7.0, -0.1]]


@pytest.fixture
def write(tmp_path):
    def write_text(*lines):
        path = tmp_path / "path.txt"
        path.write_text("".join(line + "\n" for line in lines))
        return path

    return write_text


def test_length_is_that_of_the_way():
    trajectory = Trajectory([0, 1, 2, 3], [[0, 0, 0], [3, 4, 1], [3, 4, 2], [3, 3, 2]])
    assert_allclose(trajectory.travelled(), [0.0, 5.0, 5.0, 6.0])
    assert trajectory.length() == 6.0
    assert len(trajectory) == 4
    assert Trajectory([1.0], [[1.0, 2.0, 3.0]]).length() == 0.0


def test_arrays_are_copied_and_read_only():
    poses = np.zeros((2, 3))
    trajectory = Trajectory([0, 1], poses)
    poses[:] = 1.0
    assert not trajectory.poses.any()
    with pytest.raises(ValueError, match="read-only"):
        trajectory.poses[0, 0] = 1.0


@cases("""
stamps, poses, message:
  - [[], [], no poses]
  - [[0, 1], [[0, 0, 0]], shape]
  - [[[0], [1]], [[0, 0, 0], [0, 0, 0]], shape]
  - [[0, .nan], [[0, 0, 0], [0, 0, 0]], not finite]
  - [[0, 1], [[0, 0, 0], [0, .inf, 0]], not finite]
  - [[0, 1, 1], [[0, 0, 0], [0, 0, 0], [0, 0, 0]], 1.000000000 follows 1.000000000]
  - [[0, 1], [[0, 0, 0], [0, 0]], numbers]
  - [[zero], [[0, 0, 0]], numbers]
""")
def test_bad_trajectories_are_refused(stamps, poses, message):
    with pytest.raises(TrajectoryError, match=message):
        Trajectory(stamps, poses)


def test_tum_round_trip(write):
    lines = [tum_row(stamp, *pose) for stamp, pose in zip(STAMPS, np.array(POSES))]
    trajectory = read_tum(write("# timestamp tx ty", "", *lines))
    assert_array_equal(trajectory.stamps, STAMPS)
    assert_array_equal(trajectory.poses[:, :2], np.array(POSES)[:, :2])
    assert_allclose(trajectory.poses[:, 2], np.array(POSES)[:, 2], atol=1e-15)


@cases("""
line, message:
  - [1 2 3, "line 2: 8 values needed, not 3"]
  - [-1 0 0 0 0 0 0 1, "line 2: stamps must increase"]
  - [1 0 0 0 0 0 0 one, "line 2: a value is not a number"]
  - [1 0 0 nan 0 0 0 1, "line 2: a value is not finite"]
  - [1 0 0 0 0 0 0 0, "line 2: the quaternion is zero"]
""")
def test_bad_tum_files_are_refused(write, line, message):
    path = write("0 0 0 0 0 0 0 1", line)
    with pytest.raises(TrajectoryError, match=message) as caught:
        read_tum(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_poses_with_the_same_stamp_are_left_out_and_counted(write):
    found = read_tum(write("# a", *(f"{t} {x} 0 0 0 0 0 1" for x, t in enumerate((0, 0, 1, 1, 1)))))
    assert_array_equal(found.poses[:, 0], [0, 2])
    assert found.remark == "3 with the stamp of the one before left out, the first in line 3"
    assert read_tum(write("0 0 0 0", "1 2 3 0.5")).poses[1].tolist() == [2.0, 3.0, 0.5]


def test_velocities_are_held_until_the_next_stamp(write):
    found = read_tum(write(f"0 1 {math.pi / 4}", "2 2 0", "4 0 0"))
    quarter = 4.0 / math.pi
    expected = [[0, 0, 0], [quarter, quarter, math.pi / 2], [quarter, quarter + 4, math.pi / 2]]
    assert_allclose(found.poses, expected, atol=1e-12)
    with pytest.raises(TrajectoryError, match="line 1: 8 or 4 or 3 values needed, not 5"):
        read_tum(write("0 0 0 0 0"))


def test_files_that_cannot_be_read(tmp_path):
    binary = tmp_path / "binary"
    binary.write_bytes(b"\xff\xfe\x00")
    for path, message in (
        (tmp_path / "missing", "cannot read .*missing"),
        (tmp_path, "cannot read"),
        (binary, "not a text file"),
    ):
        with pytest.raises(TrajectoryError, match=message):
            read_tum(path)


REFERENCE = Trajectory([0, 1, 2, 3], [[0, 0, 0], [1, 0, 0], [2, 0, 3.1], [2, 2, -3.1]])


def test_errors_by_hand():
    estimate = Trajectory(
        REFERENCE.stamps, REFERENCE.poses + [[0, 0, 0], [0.3, 0.4, 0], [0, -1, 0.1], [2, 0, 6.0]]
    )
    error = path_error(REFERENCE, estimate)
    assert_allclose(error.error, [0.0, 0.5, 1.0, 2.0])
    last = 6.0 - math.tau
    assert_allclose(error.heading_error, [0.0, 0.0, 0.1, last])
    assert_allclose(error.travelled, [0.0, 1.0, 2.0, 4.0])
    assert error.ape_rmse_m == pytest.approx(math.sqrt(5.25 / 4))
    assert error.ape_max_m == error.final_error_m == pytest.approx(2.0)
    assert math.radians(error.heading_rmse_deg) == pytest.approx(math.sqrt((0.01 + last**2) / 4))
    assert math.radians(error.final_heading_error_deg) == pytest.approx(last)


def test_other_stamps_are_refused():
    for stamps in ([0, 1, 2], [0, 1, 2, 3.001]):
        estimate = Trajectory(stamps, REFERENCE.poses[: len(stamps)])
        with pytest.raises(TrajectoryError, match="same stamps"):
            path_error(REFERENCE, estimate)
