"""What displays make of the bytes of messages."""

from types import SimpleNamespace

import numpy as np
import pytest
from geometry_msgs.msg import Point, PoseStamped, TransformStamped
from message_fields import data_of, message
from nav_msgs.msg import Odometry, Path
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.errors import LabError
from bullet_lab.ros.view import displays
from bullet_lab.ros.view.displays import OdometryDisplay, ScanDisplay, read_path
from bullet_lab.ros.view.frames import DisplayContext, read_transforms
from bullet_lab.ros.view.markers import MarkersDisplay, read_marker, read_markers
from bullet_lab.ros.view.subscription import MessageError, reader_of


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
    text = """
        transforms:
          - header: {frame_id: ""}
            child_frame_id: /child0
            transform: {rotation: {w: 1.0}}
          - header: {frame_id: parent}
            child_frame_id: child1
            transform: {translation: {x: 2.0, y: 3.0, z: 4.0}, rotation: {z: 1.2, w: 1.6}}
    """
    found = reader_of(TFMessage, read_transforms)(data_of(message(TFMessage, text)))
    assert [names for *names, _ in found] == [["child0", ""], ["child1", "parent"]]
    assert found[1][2].position == (2.0, 3.0, 4.0)
    assert found[1][2].quaternion == pytest.approx((0.0, 0.0, 0.6, 0.8))


def test_odometry(context):
    text = """
        header: {frame_id: /odom}
        child_frame_id: base
        pose:
          pose: {position: {x: 1.0, y: 2.0, z: 3.0}, orientation: {z: 0.6, w: 0.8}}
    """
    made = message(Odometry, text)
    covariance = np.zeros((6, 6))
    covariance[:2, :2] = ((0.25, 0.0), (0.0, 0.01))
    made.pose.covariance = covariance.ravel().tolist()
    display = OdometryDisplay(context, "/odom")
    display.show(reader_of(Odometry)(data_of(made)))
    made.pose.pose.position.x = 1.5
    display.show(made)
    (trail,) = context.scene.nodes["/topics/odom/trail/0"].points
    assert trail == pytest.approx(np.array([[1.0, 2.0, 0.02], [1.5, 2.0, 0.02]]))
    ellipse = context.scene.nodes["/topics/odom/ellipse"].points.reshape(-1, 3)
    # The radii hold 95 %, chi-square's 5.99 with two degrees of freedom.
    reach = np.sqrt(5.9915) * np.array([0.5, 0.1])
    assert ellipse.max(axis=0) == pytest.approx([1.5 + reach[0], 2.0 + reach[1], 0.02], abs=1e-3)
    assert context.assumed == {"odom"}


def test_scan(context):
    text = """
        header: {frame_id: /laser}
        angle_min: -1.0
        angle_increment: 0.5
        range_min: 0.25
        range_max: 8.0
        ranges: [1.0, .inf, .nan, 2.5, 0.125]
        intensities: [7.0, 7.0, 7.0, 7.0, 7.0]
    """
    made = message(LaserScan, text)
    display = ScanDisplay(context, "/scan")
    display.show(reader_of(LaserScan)(data_of(made)))
    points = context.scene.nodes["/topics/scan"].points
    angles, ranges = np.array([-1.0, 0.5]), np.array([1.0, 2.5])
    expected = np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles), np.zeros(2)))
    assert points == pytest.approx(expected)
    made.angle_min = float("nan")
    with pytest.raises(MessageError):
        display.show(made)


@pytest.mark.parametrize("frames", [(), ("odom",) * 4, ("odom", "", "odometry"), ("odom", "base")])
def test_path(frames):
    made = message(Path, "header: {frame_id: odom}")
    for number, frame in enumerate(frames):
        made.poses.append(message(PoseStamped, "pose: {orientation: {z: 0.6, w: 0.8}}"))
        made.poses[-1].header.frame_id = frame
        made.poses[-1].pose.position = Point(number, 2.0 * number, 0.5)
    frame, places = read_path(data_of(made))
    assert frame == "odom"
    assert places.tolist() == [[n, 2.0 * n, 0.5] for n in range(len(frames))]


def test_markers():
    text = """
        markers:
          - header: {frame_id: /odom}
            ns: line
            id: 7
            type: 4
            frame_locked: true
            text: größer
            points: [{x: 0.0, z: 1.0}, {x: 1.0, z: 1.0}]
            colors: [{r: 0.5, a: 1.0}, {r: 0.5, a: 1.0}]
          - ns: mesh
            type: 10
            mesh_use_embedded_materials: true
            mesh_resource: package://a/b.dae
            scale: {x: 1.0, y: 2.0, z: 3.0}
            pose: {position: {x: 1.0, y: 2.0, z: 3.0}, orientation: {z: 0.6, w: 0.8}}
            color: {r: 0.5, g: 0.25, a: 1.0}
    """
    made = message(MarkerArray, text)
    first, second = reader_of(MarkerArray, read_markers)(data_of(made))
    assert (first.frame, first.key, first.text) == ("odom", ("line", 7), "größer")
    assert first.points.tolist() == [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]]
    assert first.colours.tolist() == [[0.5, 0.0, 0.0, 1.0]] * 2
    assert first.pose.quaternion == (0.0, 0.0, 0.0, 1.0)
    assert (first.locked, second.locked) == (True, False)
    assert (first.embedded, second.embedded) == (False, True)
    assert (second.mesh, second.scale) == ("package://a/b.dae", (1.0, 2.0, 3.0))
    assert second.colour == (0.5, 0.25, 0.0, 1.0)
    assert second.pose.position == (1.0, 2.0, 3.0)


def test_a_list_with_too_few_colours_has_the_colour_of_the_marker(monkeypatch):
    text = """
        type: 6
        points: [{}, {}, {}]
        colors: [{}]
        color: {r: 1.0, g: 0.5, a: 1.0}
        scale: {x: 1.0, y: 1.0, z: 1.0}
    """
    subscription = SimpleNamespace(take=lambda: [[read_marker(message(Marker, text))]])
    monkeypatch.setattr(displays, "Subscription", lambda *arguments, **options: subscription)
    shown = {}
    scene = SimpleNamespace(
        add_batched_meshes_simple=lambda name, *_, **arrays: shown.update(arrays)
    )
    MarkersDisplay(DisplayContext(scene), "/boxes").tick()
    assert shown["batched_colors"].tolist() == [[255, 128, 0]] * 3


@pytest.mark.parametrize(
    ("read", "made"),
    [
        (reader_of(TFMessage, read_transforms), TFMessage([TransformStamped()])),
        (reader_of(Odometry), Odometry()),
        (read_path, Path(poses=[PoseStamped()] * 3)),
        (reader_of(LaserScan), LaserScan(ranges=[1.0] * 3)),
        (reader_of(MarkerArray, read_markers), MarkerArray([Marker(points=[Point()])])),
        (reader_of(Clock), Clock()),
    ],
)
def test_what_is_cut_short_is_refused(read, made):
    data = data_of(made)
    for length in range(0, len(data), 3):
        with pytest.raises(MessageError):
            read(data[:length])


@pytest.mark.parametrize(
    ("read", "kind", "text"),
    [
        (read_transforms, TFMessage, "transforms: [{transform: {translation: {x: .nan}}}]"),
        (read_marker, Marker, "points: [{x: .inf}]"),
    ],
)
def test_what_is_not_finite_is_refused(read, kind, text):
    with pytest.raises(LabError):
        read(message(kind, text))


def test_a_path_with_a_pose_that_is_not_finite_is_refused():
    with pytest.raises(LabError):
        read_path(data_of(message(Path, "poses: [{}, {pose: {position: {y: .nan}}}]")))


@pytest.mark.parametrize("read", [reader_of(TFMessage, read_transforms), reader_of(MarkerArray)])
def test_huge_counts_are_refused(read):
    with pytest.raises(MessageError):
        read(np.array([2**32 - 1], "<u4").tobytes())


def test_a_huge_count_of_poses_is_refused():
    with pytest.raises(MessageError):
        read_path(data_of(Path())[:-4] + np.array([2**32 - 1], "<u4").tobytes())
