"""Recordings are found in files and folders."""

import numpy as np
import pytest
from recorded_bags import write_bag

from bullet_lab.core.trajectory import Trajectory
from bullet_lab.errors import LabError
from bullet_lab.studies.paths import find_recordings, read_pair, tum_text

TOPICS = ("/truth", "/odom")


def line(scale):
    way = scale * np.arange(5.0)
    return Trajectory(np.arange(5.0), np.column_stack((way, 0 * way, 0 * way)))


def write_pair(folder, truth, odometry):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{truth}.tum").write_text(tum_text(line(1.0)))
    (folder / f"{odometry}.tum").write_text(tum_text(line(2.0)))


def assert_truth_first(found):
    for recording in found:
        assert recording.truth.length() == 4.0
        assert recording.odometry.length() == 8.0


@pytest.mark.parametrize(
    "truth, odometry",
    [("odom", "noisy_odom"), ("run1_truth", "run1_odom"), ("groundtruth", "odometry")],
)
def test_two_files_belong_together_by_their_names(tmp_path, truth, odometry):
    write_pair(tmp_path, truth, odometry)
    found = find_recordings([tmp_path], TOPICS)
    assert len(found) == 1
    assert_truth_first(found)


def test_velocities_in_a_file_of_the_data_set_are_an_odometry(tmp_path):
    rows = np.column_stack((np.arange(5.0), np.ones(5), np.zeros(5)))
    np.savetxt(tmp_path / "Robot1_Odometry.dat", rows * [1, 2, 1], header="time v omega")
    poses = np.column_stack((rows[:, 0], line(1.0).poses))
    np.savetxt(tmp_path / "Robot1_Groundtruth.dat", poses)
    assert_truth_first(find_recordings([tmp_path], TOPICS))


def test_folders_below_are_looked_through(tmp_path):
    write_pair(tmp_path / "robot1", "odom", "noisy_odom")
    write_pair(tmp_path / "robot2" / "again", "a_truth", "a_odom")
    write_pair(tmp_path / "robot2" / "again", "b_truth", "b_odom")
    found = find_recordings([tmp_path], TOPICS)
    assert len(found) == 3
    assert_truth_first(found)


@pytest.mark.parametrize(
    "columns",
    ["stamp,x,y,yaw,noisy_x,noisy_y,noisy_yaw", "stamp,truth_x,truth_y,truth_yaw,x,y,yaw"],
)
def test_a_table_with_both_paths_is_one_recording_beside_the_same_in_two_files(tmp_path, columns):
    write_pair(tmp_path, "odom", "noisy_odom")
    rows = "".join(f"{t},{t},0,0,{2 * t},0,0\n" for t in range(5))
    (tmp_path / "paths.csv").write_text(f"{columns}\n{rows}")
    found = find_recordings([tmp_path], TOPICS)
    assert [recording.name for recording in found] == [str(tmp_path / "paths.csv")]
    assert_truth_first(found)


def test_two_files_of_any_name_are_read_where_they_are_named(tmp_path):
    write_pair(tmp_path, "one", "other")
    assert_truth_first([read_pair(tmp_path / "one.tum", tmp_path / "other.tum", TOPICS)])


def test_a_bag_has_both_on_two_topics_of_any_type_of_pose(tmp_path):
    geometry = pytest.importorskip("geometry_msgs.msg")
    odometry = pytest.importorskip("nav_msgs.msg").Odometry
    stamps, true, reported = np.arange(1.0, 6.0), line(1.0).poses, line(2.0).poses
    write_bag(
        tmp_path / "run.bag",
        ("/truth", geometry.PoseStamped, stamps, true),
        ("/amcl", geometry.PoseWithCovarianceStamped, stamps, true),
        ("/tracked", geometry.TransformStamped, stamps, true),
        ("/odom", odometry, stamps, reported),
    )
    assert_truth_first(find_recordings([tmp_path], TOPICS))
    for truth in ("amcl", "tracked"):
        assert_truth_first(find_recordings([tmp_path / "run.bag"], (truth, "odom")))


def test_where_there_is_nothing_that_is_said(tmp_path):
    with pytest.raises(LabError, match="no bag, no table with both paths"):
        find_recordings([tmp_path], TOPICS)
    with pytest.raises(LabError, match="there is no such file or folder"):
        find_recordings([tmp_path / "nix"], TOPICS)
    (tmp_path / "one.csv").write_text("stamp,x,y,yaw\n")
    with pytest.raises(LabError, match="neither a bag nor a table with both paths"):
        find_recordings([tmp_path / "one.csv"], TOPICS)
