"""Markers as messages."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, PoseWithCovariance, Quaternion, TransformStamped, Vector3
from geometry_msgs.msg import Pose as PoseMessage
from std_msgs.msg import Header

from bullet_lab.msg import MarkerDetection
from bullet_lab.vision.marker_detector import DetectedMarker
from bullet_lab.vision.marker_pose import MarkerPose, ObservedMarker


def marker_pose_message(pose: MarkerPose) -> PoseMessage:
    """Return a marker's pose in the optical frame as a message."""
    return PoseMessage(Point(*map(float, pose.translation)), Quaternion(*pose.quaternion))


def covariance_message(pose: MarkerPose) -> PoseWithCovariance:
    """Return a marker's pose with its covariance as a message."""
    return PoseWithCovariance(marker_pose_message(pose), pose.covariance.ravel().tolist())


def detection_message(marker: DetectedMarker, dictionary: str) -> MarkerDetection:
    """Return a marker without a pose, for want of a camera_info, as a message."""
    message = MarkerDetection(id=marker.id, dictionary=dictionary, bit_errors=marker.bit_errors)
    message.corners = np.asarray(marker.corners, dtype=float).ravel().tolist()
    message.pose.pose.orientation.w = message.alternative_pose.orientation.w = 1.0
    return message


def located_message(
    marker: DetectedMarker, dictionary: str, observed: ObservedMarker, pose: MarkerPose
) -> MarkerDetection:
    """Return a marker with the pose that was chosen of the two as a message."""
    message = detection_message(marker, dictionary)
    estimate = observed.pose
    other = estimate.alternative if pose is estimate.best else estimate.best
    message.size = observed.size
    message.pose = covariance_message(pose)
    message.reprojection_error = pose.error
    message.alternative_pose = marker_pose_message(other)
    message.alternative_reprojection_error = other.error
    message.ambiguous = estimate.ambiguous
    return message


def marker_transform(header: Header, frame: str, pose: MarkerPose) -> TransformStamped:
    """Return a marker's pose as the transform of a frame."""
    message = TransformStamped(header=header, child_frame_id=frame)
    message.transform.translation = Vector3(*map(float, pose.translation))
    message.transform.rotation = Quaternion(*pose.quaternion)
    return message
