"""Corner detector (Harris).

:ROS Parameters: see `HarrisParameters`.
:ROS Subscribers, while a result has a subscriber: ~image and its camera_info
:ROS Publishers:
    - ~points (bullet_lab/ImagePoints), the strongest first
    - ~image_annotated (blue squares, as in figure 7d), ~camera_info, /diagnostics, see
      `image_node`
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping

from bullet_lab.core.parameters import integer, number, odd
from bullet_lab.msg import ImagePoints
from bullet_lab.ros.messages.images import points_message
from bullet_lab.ros.nodes.image_node import CameraImage, ImageNode, ImageParameters, run_image_node
from bullet_lab.vision.drawing import draw_area
from bullet_lab.vision.features import harris_corners


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

    def process(self, image: CameraImage) -> Mapping[str, Any]:
        """Publish the corners."""
        given = self.parameters
        area, points = harris_corners(
            image.grey, given.block_size, given.aperture, given.k, given.threshold
        )
        self.publish("points", points_message(image.header, image.grey.shape, points))
        self.annotate(image, lambda canvas: draw_area(canvas, area))
        return {"corners": len(points)}


def main() -> None:
    """Run the node."""
    run_image_node("harris_corners", HarrisParameters, HarrisCorners)
