"""Edge detector (Canny).

:ROS Parameters: see `CannyParameters`.
:ROS Subscribers, while a result has a subscriber: ~image and its camera_info
:ROS Publishers:
    - ~edges (sensor_msgs/Image), mono8: 255 on an edge, as in figure 7a
    - ~image_annotated (the edges in blue), ~camera_info, /diagnostics, see `image_node`
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping

import cv2
from sensor_msgs.msg import Image

from bullet_lab.core.parameters import number, odd
from bullet_lab.ros.messages.images import image_message
from bullet_lab.ros.nodes.image_node import CameraImage, ImageNode, ImageParameters, run_image_node
from bullet_lab.vision.drawing import draw_area


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

    def process(self, image: CameraImage) -> Mapping[str, Any]:
        """Publish the edges."""
        given = self.parameters
        edges = cv2.Canny(image.grey, given.low, given.high, apertureSize=given.aperture)
        if self.has_listeners("edges"):
            self.publish("edges", image_message(image.header, edges, "mono8"))
        self.annotate(image, lambda canvas: draw_area(canvas, edges > 0))
        return {"edge pixels": cv2.countNonZero(edges)}


def main() -> None:
    """Run the node."""
    run_image_node("canny_edges", CannyParameters, CannyEdges)
