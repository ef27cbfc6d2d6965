"""What plugins measure and what they are told, as plain data.

Every sample carries the simulated time `step` in whole milliseconds. The ROS side turns each
kind into its message in `bullet_lab.ros.messages.conversions`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Mapping, Tuple

import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose, Quaternion, Vector

# Row-major diagonals in REP 103 order x, y, z, rotation about x, y, z.
Diagonal = Tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Sample:
    """What was measured at the simulated time `step`, in `frame`."""

    step: int
    frame: str


LARGEST_COMMAND = 1e6
"""Of a velocity, a position or an effort, in SI units; of what is larger the engine makes NaN."""


def is_sound(*values: float) -> bool:
    """Return whether all numbers of a command are finite, and not out of all proportion.

    >>> is_sound(0.5, -1e6), is_sound(1e308), is_sound(float("nan"))
    (True, False, False)
    """
    return all(abs(value) <= LARGEST_COMMAND for value in values)


@dataclass(frozen=True)
class PlanarCommand:
    """The velocity that a robot shall have: m/s ahead and to the left, rad/s counter-clockwise."""

    vx: float = 0.0
    vy: float = 0.0
    wz: float = 0.0


@dataclass(frozen=True)
class JointCommand:
    """What a joint shall do: a position (rad or m), a velocity or an effort."""

    value: float


@dataclass(frozen=True)
class JointCommands:
    """What the joints of a group shall do, in their order."""

    values: Tuple[float, ...]


@dataclass(frozen=True)
class Stop:
    """Whether the emergency stop is pressed."""

    pressed: bool


@dataclass(frozen=True)
class OdometrySample(Sample):
    """Pose of `child_frame` in `frame`, and its velocity in its own frame.

    The covariances are diagonal (m² and rad², per s² for the twist's, which is zero for most, as
    Gazebo sends it).
    """

    child_frame: str
    pose: Pose
    velocity: PlanarCommand
    pose_variances: Diagonal
    twist_variances: Diagonal = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class VelocitySample(Sample):
    """The velocity that a robot is told, as far as its limits allow."""

    velocity: PlanarCommand


@dataclass(frozen=True)
class TransformSample(Sample):
    """Pose of `child_frame` in `frame`, for TF."""

    child_frame: str
    pose: Pose


@dataclass(frozen=True)
class JointSample:
    """States of joints: positions in rad or m, velocities per second, efforts in N m or N.

    Velocities and efforts may be left out.
    """

    step: int
    names: Tuple[str, ...]
    positions: Tuple[float, ...]
    velocities: Tuple[float, ...] = ()
    efforts: Tuple[float, ...] = ()
    # They are in no frame.
    frame: ClassVar[str] = ""


@dataclass(frozen=True)
class LoopSample:
    """How a control loop of one joint stands, `seconds` after the last time.

    `value` is what it brings to `target`, `slope` the velocity of a position, `command` what the
    joint is told; `gains` are p, i, d and the greatest contribution of the integral.
    """

    step: int
    target: float
    value: float
    slope: float
    error: float
    seconds: float
    command: float
    gains: Tuple[float, float, float, float]
    antiwindup: bool
    frame: ClassVar[str] = ""


@dataclass(frozen=True)
class ImageSample(Sample):
    """An image as `frame`, an optical frame, sees it.

    `encoding` is one of sensor_msgs/image_encodings; `pixels` are (height, width, 3) or (height,
    width) and never changed. A depth image holds metres along the optical axis, NaN where nothing
    was measured (32FC1), or mm and 0 (16UC1).
    """

    encoding: str
    pixels: np.ndarray


@dataclass(frozen=True)
class CameraInfoSample(Sample):
    """Geometry of the images of one camera; `baseline` in metres is Gazebo's hackBaseline.

    `calibration` has what somebody says instead, by the names of the message's fields.
    """

    camera: PinholeCamera
    baseline: float = 0.0
    calibration: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class PointsSample(Sample):
    """What a depth camera sees, as points in `frame`, an optical one.

    `points` are x, y, z in m, NaN where nothing was measured, shape (height, width, 3) float32;
    `colours` are RGB, shape (height, width, 3) uint8.
    """

    points: np.ndarray
    colours: np.ndarray


@dataclass(frozen=True)
class LaserSample(Sample):
    """Distances that a laser scanner has measured, all at one moment.

    Angles in rad about the z axis of `frame`; `ranges` and `intensities` of shape (rays,), the
    former in m, +inf for nothing within `range_max` and -inf for something nearer than
    `range_min`; several rows one after the other.
    """

    angle_min: float
    angle_max: float
    angle_increment: float
    range_min: float
    range_max: float
    ranges: np.ndarray
    intensities: np.ndarray


@dataclass(frozen=True)
class RangeSample(Sample):
    """A distance (m) by sonar or infrared along x of `frame`; `field_of_view` is in rad."""

    infrared: bool
    field_of_view: float
    range_min: float
    range_max: float
    range: float


@dataclass(frozen=True)
class ImuSample(Sample):
    """What an inertial unit measures in its own axes, those of `frame`.

    `orientation` is the unit quaternion of the frame in the world, `angular_velocity` in rad/s,
    `specific_force` in m/s² (+g along z at rest, as an accelerometer reads). Each has one
    variance for all three axes, in rad², (rad/s)² and (m/s²)².
    """

    orientation: Quaternion
    angular_velocity: Vector
    specific_force: Vector
    orientation_variance: float
    angular_velocity_variance: float
    specific_force_variance: float


@dataclass(frozen=True)
class MotionSample(Sample):
    """Pose and full velocity (m/s, rad/s) of `child_frame`; `variance` of every component."""

    child_frame: str
    pose: Pose
    linear: Vector
    angular: Vector
    variance: float


@dataclass(frozen=True)
class ShapeContact:
    """Two shapes that touch.

    `first` and `second` name them as model::link::shape. For each point of contact: the force
    in N and the torque in N m on the first shape's link (about its centre of mass), the place
    in m, the normal from the second shape to the first, and how deep they overlap in m.
    """

    first: str
    second: str
    forces: Tuple[Vector, ...]
    torques: Tuple[Vector, ...]
    positions: Tuple[Vector, ...]
    normals: Tuple[Vector, ...]
    depths: Tuple[float, ...]


@dataclass(frozen=True)
class ContactsSample(Sample):
    """All pairs of shapes that touch, with vectors in `frame`."""

    contacts: Tuple[ShapeContact, ...]
