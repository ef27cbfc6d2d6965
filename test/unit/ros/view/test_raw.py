"""Messages read from their bytes are what ROS's own classes say."""

from io import BytesIO

import numpy as np
import pytest
import rospy
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, TransformStamped, Vector3
from nav_msgs.msg import Odometry, Path
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_msgs.msg import ColorRGBA
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.ros.view import raw

TURN = Quaternion(0.0, 0.0, 0.6, 0.8)


def data_of(message):
    buffer = BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def test_transforms():
    message = TFMessage()
    for number in range(3):
        transform = TransformStamped(child_frame_id=f"/child{number}")
        transform.header.frame_id = "parent" * number
        transform.transform.translation = Vector3(number, 2.0, 3.0)
        transform.transform.rotation = Quaternion(0.0, 0.0, 1.2, 1.6)
        message.transforms.append(transform)
    found = raw.read_transforms(data_of(message))
    assert [(parent, child) for parent, child, _ in found] == [
        ("parent" * number, f"child{number}") for number in range(3)
    ]
    assert found[2][2].position == (2.0, 2.0, 3.0)
    assert found[2][2].quaternion == pytest.approx((0.0, 0.0, 0.6, 0.8))


def test_odometry():
    message = Odometry(child_frame_id="base")
    message.header.frame_id = "/odom"
    message.pose.pose = Pose(Point(1.0, 2.0, 3.0), TURN)
    message.pose.covariance = list(range(36))
    found = raw.read_odometry(data_of(message))
    assert (found.frame, found.child) == ("odom", "base")
    assert found.pose.position == (1.0, 2.0, 3.0)
    assert found.covariance == (0.0, 1.0, 7.0)


def test_scan():
    message = LaserScan(angle_min=-1.0, angle_increment=0.5, range_min=0.25, range_max=8.0)
    message.header.frame_id = "/laser"
    message.ranges = [1.0, float("inf"), float("nan"), 2.5]
    message.intensities = [7.0] * 4
    found = raw.read_scan(data_of(message))
    assert (found.frame, found.start, found.step) == ("laser", -1.0, 0.5)
    assert (found.least, found.greatest) == (0.25, 8.0)
    np.testing.assert_array_equal(found.ranges, message.ranges)


@pytest.mark.parametrize("frames", [(), ("odom",) * 4, ("odom", "", "odometry")])
def test_path(frames):
    message = Path()
    message.header.frame_id = "odom"
    for number, frame in enumerate(frames):
        pose = PoseStamped(pose=Pose(Point(number, 2.0 * number, 0.5), TURN))
        pose.header.frame_id = frame
        message.poses.append(pose)
    frame, places = raw.read_path(data_of(message))
    assert frame == "odom"
    assert places.tolist() == [[n, 2.0 * n, 0.5] for n in range(len(frames))]


def test_markers():
    line = Marker(ns="line", id=7, type=Marker.LINE_STRIP, frame_locked=True, text="größer")
    line.header.frame_id = "/odom"
    line.points = [Point(n, 0.0, 1.0) for n in range(5)]
    line.colors = [ColorRGBA(0.5, 0.25, 0.0, 1.0)] * 5
    mesh = Marker(ns="mesh", type=Marker.MESH_RESOURCE, mesh_use_embedded_materials=True)
    mesh.mesh_resource, mesh.scale = "package://a/b.dae", Vector3(1.0, 2.0, 3.0)
    mesh.pose = Pose(Point(1.0, 2.0, 3.0), TURN)
    mesh.color = ColorRGBA(0.5, 0.25, 0.0, 1.0)
    first, second = raw.read_markers(data_of(MarkerArray([line, mesh])))
    assert (first.frame, first.space, first.number, first.text) == ("odom", "line", 7, "größer")
    assert first.points[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert first.colours.shape == (5, 4)
    assert first.pose.quaternion == (0.0, 0.0, 0.0, 1.0)
    assert (first.locked, second.locked) == (True, False)
    assert (first.own_looks, second.own_looks) == (False, True)
    assert (second.mesh, second.scale) == ("package://a/b.dae", (1.0, 2.0, 3.0))
    assert second.colour == (0.5, 0.25, 0.0, 1.0)
    assert raw.read_marker(data_of(mesh))[0].pose.position == (1.0, 2.0, 3.0)


def test_clock():
    assert raw.read_clock(data_of(Clock(rospy.Time(12, 500_000_000)))) == 12.5


# Of the speeds in odometry, which are not read.
SPEEDS = 8 * (6 + 36)


@pytest.mark.parametrize(
    ("read", "message"),
    [
        (raw.read_transforms, TFMessage([TransformStamped()])),
        (raw.read_odometry, Odometry()),
        (raw.read_path, Path(poses=[PoseStamped()])),
        (raw.read_markers, MarkerArray([Marker(points=[Point()])])),
        (raw.read_clock, Clock()),
    ],
)
def test_what_is_cut_short_is_refused(read, message):
    data = data_of(message)
    end = len(data) - SPEEDS * isinstance(message, Odometry)
    for length in range(0, end, 3):
        with pytest.raises(raw.RawError):
            read(data[:length])


def test_what_is_not_finite_is_refused():
    transform = TransformStamped()
    transform.transform.translation.x = float("nan")
    with pytest.raises(raw.RawError):
        raw.read_transforms(data_of(TFMessage([transform])))
    marker = Marker(points=[Point(float("inf"), 0.0, 0.0)])
    with pytest.raises(raw.RawError):
        raw.read_marker(data_of(marker))


def test_huge_counts_are_refused():
    with pytest.raises(raw.RawError):
        raw.read_transforms(np.array([2**32 - 1], "<u4").tobytes())
