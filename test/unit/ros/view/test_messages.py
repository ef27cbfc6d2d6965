"""What displays make of the bytes of messages."""

import cmath
from copy import deepcopy
from types import SimpleNamespace

import numpy as np
import pytest
from alike import lines_of
from geometry_msgs.msg import Point, PoseStamped
from message_fields import data_of, message
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import LaserScan
from shared import cases
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.errors import LabError
from bullet_lab.ros.view import displays
from bullet_lab.ros.view.context import DisplayContext, MessageError, reader_of
from bullet_lab.ros.view.displays import OdometryDisplay, ScanDisplay, read_path
from bullet_lab.ros.view.markers import MarkersDisplay, read_marker, read_markers
from bullet_lab.ros.view.robots import read_transforms


@pytest.fixture
def context(monkeypatch, scene):
    monkeypatch.setattr(displays, "Subscription", lambda *arguments, **options: None)
    return DisplayContext(scene)


@pytest.fixture
def display(monkeypatch, scene):
    """A function that returns a display of sets of markers, which come one after the other."""

    def display(*sets):
        left = iter(sets)
        subscription = SimpleNamespace(take=lambda: [list(map(read_marker, next(left)))])
        monkeypatch.setattr(displays, "Subscription", lambda *arguments, **options: subscription)
        return MarkersDisplay(DisplayContext(scene), "/markers")

    return display


def sent(kind, text, read=None):
    """Return what is read from the bytes of a message."""
    return reader_of(kind, *filter(None, [read]))(data_of(message(kind, text)))


TRANSFORMS = """
    transforms:
      - header: {frame_id: ""}
        child_frame_id: /child0
        transform: {rotation: {w: 1.0}}
      - header: {frame_id: parent}
        child_frame_id: child1
        transform: {translation: {x: 2.0, y: 3.0, z: 4.0}, rotation: {z: 1.2, w: 1.6}}
"""
MARKERS = """
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


def test_transforms_and_markers_are_read_as_before(as_before):
    found = *sent(TFMessage, TRANSFORMS, read_transforms), *sent(MarkerArray, MARKERS, read_markers)
    as_before(lines_of(found, "read"), "read.txt")


def test_odometry(context):
    text = """
        header: {frame_id: /odom}
        child_frame_id: base
        pose:
          pose: {position: {x: 1.0, y: 2.0, z: 3.0}, orientation: {z: 0.6, w: 0.8}}
    """
    made = sent(Odometry, text)
    made.pose.covariance = np.diag([0.25, 0.01, 0.0, 0.0, 0.0, 0.0]).ravel()
    display = OdometryDisplay(context, "/odom")
    for made.pose.pose.position.x in (1.0, 1.5):
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
    made = sent(LaserScan, text)
    display = ScanDisplay(context, "/scan")
    display.show(made)
    x, y, z = context.scene.nodes["/topics/scan"].points.T
    assert x + 1j * y == pytest.approx([cmath.rect(1.0, -1.0), cmath.rect(2.5, 0.5)])
    assert not z.any()
    made.angle_min = float("nan")
    with pytest.raises(MessageError):
        display.show(made)


@cases("""
frames:
  - []
  - [odom, odom, odom, odom]
  - [odom, "", odometry]
  - [odom, base]
""")
def test_path(frames):
    made = message(Path, "header: {frame_id: odom}")
    for number, frame in enumerate(frames):
        made.poses.append(message(PoseStamped, "pose: {orientation: {z: 0.6, w: 0.8}}"))
        made.poses[-1].header.frame_id = frame
        made.poses[-1].pose.position = Point(number, 2.0 * number, 0.5)
    frame, places = read_path(data_of(made))
    assert frame == "odom"
    assert places.tolist() == [[n, 2.0 * n, 0.5] for n in range(len(frames))]


def test_a_list_with_too_few_colours_has_the_colour_of_the_marker(display, scene):
    text = """
        type: 6
        points: [{}, {}, {}]
        colors: [{}]
        color: {r: 1.0, g: 0.5, a: 1.0}
        scale: {x: 1.0, y: 1.0, z: 1.0}
    """
    display([message(Marker, text)]).tick()
    (node,) = scene.nodes.values()
    assert node.batched_colors.tolist() == [[255, 128, 0]] * 3


def test_a_marker_that_goes_takes_no_other_along(display, scene):
    label = Marker(type=Marker.TEXT_VIEW_FACING, text="there")
    label.color.a = label.scale.z = label.pose.orientation.w = 1.0
    first, gone, other = (deepcopy(label) for _ in range(3))
    first.ns, first.id = gone.ns, gone.id = "a", 3
    other.ns = "a/3"
    gone.action = Marker.DELETE
    shown = display([first, other], [gone])
    shown.tick()
    assert len(scene.nodes) == 2
    shown.tick()
    (left,) = scene.nodes
    assert "a/3" in left


@pytest.mark.parametrize(
    "read, made",
    [
        (read_path, Path(poses=[PoseStamped()] * 3)),
        (reader_of(MarkerArray, read_markers), MarkerArray([Marker(points=[Point()])])),
    ],
)
def test_what_is_cut_short_is_refused(read, made):
    data = data_of(made)
    for length in range(0, len(data), 3):
        with pytest.raises(MessageError):
            read(data[:length])


@pytest.mark.parametrize(
    "read, kind, text",
    [
        (
            reader_of(TFMessage, read_transforms),
            TFMessage,
            "transforms: [{transform: {translation: {x: .nan}}}]",
        ),
        (reader_of(MarkerArray, read_markers), MarkerArray, "markers: [{points: [{x: .inf}]}]"),
        (read_path, Path, "poses: [{}, {pose: {position: {y: .nan}}}]"),
    ],
)
def test_what_is_not_finite_is_refused(read, kind, text):
    with pytest.raises(LabError):
        read(data_of(message(kind, text)))


@pytest.mark.parametrize("read, kind", [(reader_of(MarkerArray), MarkerArray), (read_path, Path)])
def test_huge_counts_are_refused(read, kind):
    with pytest.raises(MessageError):
        read(data_of(kind())[:-4] + b"\xff" * 4)
