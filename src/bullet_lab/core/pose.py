"""Poses in space."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

import numpy as np

from bullet_lab.core.se2 import PlanarPose, atan2

Vector = Tuple[float, float, float]
Quaternion = Tuple[float, float, float, float]

# Sine of a pitch 1e-6 rad from straight up; beyond, rounding makes roll and yaw inaccurate.
POLE_SINE = 1.0 - 5e-13


@dataclass(frozen=True)
class Pose:
    """A pose: `position` in metres and unit `quaternion` (x, y, z, w).

    `a * b` is the pose `b`, given in the frame of `a`, in the frame in which `a` is given.

    >>> turned = Pose.from_rpy((1.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2))
    >>> [round(value, 9) for value in (turned * Pose((2.0, 0.0, 0.0))).position]
    [1.0, 2.0, 0.0]
    >>> round(math.degrees(turned.yaw), 9)
    90.0
    """

    position: Vector = (0.0, 0.0, 0.0)
    quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)

    @classmethod
    def from_rpy(cls, position: Vector, rpy: Vector) -> Pose:
        """Make a pose from roll, pitch and yaw in radians about the fixed axes x, y, z.

        This is the convention of URDF's `rpy` and of SDF's `<pose>`.
        """
        roll, pitch, yaw = (0.5 * angle for angle in rpy)
        cr, sr = math.cos(roll), math.sin(roll)
        cp, sp = math.cos(pitch), math.sin(pitch)
        cy, sy = math.cos(yaw), math.sin(yaw)
        quaternion = (
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        )
        return cls(_vector(position), quaternion)

    @classmethod
    def on_floor(cls, x: float, y: float, yaw: float) -> Pose:
        """Make an upright pose at height 0 from a planar one (m, m, rad)."""
        return cls.from_rpy((x, y, 0.0), (0.0, 0.0, yaw))

    @classmethod
    def from_matrix(cls, position: Vector, rotation: np.ndarray) -> Pose:
        """Make a pose from a position and a 3x3 rotation matrix; stable for all rotations."""
        m = np.asarray(rotation, dtype=float)
        # Bar-Itzhack's method: the quaternion is the dominant eigenvector of a symmetric matrix.
        k = np.array(
            [
                [m[0, 0] - m[1, 1] - m[2, 2], 0.0, 0.0, 0.0],
                [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0.0, 0.0],
                [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0.0],
                [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], np.trace(m)],
            ]
        )
        values, vectors = np.linalg.eigh(k)
        x, y, z, w = vectors[:, int(np.argmax(values))]
        sign = -1.0 if w < 0.0 else 1.0
        return cls(_vector(position), (sign * x, sign * y, sign * z, sign * w))

    def __mul__(self, other: Pose) -> Pose:
        rotated = self.rotate(other.position)
        position = tuple(a + b for a, b in zip(self.position, rotated))
        return Pose(position, _hamilton(self.quaternion, other.quaternion))

    def inverse(self) -> Pose:
        """Return the pose of the outer frame in this one."""
        x, y, z, w = self.quaternion
        turned_back = Pose(quaternion=(-x, -y, -z, w))
        px, py, pz = turned_back.rotate(self.position)
        return Pose((-px, -py, -pz), turned_back.quaternion)

    def rotate(self, vector: Vector) -> Vector:
        """Rotate a vector from this pose's frame to the outer frame, without translation.

        >>> Pose(quaternion=(0.0, 0.0, 1.0, 0.0)).rotate((1.0, 2.0, 3.0))
        (-1.0, -2.0, 3.0)
        """
        x, y, z, w = self.quaternion
        vx, vy, vz = vector
        tx = 2.0 * (y * vz - z * vy)
        ty = 2.0 * (z * vx - x * vz)
        tz = 2.0 * (x * vy - y * vx)
        return (
            vx + w * tx + y * tz - z * ty,
            vy + w * ty + z * tx - x * tz,
            vz + w * tz + x * ty - y * tx,
        )

    def rotation_matrix(self) -> np.ndarray:
        """Return the 3x3 rotation matrix."""
        columns = [self.rotate(axis) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
        return np.array(columns, dtype=float).T

    def rpy(self) -> Vector:
        """Return roll, pitch and yaw in radians about the fixed axes x, y, z.

        At a pitch of ±90°, roll and yaw turn about one axis: roll is 0 then.
        """
        x, y, z, w = self.quaternion
        sine = max(-1.0, min(1.0, 2.0 * (w * y - z * x)))
        pitch = math.asin(sine)
        if abs(sine) > POLE_SINE:
            yaw = math.copysign(2.0, -sine) * atan2(x, w)
            return (0.0, pitch, math.remainder(yaw, math.tau))
        roll = atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        return (roll, pitch, self.yaw)

    @property
    def yaw(self) -> float:
        """Rotation about the vertical axis, in radians within [-pi, pi]."""
        x, y, z, w = self.quaternion
        return atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    @property
    def planar(self) -> PlanarPose:
        """The pose seen from above: x (m), y (m) and yaw (rad)."""
        return (*self.position[:2], self.yaw)


def heading_of(quaternion: Quaternion) -> Tuple[float, float]:
    """Return the cosine and sine of the yaw of a unit quaternion (x, y, z, w)."""
    x, y, z, w = quaternion
    cosine, sine = 1.0 - 2.0 * (y * y + z * z), 2.0 * (w * z + x * y)
    # Both are 0 if the x axis points straight up: any heading is right.
    length = math.sqrt(cosine * cosine + sine * sine) or 1.0
    return cosine / length, sine / length


def add(one: Vector, other: Vector) -> Vector:
    """Return the sum of two vectors."""
    return (one[0] + other[0], one[1] + other[1], one[2] + other[2])


def subtract(one: Vector, other: Vector) -> Vector:
    """Return the difference of two vectors."""
    return (one[0] - other[0], one[1] - other[1], one[2] - other[2])


def dot(one: Vector, other: Vector) -> float:
    """Return the scalar product of two vectors."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def cross(one: Vector, other: Vector) -> Vector:
    """Return the vector product of two vectors.

    >>> cross((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    (0.0, 0.0, 1.0)
    """
    return (
        one[1] * other[2] - one[2] * other[1],
        one[2] * other[0] - one[0] * other[2],
        one[0] * other[1] - one[1] * other[0],
    )


def _hamilton(a: Quaternion, b: Quaternion) -> Quaternion:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _vector(values: Vector) -> Vector:
    x, y, z = values
    return (float(x), float(y), float(z))
