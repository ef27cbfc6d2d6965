"""Detects markers and computes their poses.

:ROS Parameters: see `ArucoParameters`.
:ROS Subscribers, while a result has a subscriber or ~publish_tf is true:
    - ~image (sensor_msgs/Image), mono8 or any colour, raw or rectified
    - ~camera_info (sensor_msgs/CameraInfo), by default beside the image
:ROS Publishers:
    - ~detections (bullet_lab/MarkerDetectionArray), for every image, also without a marker;
      without a usable camera_info the markers have no poses, and a size of 0
    - ~pose (geometry_msgs/PoseStamped) and ~pose_with_covariance
      (geometry_msgs/PoseWithCovarianceStamped) of the marker that is largest in the image
    - /tf, with ~publish_tf: fiducial_<id>, and the names of ~tag_bundles, in the camera's optical
      frame, with the node's tf_prefix
    - ~image_annotated, ~camera_info, /diagnostics, see `image_node`

Stamps and frames are those of the images.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Iterable, Mapping, Sequence

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from bullet_lab.core.parameters import boolean, checked, number
from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.msg import MarkerDetectionArray
from bullet_lab.ros.messages.images import (
    CameraGeometryError,
    bundle_message,
    camera_of,
    covariance_message,
    detection_message,
    marker_pose_message,
    marker_transform,
)
from bullet_lab.ros.node.lock_step import publisher
from bullet_lab.ros.node.node import node, tf_prefix
from bullet_lab.ros.nodes.image_node import (
    CameraImage,
    Diagnostics,
    Health,
    ImageNode,
    ImageParameters,
)
from bullet_lab.vision.drawing import draw_axes, draw_marker, draw_text
from bullet_lab.vision.marker_bundles import (
    Bundle,
    ObservedBundle,
    observe_bundles,
    read_bundles,
)
from bullet_lab.vision.marker_detector import Detections, DetectorSettings, why_nothing
from bullet_lab.vision.marker_pose import MarkerObserver, PoseMemory
from bullet_lab.vision.pose_fit import MarkerPose


def accept_sizes(value: Any) -> Mapping[int, float]:
    """Return the sizes by id of "7=0.1 9=0.05" or a dictionary; raises ValueError or TypeError."""
    if not isinstance(value, dict):
        value = dict(part.split("=", 1) for part in str(value).split())
    sizes = {int(number): float(size) for number, size in value.items()}
    if any(not math.isfinite(size) or size <= 0.0 for size in sizes.values()):
        raise ValueError
    return sizes


def accept_bundles(value: Any) -> tuple[Bundle, ...]:
    """Return the bundles of a list of dictionaries or bundles; raises ValueError or TypeError."""
    if all(isinstance(one, Bundle) for one in value):
        return tuple(value)
    try:
        return read_bundles(value)
    except (KeyError, AttributeError) as error:
        raise ValueError from error


@dataclass(frozen=True)
class ArucoParameters(ImageParameters, DetectorSettings):
    """Private parameters of aruco."""

    width: float = number(0.2, "edge of the black square of the markers, m", above=0.0)
    sizes: Mapping[int, float] | None = checked(
        None,
        "edges of markers with another size than ~width, m",
        "like 7=0.1 9=0.05: ids and edges in metres",
        accept_sizes,
    )
    tag_bundles: tuple[Bundle, ...] = checked(
        (),
        "markers that are fixed to each other and get one pose",
        "a list as in apriltag_ros: name and layout, with id, size, x, y, z, qx, qy, qz, qw",
        accept_bundles,
    )
    rectified: bool = boolean(False, "the images are rectified")
    upright: bool = boolean(
        True, "assume upright markers and a level camera if the image allows two poses"
    )
    publish_tf: bool = boolean(False, "publish transforms, and process all images")
    pixel_sigma: float = number(
        0.02, "standard deviation of corners in addition to that of the image's noise, px", 0.0
    )


class Aruco(ImageNode):
    """Publishes the markers of each image."""

    task = "marker detection"
    outputs = {
        "detections": MarkerDetectionArray,
        "pose": PoseStamped,
        "pose_with_covariance": PoseWithCovarianceStamped,
    }

    def __init__(self, parameters: ArucoParameters):
        bundled = {
            number: marker.size
            for bundle in parameters.tag_bundles
            for number, marker in bundle.markers.items()
        }
        sizes = {**bundled, **(parameters.sizes or {})}
        self._observer = MarkerObserver(parameters, parameters.width, sizes, parameters.pixel_sigma)
        self._memory, self._bundle_memory = (PoseMemory(parameters.upright) for _ in range(2))
        super().__init__(parameters, always=parameters.publish_tf)
        self._prefix = tf_prefix(rospy.get_name())
        self._tf = publisher("/tf", TFMessage, 10) if parameters.publish_tf else None

    def process(self, image: CameraImage) -> Diagnostics:
        """Publish the markers."""
        camera, problem = self._camera(image)
        detections = self._observer.observe(image.grey, camera)
        markers = detections.markers
        if camera is None:
            poses, bundles = [None] * len(markers), []
        else:
            stamp = image.header.stamp.to_sec()
            poses = self._memory.choose(markers, stamp)
            bundles = self._bundles(markers, camera, stamp)
        self._publish_markers(image.header, markers, poses, bundles)
        self.annotate(image, lambda canvas: self._draw(canvas, detections, poses, camera))
        self.health = problem or self._judge(detections, poses)
        return _figures(detections)

    def process_unusable(self, image: CameraImage) -> None:
        """Publish an empty list of markers."""
        self.publish("detections", MarkerDetectionArray(header=image.header))

    def reset(self) -> None:
        """Forget the earlier poses of markers."""
        self._memory.forget()
        self._bundle_memory.forget()

    def _camera(self, image: CameraImage) -> tuple[PinholeCamera | None, Health | None]:
        """Return the camera, or None and the reason."""
        topic = self.parameters.info_topic
        if image.info is None:
            reason = f"no camera_info on {topic}: markers have no poses"
            return None, Health(DiagnosticStatus.WARN, reason)
        try:
            rectified = self.parameters.rectified
            return camera_of(image.info, image.width, image.height, rectified), None
        except CameraGeometryError as error:
            self.refuse(topic, str(error))
            return None, Health(DiagnosticStatus.ERROR, str(error))

    def _bundles(
        self, markers: Sequence[Any], camera: PinholeCamera, stamp: float
    ) -> list[tuple[ObservedBundle, MarkerPose]]:
        parameters = self.parameters
        found = list(
            observe_bundles(parameters.tag_bundles, markers, camera, parameters.pixel_sigma)
        )
        return list(zip(found, self._bundle_memory.choose(found, stamp)))

    def _publish_markers(
        self,
        header: Header,
        markers: Sequence[Any],
        poses: Sequence[MarkerPose | None],
        bundles: Sequence[tuple[ObservedBundle, MarkerPose]],
    ) -> None:
        tags = self.parameters.tags
        message = MarkerDetectionArray(header=header)
        message.detections = [detection_message(*one, tags) for one in zip(markers, poses)]
        message.bundles = [bundle_message(*one) for one in bundles]
        self.publish("detections", message)
        if not poses or poses[0] is None:
            return
        self.publish("pose", PoseStamped(header, marker_pose_message(poses[0])))
        covariance = PoseWithCovarianceStamped(header, covariance_message(poses[0]))
        self.publish("pose_with_covariance", covariance)
        if self._tf is not None:
            # Of several markers with one id, the largest in the image.
            by_id = {marker.id: pose for marker, pose in list(zip(markers, poses))[::-1]}
            transforms = [
                marker_transform(header, f"{self._prefix}fiducial_{number}", pose)
                for number, pose in by_id.items()
            ]
            transforms += [
                marker_transform(header, self._prefix + bundle.id, pose) for bundle, pose in bundles
            ]
            self._tf.publish(TFMessage(transforms))

    def _draw(
        self,
        canvas: np.ndarray,
        detections: Detections,
        poses: Sequence[MarkerPose | None],
        camera: PinholeCamera | None,
    ) -> None:
        # Outlines are above the axes of all markers.
        for marker, pose in zip(detections.markers, poses):
            if pose is not None:
                draw_axes(canvas, pose, marker.size, camera)
        for marker, pose in zip(detections.markers, poses):
            label = "" if pose is None else f"  {pose.distance:.2f} m"
            draw_marker(canvas, marker, f"id {marker.id}{label}")
        if not detections.markers:
            draw_text(canvas, why_nothing(detections.report, self.parameters.tags), (8, 16))

    def _judge(self, detections: Detections, poses: Sequence[MarkerPose]) -> Health:
        if not detections.markers:
            reason = why_nothing(detections.report, self.parameters.tags)
            return Health(DiagnosticStatus.WARN, f"no marker: {reason}")
        found = [f"id {m.id} at {p.distance:.2f} m" for m, p in zip(detections.markers, poses)]
        return Health(DiagnosticStatus.OK, ", ".join(found))


def _figures(detections: Detections) -> Diagnostics:
    report = detections.report
    sides = [marker.side for marker in detections.markers]
    return {
        "detections": len(detections.markers),
        "ids": _words(marker.id for marker in detections.markers),
        "other ids": _words(report.other_ids),
        "cropped": _words(report.cropped),
        "quadrilaterals": report.quads,
        "undecoded": report.undecoded,
        "second pass": report.second_pass,
        "mean grey level": f"{report.mean:.0f}",
        "grey levels in use": f"{report.contrast:.0f}",
        "noise": f"{report.noise:.1f}",
        "smallest side (px)": f"{min(sides):.1f}" if sides else "",
    }


def _words(ids: Iterable[int]) -> str:
    return " ".join(str(number) for number in sorted(set(ids)))


@node
def aruco(parameters: ArucoParameters) -> None:
    """Run until ROS shuts down."""
    Aruco(parameters).run()
