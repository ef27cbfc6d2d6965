"""Driven wheels: joints with motors, and what robots on them have in common."""

from __future__ import annotations

from typing import Tuple

from bullet_lab.core.pose import Pose, heading_of
from bullet_lab.simulation.physics.physics import Body, JointState
from bullet_lab.simulation.plugins.device import DeviceError, Mount
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.world.description import Joint

# rad/s; below it a wheel counts as stopped. The solver's leftovers are some 3e-4 rad/s.
STANDING = 0.01


class Wheel:
    """A joint that is driven at a speed with limited torque and acceleration.

    A wheel that is to stand and has come to rest is held at its angle and sticks to the floor,
    as with a brake: a motor that only controls the speed lets the robot creep some 0.04 mm/s,
    and bare friction some 0.02 mm/s, because the engine solves them to a tolerance. What pushes
    harder than torque or friction moves the wheel all the same; it is held anew where it stops.

    Args:
        body: what the joint belongs to.
        joint: its name.
        torque: the most that the motor exerts, in N m.
        acceleration: the most that the wanted speed changes by, in rad/s²; 0 for no limit.
    """

    def __init__(self, body: Body, joint: str, torque: float, acceleration: float = 0.0):
        self.joint = joint
        self._body = body
        self._torque = torque
        self._acceleration = acceleration
        self.stop()

    def state(self) -> JointState:
        """Return angle, speed and torque."""
        return self._body.joint_state(self.joint)

    def stop(self) -> None:
        """Want no speed, at once."""
        self._speed = 0.0
        self._release()

    def follow(self, speed: float, seconds: float) -> None:
        """Drive towards a speed in rad/s, `seconds` after the last call.

        The speed that the motor is given changes by acceleration · seconds at most and ends at
        exactly the wanted one.
        """
        change = speed - self._speed
        limit = self._acceleration * seconds
        if self._acceleration and abs(change) > limit:
            self._speed += limit if change > 0.0 else -limit
        else:
            self._speed = speed
        if self._speed == 0.0:
            self._come_to_rest()
        else:
            self._release()

    def _release(self) -> None:
        self._held = False
        self._body.set_sticking(self.joint, False)
        self._body.drive_joint(self.joint, self._speed, self._torque)

    def _come_to_rest(self) -> None:
        state = self.state()
        if abs(state.velocity) > STANDING:
            self._release()
        elif not self._held:
            self._held = True
            self._body.set_sticking(self.joint, True)
            self._body.hold_joint(self.joint, state.position, self._torque)


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
