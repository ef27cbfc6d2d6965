"""What displays make of the bytes of messages."""

from io import BytesIO
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rospy")

from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, TransformStamped, Vector3
from nav_msgs.msg import Odometry, Path
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_msgs.msg import ColorRGBA
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.errors import LabError
from bullet_lab.ros.view import displays, markers
from bullet_lab.ros.view.displays import OdometryDisplay, ScanDisplay, read_path
from bullet_lab.ros.view.frames import DisplayContext, read_transforms
from bullet_lab.ros.view.markers import MarkersDisplay, read_marker, read_markers
from bullet_lab.ros.view.subscription import MessageError, reader_of

TURN = Quaternion(0.0, 0.0, 0.6, 0.8)


def data_of(message):
    buffer = BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


class Node:
    """A node of the scene, with its points."""

    def __init__(self, points):
        self.points = points

    def remove(self):
        pass


class Scene:
    """Stands in for viser's scene: its nodes by their names."""

    def __init__(self):
        self.nodes = {}

    def add_point_cloud(self, name, points, colors, **properties):
        self.nodes[name] = Node(points)
        return self.nodes[name]

    add_line_segments = add_point_cloud


@pytest.fixture
def context(monkeypatch):
    monkeypatch.setattr(displays, "Subscription", lambda *arguments, **options: None)
    return DisplayContext(Scene())


def test_transforms():
    message = TFMessage()
    for number in range(3):
        transform = TransformStamped(child_frame_id=f"/child{number}")
        transform.header.frame_id = "parent" * number
        transform.transform.translation = Vector3(number, 2.0, 3.0)
        transform.transform.rotation = Quaternion(0.0, 0.0, 1.2, 1.6)
        message.transforms.append(transform)
    found = reader_of(TFMessage, read_transforms)(data_of(message))
    assert [(parent, child) for child, parent, _ in found] == [
        ("parent" * number, f"child{number}") for number in range(3)
    ]
    assert found[2][2].position == (2.0, 2.0, 3.0)
    assert found[2][2].quaternion == pytest.approx((0.0, 0.0, 0.6, 0.8))


def test_odometry(context):
    message = Odometry(child_frame_id="base")
    message.header.frame_id = "/odom"
    message.pose.pose = Pose(Point(1.0, 2.0, 3.0), TURN)
    covariance = np.zeros((6, 6))
    covariance[:2, :2] = ((0.25, 0.0), (0.0, 0.01))
    message.pose.covariance = covariance.ravel().tolist()
    display = OdometryDisplay(context, "/odom")
    display.show(reader_of(Odometry)(data_of(message)))
    message.pose.pose.position.x = 1.5
    display.show(message)
    (trail,) = context.scene.nodes["/topics/odom/trail/0"].points
    assert trail == pytest.approx(np.array([[1.0, 2.0, 0.02], [1.5, 2.0, 0.02]]))
    ellipse = context.scene.nodes["/topics/odom/ellipse"].points.reshape(-1, 3)
    # The radii hold 95 %, chi-square's 5.99 with two degrees of freedom.
    reach = np.sqrt(5.9915) * np.array([0.5, 0.1])
    assert ellipse.max(axis=0) == pytest.approx([1.5 + reach[0], 2.0 + reach[1], 0.02], abs=1e-3)
    assert context.assumed == {"odom"}


def test_scan(context):
    message = LaserScan(angle_min=-1.0, angle_increment=0.5, range_min=0.25, range_max=8.0)
    message.header.frame_id = "/laser"
    message.ranges = [1.0, float("inf"), float("nan"), 2.5, 0.125]
    message.intensities = [7.0] * 5
    display = ScanDisplay(context, "/scan")
    display.show(reader_of(LaserScan)(data_of(message)))
    points = context.scene.nodes["/topics/scan"].points
    angles, ranges = np.array([-1.0, 0.5]), np.array([1.0, 2.5])
    expected = np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles), np.zeros(2)))
    assert points == pytest.approx(expected)
    message.angle_min = float("nan")
    with pytest.raises(MessageError):
        display.show(message)


@pytest.mark.parametrize("frames", [(), ("odom",) * 4, ("odom", "", "odometry"), ("odom", "base")])
def test_path(frames):
    message = Path()
    message.header.frame_id = "odom"
    for number, frame in enumerate(frames):
        pose = PoseStamped(pose=Pose(Point(number, 2.0 * number, 0.5), TURN))
        pose.header.frame_id = frame
        message.poses.append(pose)
    frame, places = read_path(data_of(message))
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
    first, second = reader_of(MarkerArray, read_markers)(data_of(MarkerArray([line, mesh])))
    assert (first.frame, first.key, first.text) == ("odom", ("line", 7), "größer")
    assert first.points[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert first.colours.shape == (5, 4)
    assert first.pose.quaternion == (0.0, 0.0, 0.0, 1.0)
    assert (first.locked, second.locked) == (True, False)
    assert (first.embedded, second.embedded) == (False, True)
    assert (second.mesh, second.scale) == ("package://a/b.dae", (1.0, 2.0, 3.0))
    assert second.colour == (0.5, 0.25, 0.0, 1.0)
    assert read_marker(mesh).pose.position == (1.0, 2.0, 3.0)


def test_a_list_with_too_few_colours_has_the_colour_of_the_marker(monkeypatch):
    marker = Marker(type=Marker.CUBE_LIST, points=[Point()] * 3, colors=[ColorRGBA()])
    marker.color, marker.scale = ColorRGBA(1.0, 0.5, 0.0, 1.0), Vector3(1.0, 1.0, 1.0)
    subscription = SimpleNamespace(take=lambda: [[read_marker(marker)]])
    monkeypatch.setattr(markers, "Subscription", lambda *arguments, **options: subscription)
    shown = {}
    scene = SimpleNamespace(
        add_batched_meshes_simple=lambda name, *_, **arrays: shown.update(arrays)
    )
    MarkersDisplay(DisplayContext(scene), "/boxes").tick()
    assert shown["batched_colors"].tolist() == [[255, 128, 0]] * 3


@pytest.mark.parametrize(
    ("read", "message"),
    [
        (reader_of(TFMessage, read_transforms), TFMessage([TransformStamped()])),
        (reader_of(Odometry), Odometry()),
        (read_path, Path(poses=[PoseStamped()])),
        (read_path, Path(poses=[PoseStamped()] * 3)),
        (reader_of(LaserScan), LaserScan(ranges=[1.0] * 3)),
        (reader_of(MarkerArray, read_markers), MarkerArray([Marker(points=[Point()])])),
        (reader_of(Clock), Clock()),
    ],
)
def test_what_is_cut_short_is_refused(read, message):
    data = data_of(message)
    for length in range(0, len(data), 3):
        with pytest.raises(MessageError):
            read(data[:length])


def test_what_is_not_finite_is_refused():
    transform = TransformStamped()
    transform.transform.translation.x = float("nan")
    with pytest.raises(LabError):
        read_transforms(TFMessage([transform]))
    with pytest.raises(LabError):
        read_marker(Marker(points=[Point(float("inf"), 0.0, 0.0)]))
    path = Path(poses=[PoseStamped(), PoseStamped()])
    path.poses[1].pose.position.y = float("nan")
    with pytest.raises(LabError):
        read_path(data_of(path))


@pytest.mark.parametrize("read", [reader_of(TFMessage, read_transforms), reader_of(MarkerArray)])
def test_huge_counts_are_refused(read):
    with pytest.raises(MessageError):
        read(np.array([2**32 - 1], "<u4").tobytes())


def test_a_huge_count_of_poses_is_refused():
    with pytest.raises(MessageError):
        read_path(data_of(Path())[:-4] + np.array([2**32 - 1], "<u4").tobytes())
