"""Nodes that look at images: answers, encodings, what they refuse, and their diagnostics."""

import dataclasses
import threading
import time

import numpy as np
import pytest
import rospy
from alike import lines_of
from marker_images import CAMERA, View, image_of, marker
from message_fields import lines_of_message
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
    """A white square on dark ground, from (200, 150) to (400, 350) px."""
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


def marked(pixels):
    """The number of pixels that are not 0, and the sums of their rows and columns."""
    rows, columns = np.nonzero(pixels)
    return len(rows), rows.sum(), columns.sum()


def test_edges_and_corners_of_a_square_are_as_before(published, as_before):
    nodes = {
        "edges": CannyEdges(CannyParameters()),
        "no edges": CannyEdges(CannyParameters(low=2000.0, high=2000.0)),
        "features": GoodFeatures(GoodFeaturesParameters()),
        "two features": GoodFeatures(GoodFeaturesParameters(max_corners=2)),
        "corners": HarrisCorners(HarrisParameters()),
        "no corners": HarrisCorners(HarrisParameters(threshold=1.0)),
    }
    told = []
    for name, node in nodes.items():
        (drawn,) = answers(node, published, image(square()), "image_annotated")
        for answer in published["~points"]:
            told += lines_of([answer.width, answer.height, len(answer.points)], name)
            # All are as strong.
            told += lines_of(sorted((p.x, p.y) for p in answer.points if "two" not in name), name)
        for edges in published["~edges"]:
            told += lines_of([edges.encoding, *marked(pixels_of(edges, "mono8"))], name)
        blue = (pixels_of(drawn, "bgr8") == BLUE).all(axis=2)
        told += lines_of([*marked(blue)] if "two" not in name else [], f"{name}: blue")
        told += lines_of(node.process(image_node.CameraImage(image(square()), None)), name)
        for sent in published.values():
            sent.clear()
    as_before(told, "corners.txt", within=1e-4)


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


BENT = dataclasses.replace(CAMERA, distortion=(-0.3, 0.1, 0.001, -0.001, 0.0))


def finders():
    """Names and parameters of nodes that find markers, their camera_info and their images."""
    plain, none, rectified = camera_info(), camera_info(), camera_info(BENT)
    none.K = [0.0] * 9
    # Of a rectified image, the lens does not matter.
    rectified.P = np.column_stack((CAMERA.matrix, (0.0, 0.0, 0.0))).ravel().tolist()
    aside, usual = View(1.0, yaw=25.0, shift=(0.35, 0.2)), image(marker_image())
    wrong = map(bad_image, ("32FC1", "no such", "short", "tiny"))
    yield "usual", {}, plain, [usual, image(square()), *wrong]
    yield "without a camera", {}, none, [usual]
    yield "bent", {}, camera_info(BENT), [image(marker_image(aside, BENT))]
    layout = [{"id": 7, "size": 0.4, "x": 0.1}, {"id": 3, "size": 0.2}]
    given = {"tags": "4x4_50", "ids": "3 7", "sizes": "7=0.4", "rectified": True}
    given.update(tag_bundles=[{"name": "panel", "layout": layout}], publish_tf=True)
    shown = (marker(7, size=0.4, tags="4x4_50"), aside), (marker(9, tags="4x4_50"), VIEW)
    images = [image(image_of([layer], view, samples=4)) for layer, view in shown]
    yield "chosen", given, rectified, images


def lines_of_answers(node, published, images):
    """Yield lines for all that a node publishes for images, but for what it draws."""
    for number, seen in enumerate(images):
        for sent in published.values():
            sent.clear()
        seen.header.stamp = rospy.Time(number + 1)
        node._receive_image(seen)
        yield from lines_of(node.health, f"image {number}")
        for topic, sent in sorted(published.items()):
            yield f"{topic} {len(sent)} times"
            for one in sent if topic != "~image_annotated" else ():
                yield from lines_of_message(one, topic)
                for found in getattr(one, "detections", ()):
                    # In units that leave some digits.
                    yield from lines_of(1e6 * np.array(found.pose.covariance), "covariance")


def test_each_image_is_answered_with_its_markers_as_before(published, monkeypatch, as_before):
    monkeypatch.setattr(aruco, "publisher", image_node.publisher)
    told = []
    for name, given, info, images in finders():
        parameters = {f"~{at}": value for at, value in given.items()}
        node = Aruco(read_parameters(ArucoParameters, parameters.get))
        node._receive_info(info)
        told += [f"# {name}", *lines_of_answers(node, published, images)]
    # Other processors round others.
    as_before(told, "detections.txt", within=2e-3)


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
