"""What devices measure and what they are told, as plain data.

Every sample carries the simulated time `step` in whole milliseconds. The ROS side turns each
kind into its message in `bullet_lab.ros.conversions`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from bullet_lab.numerics.pinhole import PinholeCamera
from bullet_lab.simulation.pose import Pose

# Row-major diagonals in REP 103 order x, y, z, rotation about x, y, z.
Diagonal = Tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class PlanarCommand:
    """A wanted body velocity: m/s ahead and to the left, rad/s counter-clockwise."""

    vx: float = 0.0
    vy: float = 0.0
    wz: float = 0.0


@dataclass(frozen=True)
class OdometrySample:
    """Pose of `child_frame` in `frame`, and its velocity in its own frame.

    The pose covariance is diagonal (m² and rad²); the twist's is zero, as Gazebo sends it.
    """

    step: int
    frame: str
    child_frame: str
    pose: Pose
    velocity: PlanarCommand
    pose_variances: Diagonal


@dataclass(frozen=True)
class TransformSample:
    """Pose of `child_frame` in `frame`, for TF."""

    step: int
    frame: str
    child_frame: str
    pose: Pose


@dataclass(frozen=True)
class JointSample:
    """States of joints: positions in rad or m, velocities per second, efforts in N m or N."""

    step: int
    names: Tuple[str, ...]
    positions: Tuple[float, ...]
    velocities: Tuple[float, ...]
    efforts: Tuple[float, ...]


@dataclass(frozen=True)
class ImageSample:
    """An image as `frame`, an optical frame, sees it.

    `encoding` is one of sensor_msgs/image_encodings; `pixels` has the shape (height, width, 3)
    or (height, width) and is not changed after it was sent.
    """

    step: int
    frame: str
    encoding: str
    pixels: np.ndarray


@dataclass(frozen=True)
class CameraInfoSample:
    """Geometry of the images of one camera; `baseline` in metres is Gazebo's hackBaseline."""

    step: int
    frame: str
    camera: PinholeCamera
    baseline: float = 0.0
