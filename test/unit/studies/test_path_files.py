"""Paths are read from files of every format, and what is wrong with a file is said."""

import sys

import numpy as np
import pytest
from recorded_bags import write_bag
from shared import cases, refuses

from bullet_lab.core.trajectory import Trajectory
from bullet_lab.studies.paths import read_path, tum_text

PATH = Trajectory([1.0, 2.0, 3.5], [(0.0, 0.0, 0.1), (0.5, -0.2, 1.0), (1.0, 0.3, -3.0)])


@pytest.fixture
def odometry():
    return pytest.importorskip("nav_msgs.msg").Odometry


def assert_same(path):
    np.testing.assert_allclose(path.stamps, PATH.stamps, atol=1e-9)
    np.testing.assert_allclose(path.poses, PATH.poses, atol=1e-12)


def test_text_holds_the_path(tmp_path):
    (tmp_path / "a.tum").write_text(tum_text(PATH))
    table = zip(PATH.stamps.tolist(), PATH.poses.tolist())
    rows = [f"{yaw!r},{x!r},{y!r},{stamp!r},7" for stamp, (x, y, yaw) in table]
    (tmp_path / "a.csv").write_text("\n".join(["yaw,x,y,stamp,more", *rows]) + "\n")
    for name in ("a.tum", "a.csv"):
        assert_same(read_path(tmp_path / name))


def test_a_bag_holds_the_path_on_a_topic_with_or_without_its_slash(tmp_path, odometry):
    file = tmp_path / "a.bag"
    write_bag(file, ("/odom", odometry, PATH.stamps, PATH.poses))
    for topic in ("/odom", "odom"):
        assert_same(read_path(file, topic))
    with refuses("nothing on the topic /nix; odometry is on /odom"):
        read_path(file, "/nix")


def test_a_bag_with_a_repeated_stamp(tmp_path, odometry):
    poses = np.repeat(PATH.poses, 2, axis=0)
    write_bag(tmp_path / "a.bag", ("/odom", odometry, np.repeat(PATH.stamps, 2), poses))
    found = read_path(tmp_path / "a.bag")
    assert_same(found)
    assert found.remark.endswith("left out, the first in message 2 of /odom")


@cases("""
written, said:
  - [{_type: my_msgs/Path}, "is of my_msgs/Path, not nav_msgs/Odometry"]
  - [{_md5sum: "00000000000000000000000000000000"}, is of another nav_msgs/Odometry]
  # What a bag says of its messages is not believed.
  - [{_full_text: int32 x}, null]
""")
def test_a_bag_with_other_messages(tmp_path, odometry, written, said):
    foreign = type("Foreign", (odometry,), written)
    write_bag(tmp_path / "a.bag", ("/odom", foreign, PATH.stamps, PATH.poses))
    if said is None:
        assert_same(read_path(tmp_path / "a.bag"))
    else:
        with refuses(said):
            read_path(tmp_path / "a.bag")


@pytest.mark.parametrize("content", [b"", b"#ROSBAG V2.0\n\x01\x02"])
def test_an_unreadable_bag(tmp_path, content):
    pytest.importorskip("rosbag")
    (tmp_path / "a.bag").write_bytes(content)
    with refuses("^cannot read .*a.bag: "):
        read_path(tmp_path / "a.bag")


def test_a_bag_without_rosbag(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbag", None)
    with refuses("without ROS's rosbag"):
        read_path(tmp_path / "a.bag")


@cases(r"""
name, content, said:
  - [one.tum, "0 0 0 0 0 0 0 1\n", only one pose]
  - [still.tum, "0 0 0 0 0 0 0 1\n1 9e-4 0 0 0 0 0 1\n", shorter than 0.001 m]
  - [far.tum, "0 2e7 0 0 0 0 0 1\n1 2e7 1 0 0 0 0 1\n", longer than 1e\+07 m]
  - [long.tum, "0 9e6 0 0 0 0 0 1\n1 -9e6 0 0 0 0 0 1\n", longer than 1e\+07 m]
  - [nan.csv, "stamp,x,y,yaw\n0,0,0,0\n1,1,nan,0\n", "line 3: a value is not finite"]
  - [word.csv, "stamp,x,y,yaw\n0,0,0,0\n1,1,a,0\n", "line 3: a value is not a number"]
  - [short.csv, "stamp,x,y,yaw\n0,0,0,0\n1,1\n", "line 3: a value is not a number"]
  - [twice.csv, "stamp,x,y,yaw\n0,0,0,0\n0,1,0,0\n", only one pose]
  - [back.csv, "stamp,v,omega\n0,0,0\n-1,1,0\n", "line 3: stamps must increase"]
  - [head.csv, "t,x,y\n0,0,0\n", "has to name the columns stamp, x, y, yaw"]
  - [bytes.csv, "\udcff", is not a table]
  - [nix.csv, null, "cannot read .*nix.csv: No such file"]
""")
def test_a_bad_file(tmp_path, name, content, said):
    if content is not None:
        (tmp_path / name).write_text(content, errors="surrogateescape")
    with refuses(said) as caught:
        read_path(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)
