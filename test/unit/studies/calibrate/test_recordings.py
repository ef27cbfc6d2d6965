"""Recordings are found in files and folders."""

import numpy as np
import pytest
from recorded_bags import write_bag
from shared import cases, refuses

from bullet_lab.core.trajectory import Trajectory
from bullet_lab.studies.paths import find_recordings, read_pair, tum_text

TOPICS = ("/truth", "/odom")


def line(scale):
    way = scale * np.arange(5.0)
    return Trajectory(np.arange(5.0), np.column_stack((way, 0 * way, 0 * way)))


def write_pair(folder, truth, odometry):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{truth}.tum").write_text(tum_text(line(1.0)))
    (folder / f"{odometry}.tum").write_text(tum_text(line(2.0)))


def check_recordings(paths, count=1, topics=TOPICS):
    found = find_recordings(paths, topics)
    assert len(found) == count
    for recording in found:
        assert (recording.truth.length(), recording.odometry.length()) == (4.0, 8.0)
    return found


@cases("""
pairs:
  - [["", odom, noisy_odom]]
  - [["", run1_truth, run1_odom]]
  - [["", groundtruth, odometry]]
  # In folders below.
  - [["1", odom, noisy_odom], [2/a, a_truth, a_odom], [2/a, b_truth, b_odom]]
""")
def test_two_files_belong_together_by_their_names(tmp_path, pairs):
    for folder, *names in pairs:
        write_pair(tmp_path / folder, *names)
    check_recordings([tmp_path], len(pairs))


def test_velocities_in_a_file_of_the_data_set_are_an_odometry(tmp_path):
    rows = np.column_stack((np.arange(5.0), np.ones(5), np.zeros(5)))
    np.savetxt(tmp_path / "Robot1_Odometry.dat", rows * [1, 2, 1], header="time v omega")
    poses = np.column_stack((rows[:, 0], line(1.0).poses))
    np.savetxt(tmp_path / "Robot1_Groundtruth.dat", poses)
    check_recordings([tmp_path])


@cases("""
columns:
  - "stamp,x,y,yaw,noisy_x,noisy_y,noisy_yaw"
  - "stamp,truth_x,truth_y,truth_yaw,x,y,yaw"
""")
def test_a_table_with_both_paths_is_one_recording_beside_the_same_in_two_files(tmp_path, columns):
    write_pair(tmp_path, "odom", "noisy_odom")
    rows = "".join(f"{t},{t},0,0,{2 * t},0,0\n" for t in range(5))
    (tmp_path / "paths.csv").write_text(f"{columns}\n{rows}")
    (found,) = check_recordings([tmp_path])
    assert found.name == str(tmp_path / "paths.csv")


def test_two_files_of_any_name_are_read_where_they_are_named(tmp_path):
    write_pair(tmp_path, "one", "other")
    found = read_pair(tmp_path / "one.tum", tmp_path / "other.tum", TOPICS)
    assert (found.truth.length(), found.odometry.length()) == (4.0, 8.0)


def test_a_bag_has_both_on_two_topics_of_any_type_of_pose(tmp_path):
    geometry = pytest.importorskip("geometry_msgs.msg")
    odometry = pytest.importorskip("nav_msgs.msg").Odometry
    kinds = {
        "truth": geometry.PoseStamped,
        "amcl": geometry.PoseWithCovarianceStamped,
        "tracked": geometry.TransformStamped,
    }
    stamps = np.arange(1.0, 6.0)
    truths = [(f"/{topic}", kind, stamps, line(1.0).poses) for topic, kind in kinds.items()]
    write_bag(tmp_path / "run.bag", *truths, ("/odom", odometry, stamps, line(2.0).poses))
    for topic in kinds:
        check_recordings([tmp_path], topics=(topic, "odom"))


@cases("""
name, said:
  - ["", "no bag, no table with both paths"]
  - [nix, there is no such file or folder]
  - [one.csv, neither a bag nor a table with both paths]
""")
def test_where_there_is_nothing_that_is_said(tmp_path, name, said):
    (tmp_path / "one.csv").write_text("stamp,x,y,yaw\n")
    with refuses(said):
        find_recordings([tmp_path / name], TOPICS)
