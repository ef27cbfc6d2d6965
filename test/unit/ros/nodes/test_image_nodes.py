"""Nodes that look at images: answers, encodings, what they refuse, and their diagnostics."""

import dataclasses
import math
import threading
import time

import numpy as np
import pytest
import rospy
from marker_images import CAMERA, View, image_of, marker, true_corners
from message_fields import plain
from sensor_msgs.msg import CameraInfo
from shared import cases

from bullet_lab.core.parameters import read_parameters
from bullet_lab.ros.messages.images import image_message, pixels_of
from bullet_lab.ros.nodes import aruco, image_node
from bullet_lab.ros.nodes.aruco import Aruco, ArucoParameters
from bullet_lab.ros.nodes.image_node import (
    CannyEdges,
    CannyParameters,
    GoodFeatures,
    GoodFeaturesParameters,
    HarrisCorners,
    HarrisParameters,
    ImageParameters,
    ViewCamera,
)

NODE = image_node
FRAME = "camera_optical_frame"
CORNERS = ((200, 150), (400, 150), (400, 350), (200, 350))
BLUE = (255, 0, 0)
VIEW = View(2.0, yaw=20.0, shift=(0.1, 0.05))


@pytest.fixture(autouse=True)
def without_ros(monkeypatch):
    monkeypatch.setattr(aruco, "tf_prefix", lambda _: "")
    # Nobody sends a camera_info later.
    monkeypatch.setattr(image_node, "_INFO_PATIENCE", 0.0)


def image(pixels, seconds=1.5, encoding="mono8"):
    """An image message."""
    message = image_message(rospy.Header(frame_id=FRAME), pixels, encoding)
    message.header.stamp = rospy.Time.from_sec(seconds)
    return message


def camera_info(camera=CAMERA):
    """The camera_info of a camera."""
    matrix = camera.matrix.ravel().tolist()
    lens = list(camera.distortion)
    return CameraInfo(height=480, width=640, distortion_model="plumb_bob", D=lens, K=matrix)


def marker_image(view=VIEW, camera=CAMERA):
    return image_of([marker()], view, camera, samples=4)


def finder(info):
    """A node that finds markers, and has a camera_info."""
    node = Aruco(ArucoParameters())
    node._receive_info(info)
    return node


def square():
    """A white square on dark ground, with its corners at CORNERS."""
    pixels = np.full((480, 640), 60, np.uint8)
    pixels[150:351, 200:401] = 220
    return pixels


def answers(node, published, message, *topics):
    """What a node publishes for an image, with its stamp and frame."""
    node._receive_image(message)
    found = [published[f"~{topic}"][-1] for topic in topics]
    for one in found:
        assert (one.header.stamp, one.header.frame_id) == (message.header.stamp, FRAME)
    return found


def test_edges_are_where_the_square_ends_and_blue(published):
    node = CannyEdges(CannyParameters())
    edges, drawn = answers(node, published, image(square()), "edges", "image_annotated")
    assert edges.encoding == "mono8"
    seen = pixels_of(edges, "mono8")
    assert set(np.unique(seen)) == {0, 255}
    row, column = np.nonzero(seen)
    found = (column.min(), column.max(), row.min(), row.max())
    np.testing.assert_allclose(found, (199, 401, 149, 351), atol=1)
    assert not seen[160:340, 210:390].any()
    pixels = pixels_of(drawn, "bgr8")
    assert (pixels[140:160, 300] == BLUE).all(axis=1).any()
    assert pixels[20, 20].tolist() == [60, 60, 60]


@pytest.mark.parametrize(
    ("kind", "parameters"),
    [(GoodFeatures, GoodFeaturesParameters), (HarrisCorners, HarrisParameters)],
)
def test_corners_are_those_of_the_square_and_blue(published, kind, parameters):
    node = kind(parameters())
    answer, drawn = answers(node, published, image(square()), "points", "image_annotated")
    assert (answer.width, answer.height) == (640, 480)
    points = np.array([(p.x, p.y, p.z) for p in answer.points])
    away = np.linalg.norm(points[:, None, :2] - np.array(CORNERS), axis=2)
    assert away.min(axis=0).max() < 3.0
    assert (np.diff(points[:, 2]) <= 0.0).all()
    pixels = pixels_of(drawn, "bgr8")
    for u, v in CORNERS:
        assert (pixels[v - 2 : v + 3, u - 2 : u + 3] == BLUE).all(axis=2).any()


@pytest.mark.parametrize(
    ("node", "figures"),
    [
        (lambda: CannyEdges(CannyParameters(low=2000.0, high=2000.0)), {"edge pixels": 0}),
        (lambda: GoodFeatures(GoodFeaturesParameters(max_corners=2)), {"features": 2}),
        (lambda: HarrisCorners(HarrisParameters(threshold=1.0)), {"corners": 0}),
    ],
)
def test_parameters_count(published, node, figures):
    assert node().process(image_node.CameraImage(image(square()), None)) == figures


@cases("""
encoding, channels:
  - [bgr8, [0, 1, 2]]
  - [rgb8, [2, 1, 0]]
  - [bgra8, [0, 1, 2, 3]]
  - [rgba8, [2, 1, 0, 3]]
""")
def test_encodings_that_cameras_have(encoding, channels):
    colours = np.full((480, 640, 4), (10, 120, 230, 255), np.uint8)[..., channels]
    seen = image(colours, encoding=encoding)
    assert pixels_of(seen, "bgr8")[300, 300].tolist() == [10, 120, 230]


def bad_image(which):
    """An image that none can be made of."""
    message = image(marker_image() if which != "tiny" else np.zeros((4, 4), np.uint8))
    if which == "short":
        message.data = message.data[:-1]
    elif which != "tiny":
        message.encoding = which
    return message


@cases("which: [32FC1, no such, short, tiny]")
def test_images_that_are_none_are_answered_without_a_marker(published, which):
    node = finder(camera_info())
    (answer,) = answers(node, published, bad_image(which), "detections")
    assert answer.detections == []


def test_images_that_are_none_are_refused(published, logged):
    node = GoodFeatures(GoodFeaturesParameters())
    node._receive_image(bad_image("no such"))
    assert not published["~points"]
    assert logged[0].startswith("/mycamera/image_raw: refused:")
    answers(node, published, image(square(), 3.0), "points")


def test_a_stamp_that_comes_twice_is_refused_and_time_may_be_set_back(published):
    node = ViewCamera(ImageParameters())
    for stamp in (5.0, 5.0, 6.0, 6.0, 1.0, 1.0):
        node._receive_image(image(square(), stamp))
    stamps = [m.header.stamp.to_sec() for m in published["~image_annotated"]]
    assert stamps == [5.0, 6.0, 1.0]
    assert node._refusals.total == 3


def place_of(found):
    place = found.pose.pose.position
    return [place.x, place.y, place.z]


def test_the_lens_of_a_raw_image(published):
    bent = dataclasses.replace(CAMERA, distortion=(-0.3, 0.1, 0.001, -0.001, 0.0))
    view = View(1.0, yaw=25.0, shift=(0.35, 0.2))
    node = finder(camera_info(bent))
    (answer,) = answers(node, published, image(marker_image(view, bent)), "detections")
    assert place_of(answer.detections[0]) == pytest.approx(view.translation, abs=0.005)


def test_chosen_markers_of_rectified_images_have_transforms(published, monkeypatch):
    monkeypatch.setattr(aruco, "publisher", image_node.publisher)
    layout = [{"id": 7, "size": 0.4, "x": 0.1}, {"id": 3, "size": 0.2}]
    bundles = [{"name": "panel", "layout": layout}]
    given = {"tags": "4x4_50", "ids": "3 7", "sizes": "7=0.4", "tag_bundles": bundles}
    given.update(rectified=True, publish_tf=True)
    parameters = read_parameters(ArucoParameters, lambda name, none: given.get(name[1:], none))
    node, view = Aruco(parameters), View(1.0, yaw=25.0, shift=(0.35, 0.2))
    # Of a rectified image, the lens does not matter.
    about = camera_info(dataclasses.replace(CAMERA, distortion=(-0.3, 0.1, 0.001, -0.001, 0.0)))
    about.P = np.column_stack((CAMERA.matrix, (0.0, 0.0, 0.0))).ravel().tolist()
    node._receive_info(about)
    seen = image_of([marker(7, size=0.4, tags="4x4_50")], view, samples=4)
    (answer,) = answers(node, published, image(seen), "detections")
    ((found,), (bundle,)) = answer.detections, answer.bundles
    assert (found.id, found.dictionary, found.size) == (7, "DICT_4X4_50", 0.4)
    assert place_of(found) == pytest.approx(view.translation, abs=0.005)
    assert (bundle.name, bundle.ids) == ("panel", (7,))
    (one, panel) = published["/tf"][0].transforms
    assert (one.child_frame_id, one.header.frame_id) == ("fiducial_7", FRAME)
    assert panel.child_frame_id == "panel"
    ends = [plain(each.transform.translation) for each in (one, panel)]
    assert math.dist(*ends) == pytest.approx(0.1, abs=1e-6)
    assert np.linalg.norm(plain(one.transform.rotation)) == pytest.approx(1.0, abs=1e-9)
    other = image_of([marker(9, tags="4x4_50")], VIEW, samples=4)
    (answer,) = answers(node, published, image(other, 3.0), "detections")
    assert not answer.detections


@cases("""
topic:
  - "/cam/{}"
  - "cam/{}"
  - "/{}"
  - "{}"
""")
def test_camera_info_is_beside_the_image(topic):
    assert ImageParameters(topic.format("image")).info_topic == topic.format("camera_info")


def test_camera_info_is_waited_for_by_the_first_image(published, monkeypatch):
    monkeypatch.setattr(image_node, "_INFO_PATIENCE", 600.0)
    node, seen = Aruco(ArucoParameters()), []
    node.process = lambda image: seen.append(image.info) or {}
    looking = threading.Thread(target=node._receive_image, args=[image(marker_image())])
    looking.start()
    while not node._lock._waiters and not seen:
        time.sleep(0.001)
    node._receive_info(camera_info())
    looking.join()
    (info,) = seen
    assert info.K == camera_info().K


def test_a_marker_where_it_is(published):
    node = finder(camera_info())
    topics = ("detections", "pose", "pose_with_covariance", "image_annotated", "camera_info")
    all_of_them, pose, with_covariance, _, _ = answers(
        node, published, image(marker_image()), *topics
    )
    (found,) = all_of_them.detections
    assert (found.id, found.dictionary, found.size) == (0, "DICT_APRILTAG_36h10", 0.2)
    corners = np.reshape(found.corners, (4, 2))
    assert np.abs(corners - true_corners(VIEW)).max() < 0.1
    assert place_of(found) == pytest.approx(VIEW.translation, abs=0.01)
    assert found.pose.covariance[0] > 0.0
    assert found.reprojection_error < found.alternative_reprojection_error
    assert not found.ambiguous
    assert found.pose.pose == pose.pose
    assert found.pose == with_covariance.pose


@pytest.mark.parametrize(("pixels", "number"), [(marker_image(), 1), (square(), 0)])
def test_every_image_is_answered_also_without_a_marker(published, pixels, number):
    node = finder(camera_info())
    (answer,) = answers(node, published, image(pixels), "detections")
    assert len(answer.detections) == number
    level, line = node.health
    assert (level, "id 0 at 2.0" in line) == ((0, True) if number else (1, False))


def test_a_camera_that_is_none(published):
    zero = camera_info()
    zero.K = [0.0] * 9
    node = finder(zero)
    (answer,) = answers(node, published, image(marker_image()), "detections")
    assert answer.detections[0].size == 0.0
    assert node.health.level == 2
    assert "zero K" in node.health.message
