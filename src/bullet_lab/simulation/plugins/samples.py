"""The samples of plugins, and the commands to them, as plain data.

Every sample has the simulated time `step` in whole milliseconds.
`bullet_lab.ros.messages.conversions` converts each kind to its message.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Mapping, NamedTuple, Tuple, Union

import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose, Quaternion, Vector

# Row-major diagonals in REP 103 order x, y, z, rotation about x, y, z.
Diagonal = Tuple[float, float, float, float, float, float]
# The variance of each axis, or one for all three.
Variance = Union[float, Vector]


@dataclass(frozen=True)
class Sample:
    """A measurement at the simulated time `step`, in `frame`."""

    step: int
    frame: str


LARGEST_COMMAND = 1e6
"""Greatest velocity, position or effort, in SI units; larger ones become NaN in the engine."""


def is_sound(*values: float) -> bool:
    """Return whether all numbers of a command are finite and within `LARGEST_COMMAND`.

    >>> is_sound(0.5, -1e6), is_sound(1e308), is_sound(float("nan"))
    (True, False, False)
    """
    return all(abs(value) <= LARGEST_COMMAND for value in values)


@dataclass(frozen=True)
class PlanarCommand:
    """A velocity command: m/s ahead and to the left, rad/s counter-clockwise."""

    vx: float = 0.0
    vy: float = 0.0
    wz: float = 0.0

    def rims(self, separation: float) -> tuple[float, float]:
        """Return the speeds (m/s) of left and right wheels that are `separation` (m) apart."""
        side = 0.5 * self.wz * separation
        return self.vx - side, self.vx + side


STANDSTILL = PlanarCommand()


@dataclass(frozen=True)
class JointCommand:
    """A command to a joint: a position (rad or m), a velocity or an effort."""

    value: float


@dataclass(frozen=True)
class JointCommands:
    """A command to the joints of a group, in their order."""

    values: tuple[float, ...]


class TrajectoryPoint(NamedTuple):
    """States of joints `seconds` after a start; velocities and accelerations may be empty."""

    seconds: float
    positions: tuple[float, ...]
    velocities: tuple[float, ...] = ()
    accelerations: tuple[float, ...] = ()


class Trajectory(NamedTuple):
    """Points for joints to pass, in the order of their names, from the time `start` (s; 0: now)."""

    start: float
    joints: tuple[str, ...]
    points: tuple[TrajectoryPoint, ...]


class TrajectoryGoal(NamedTuple):
    """A trajectory with tolerances of position and velocity by joint, on the path and at its end.

    The end may be late by `seconds`. A tolerance of 0 means the default, a negative one none.
    """

    trajectory: Trajectory
    path: Mapping[str, tuple[float, ...]]
    goal: Mapping[str, tuple[float, ...]]
    seconds: float


@dataclass(frozen=True)
class Stop:
    """Whether the emergency stop is pressed."""

    pressed: bool


@dataclass(frozen=True)
class MotorPower:
    """Whether the motors have power."""

    on: bool


@dataclass(frozen=True)
class Trigger:
    """A command without content, such as to take a picture."""


@dataclass(frozen=True)
class TransformSample(Sample):
    """Pose of `child_frame` in `frame`, for TF."""

    child_frame: str
    pose: Pose


@dataclass(frozen=True)
class OdometrySample(TransformSample):
    """Pose of `child_frame` in `frame`, and its velocity in its own frame.

    The covariances are diagonal, in m² and rad²; the twist's per s². Most plugins send a zero
    twist covariance, as Gazebo's do.
    """

    velocity: PlanarCommand
    pose_variances: Diagonal
    twist_variances: Diagonal = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class VelocitySample(Sample):
    """A velocity command after its limits."""

    velocity: PlanarCommand


@dataclass(frozen=True)
class JointSample:
    """States of joints: positions in rad or m, velocities per second, efforts in N m or N.

    Velocities and efforts may be empty.
    """

    step: int
    names: tuple[str, ...]
    positions: tuple[float, ...] = ()
    velocities: tuple[float, ...] = ()
    efforts: tuple[float, ...] = ()
    # Joints have no frame, but a Kobuki names one.
    frame: str = ""


@dataclass(frozen=True)
class LoopSample:
    """The state of a control loop of one joint, `seconds` after the last update.

    The loop brings `value` to `target`; `slope` is the velocity of a position, `command` the
    output; `gains` are p, i, d and the greatest contribution of the integral.
    """

    step: int
    target: float
    value: float
    slope: float
    error: float
    seconds: float
    command: float
    gains: tuple[float, float, float, float]
    antiwindup: bool
    frame: ClassVar[str] = ""


class TrajectorySample(NamedTuple):
    """Where joints on a trajectory should be, where they are, and the differences."""

    step: int
    joints: tuple[str, ...]
    desired: TrajectoryPoint
    actual: TrajectoryPoint
    error: TrajectoryPoint
    frame: str = ""


class GripperSample(NamedTuple):
    """Position (rad or m) and effort (N m or N) of a gripper's joint, wanted or measured."""

    position: float
    effort: float
    stalled: bool = False
    reached: bool = False


@dataclass(frozen=True)
class ImageSample(Sample):
    """An image in the optical frame `frame`.

    `encoding` is one of sensor_msgs/image_encodings; `pixels` are (height, width, 3) or (height,
    width), and must not be changed. A depth image has metres along the optical axis, or NaN
    without a measurement (32FC1), or mm, or 0 (16UC1).
    """

    encoding: str
    pixels: np.ndarray


@dataclass(frozen=True)
class CameraInfoSample(Sample):
    """Geometry of the images of one camera; `baseline` in metres is Gazebo's hackBaseline.

    `calibration` has the values that set_camera_info set, by the names of the message's fields.
    """

    camera: PinholeCamera
    baseline: float = 0.0
    calibration: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class PointsSample(Sample):
    """The point cloud of a depth camera in the optical frame `frame`.

    `points` are x, y, z in m, NaN without a measurement, shape (height, width, 3) float32;
    `colours` are RGB, shape (height, width, 3) uint8.
    """

    points: np.ndarray
    colours: np.ndarray


@dataclass(frozen=True)
class BlockSample(Sample):
    """Points in m in the axes of `frame`, (n, 3), and their intensities, (n,)."""

    points: np.ndarray
    intensities: np.ndarray


@dataclass(frozen=True)
class RingsSample(Sample):
    """Points of a laser: records (rows, columns) with the fields of the message."""

    records: np.ndarray


@dataclass(frozen=True)
class LaserSample(Sample):
    """A scan of a laser scanner, measured at one moment.

    Angles are in rad about the z axis of `frame`. `ranges` (m) and `intensities` have the shape
    (rays,), row by row; a range is +inf without a hit within `range_max`, and -inf for a hit
    nearer than `range_min`.
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
    """A measurement of an inertial unit in the axes of `frame`.

    `orientation` is the unit quaternion of the frame in the world, `angular_velocity` in rad/s,
    `specific_force` in m/s² (+g along z at rest, as an accelerometer reads). Variances are in
    rad², (rad/s)² and (m/s²)².
    """

    orientation: Quaternion
    angular_velocity: Vector
    specific_force: Vector
    orientation_variance: Variance
    angular_velocity_variance: Variance
    specific_force_variance: Variance


@dataclass(frozen=True)
class VectorSample(Sample):
    """A vector in the axes that its plugin names."""

    vector: Vector


@dataclass(frozen=True)
class FixSample(Sample):
    """A fix of a satellite receiver: degrees, m above the ellipsoid, variances in m².

    `status` and `service` are those of sensor_msgs/NavSatStatus; `variances` are those along
    north, west and up.
    """

    status: int
    service: int
    latitude: float
    longitude: float
    altitude: float
    variances: Vector


@dataclass(frozen=True)
class MotionSample(TransformSample):
    """Pose and velocity (m/s, rad/s) of `child_frame`, with the `variance` of each component."""

    linear: Vector
    angular: Vector
    variance: float


@dataclass(frozen=True)
class ShapeContact:
    """Two shapes that touched in the step that ended at `step`.

    `first` and `second` name them as model::link::shape. For each contact point: the force in N
    and the torque in N m on the first shape's link (about its centre of mass), the position in m,
    the normal from the second shape to the first, and the depth of the overlap in m. Vectors are in
    the world's axes.
    """

    step: int
    first: str
    second: str
    forces: tuple[Vector, ...]
    torques: tuple[Vector, ...]
    positions: tuple[Vector, ...]
    normals: tuple[Vector, ...]
    depths: tuple[float, ...]


@dataclass(frozen=True)
class ContactsSample(Sample):
    """All pairs of shapes that touched since the last sample, step by step."""

    contacts: tuple[ShapeContact, ...]


@dataclass(frozen=True)
class SwitchEvent:
    """A switch of a Kobuki that has changed: its number from the left, and its state.

    `reading` is that of a cliff sensor's converter.
    """

    step: int
    number: int
    on: bool
    reading: int = 0
    frame: ClassVar[str] = ""


class BumperEvent(SwitchEvent):
    """A bumper was pressed or released."""


class CliffEvent(SwitchEvent):
    """A cliff sensor saw the floor end, or begin again."""


class WheelDropEvent(SwitchEvent):
    """A wheel lost the floor, or touches it again."""


@dataclass(frozen=True)
class SwitchesSample(Sample):
    """All switches of a Kobuki, as sums of powers of two; the rightmost one counts 1."""

    bumpers: int
    cliffs: int
    wheel_drops: int
