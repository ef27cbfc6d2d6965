"""The detectors of figure 7: edges (Canny), corners (Harris), good features (Shi and Tomasi).

:ROS Parameters: see `CannyParameters`, `HarrisParameters` and `GoodFeaturesParameters`.
:ROS Subscribers, while a result has a subscriber: ~image and its camera_info
:ROS Publishers, beside ~camera_info and /diagnostics of `image_node`:
    - canny_edges: ~edges (sensor_msgs/Image), mono8: 255 on an edge, as in figure 7a
    - harris_corners, good_features: ~points (bullet_lab/ImagePoints), the strongest first
    - ~image_annotated (sensor_msgs/Image): edges in blue, squares as in figure 7d, discs as in 7c
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
from sensor_msgs.msg import Image

from bullet_lab.core.parameters import integer, number, odd
from bullet_lab.msg import ImagePoints
from bullet_lab.ros.messages.images import image_message, points_message
from bullet_lab.ros.node.node import node
from bullet_lab.ros.nodes.image_node import CameraImage, Diagnostics, ImageNode, ImageParameters
from bullet_lab.vision import features
from bullet_lab.vision.drawing import draw_area, draw_points


@dataclass(frozen=True)
class CannyParameters(ImageParameters):
    """Private parameters of canny_edges."""

    low: float = number(100.0, "least gradient of an edge pixel", minimum=0.0)
    high: float = number(200.0, "least gradient of a strong edge pixel", minimum=0.0)
    aperture: int = odd(3, "size of the Sobel operator, px", 3, 7)


class CannyEdges(ImageNode):
    """Publishes the edges of each image."""

    task = "edge detection"
    outputs = {"edges": Image}

    def process(self, image: CameraImage) -> Diagnostics:
        """Publish the edges."""
        given = self.parameters
        edges = cv2.Canny(image.grey, given.low, given.high, apertureSize=given.aperture)
        self.publish("edges", image_message(image.header, edges, "mono8"))
        self.annotate(image, lambda canvas: draw_area(canvas, edges > 0))
        return {"edge pixels": cv2.countNonZero(edges)}


@dataclass(frozen=True)
class HarrisParameters(ImageParameters):
    """Private parameters of harris_corners."""

    block_size: int = integer(2, "size of the neighbourhood, px", 1, 31)
    aperture: int = odd(3, "size of the Sobel operator, px", 1, 31)
    k: float = number(0.04, "Harris' free parameter", above=0.0, maximum=0.25)
    threshold: float = number(
        0.01, "least response, as a share of the largest", above=0.0, maximum=1.0
    )


class HarrisCorners(ImageNode):
    """Publishes the corners of each image."""

    task = "corner detection"
    outputs = {"points": ImagePoints}

    def process(self, image: CameraImage) -> Diagnostics:
        """Publish the corners."""
        given = self.parameters
        area, points = features.harris_corners(
            image.grey, given.block_size, given.aperture, given.k, given.threshold
        )
        self.publish("points", points_message(image.header, image.grey.shape, points))
        self.annotate(image, lambda canvas: draw_area(canvas, area))
        return {"corners": len(points)}


@dataclass(frozen=True)
class GoodFeaturesParameters(ImageParameters):
    """Private parameters of good_features."""

    max_corners: int = integer(25, "greatest number of features", 1, 100000)
    quality: float = number(
        0.01, "least strength, as a share of the strongest", above=0.0, maximum=1.0
    )
    min_distance: float = number(10.0, "px between two features", minimum=0.0)


class GoodFeatures(ImageNode):
    """Publishes the good features of each image."""

    task = "feature detection"
    outputs = {"points": ImagePoints}

    def process(self, image: CameraImage) -> Diagnostics:
        """Publish the features."""
        given = self.parameters
        points = features.good_features(
            image.grey, given.max_corners, given.quality, given.min_distance
        )
        self.publish("points", points_message(image.header, image.grey.shape, points))
        self.annotate(image, lambda canvas: draw_points(canvas, points))
        return {"features": len(points)}


@node
def canny_edges(parameters: CannyParameters) -> None:
    """Run until ROS shuts down."""
    CannyEdges(parameters).run()


@node
def harris_corners(parameters: HarrisParameters) -> None:
    """Run until ROS shuts down."""
    HarrisCorners(parameters).run()


@node
def good_features(parameters: GoodFeaturesParameters) -> None:
    """Run until ROS shuts down."""
    GoodFeatures(parameters).run()
