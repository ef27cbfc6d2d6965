"""View of a camera: the image with a line on it, and its size and rate.

:ROS Parameters: see `ImageParameters`.
:ROS Subscribers, while somebody listens: ~image and its camera_info
:ROS Publishers: ~image_annotated, ~camera_info, /diagnostics, see `image_node`
"""

from __future__ import annotations

from typing import Any, Mapping

from bullet_lab.ros.nodes.image_node import CameraImage, ImageNode, ImageParameters, run_image_node
from bullet_lab.vision.drawing import draw_text


class ViewCamera(ImageNode):
    """Passes images on with their time and size written into them."""

    task = "camera view"

    def process(self, image: CameraImage) -> Mapping[str, Any]:
        """Publish the image."""
        size = f"{image.width} x {image.height}"
        stamp = image.header.stamp.to_sec()
        self.annotate(image, lambda canvas: draw_text(canvas, f"{size}  {stamp:.2f} s", (8, 16)))
        return {"size": size, "mean grey level": f"{image.grey.mean():.0f}"}


def main() -> None:
    """Run the node."""
    run_image_node("view_camera", ImageParameters, ViewCamera)
