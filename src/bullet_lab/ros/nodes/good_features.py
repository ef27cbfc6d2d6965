"""Detector of good features to track (Shi and Tomasi).

:ROS Parameters: see `GoodFeaturesParameters`.
:ROS Subscribers, while a result has a subscriber: ~image and its camera_info
:ROS Publishers:
    - ~points (bullet_lab/ImagePoints), the strongest first
    - ~image_annotated (blue discs, as in figure 7c), ~camera_info, /diagnostics, see `image_node`
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping

from bullet_lab.core.parameters import integer, number
from bullet_lab.msg import ImagePoints
from bullet_lab.ros.messages.images import points_message
from bullet_lab.ros.nodes.image_node import CameraImage, ImageNode, ImageParameters, run_image_node
from bullet_lab.vision.drawing import draw_points
from bullet_lab.vision.features import good_features


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

    def process(self, image: CameraImage) -> Mapping[str, Any]:
        """Publish the features."""
        given = self.parameters
        points = good_features(image.grey, given.max_corners, given.quality, given.min_distance)
        self.publish("points", points_message(image.header, image.grey.shape, points))
        self.annotate(image, lambda canvas: draw_points(canvas, points))
        return {"features": len(points)}


def main() -> None:
    """Run the node."""
    run_image_node("good_features", GoodFeaturesParameters, GoodFeatures)
