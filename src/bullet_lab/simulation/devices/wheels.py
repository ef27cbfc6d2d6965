"""What robots on driven wheels have in common."""

from __future__ import annotations

from typing import Tuple

from bullet_lab.simulation.description import Joint
from bullet_lab.simulation.devices.device import DeviceError, Mount
from bullet_lab.simulation.physics import Body
from bullet_lab.simulation.pose import Pose, heading_of
from bullet_lab.simulation.samples import PlanarCommand

WHEEL_JOINTS = ("continuous", "revolute")


def base_motion(body: Body) -> Tuple[Pose, PlanarCommand]:
    """Return the pose in the world, and the velocity of its origin in its own heading."""
    pose = body.pose()
    (vx, vy, _), (_, _, wz) = body.origin_velocity()
    cosine, sine = heading_of(pose.quaternion)
    return pose, PlanarCommand(cosine * vx + sine * vy, cosine * vy - sine * vx, wz)


def at_least(mount: Mount, tag: str, default: float, zero_is_fine: bool = False) -> float:
    """Return the number in a tag; raises LabError if it is negative, or 0 where that is bad."""
    value = mount.number(tag, default)
    if value < 0.0 or (value == 0.0 and not zero_is_fine):
        wanted = "negative" if zero_is_fine else "not positive"
        raise DeviceError(f"{mount.where(tag)}: {value:g} is {wanted}")
    return value


def wheel_joint(mount: Mount, tag: str, default: str) -> Joint:
    """Return the joint that a tag names; raises DeviceError where no wheel can turn on it."""
    name = mount.text(tag, default)
    joints = {joint.name: joint for joint in mount.model.joints}
    if name not in mount.body.joint_names:
        raise DeviceError(f"{mount.where(tag)}: no movable joint '{name}'")
    if joints[name].kind not in WHEEL_JOINTS:
        raise DeviceError(
            f"{mount.where(tag)}: joint '{name}' is {joints[name].kind}: no wheel turns on it"
        )
    return joints[name]
