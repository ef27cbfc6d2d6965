"""What a joint allows and resists: limits, damping and friction."""

from __future__ import annotations

from typing import Dict, Tuple

from bullet_lab.simulation.description import Joint, Link
from bullet_lab.simulation.inertia import mobility
from bullet_lab.simulation.schedule import STEPS_PER_SECOND

# Where a joint that is limited on one side ends on the other, as in SDF.
FAR = 1e16
LIMITED = ("revolute", "prismatic")


def joint_properties(joint: Joint, parent: Link, child: Link) -> Dict[str, float]:
    """Return damping and limits of a joint as PyBullet's properties of the link below it.

    PyBullet takes the damping of a step from the velocity before it. A strong damper on a light
    link would so turn the velocity round, and swing up. It gets no stronger here than what stops
    the two links at once, if nothing else held them.

    Args:
        joint: to be described.
        parent: the link that carries it.
        child: the link below it.
    """
    properties = {"jointDamping": joint.damping}
    loose = _mobility(joint, parent, child) if joint.damping > 0.0 else 0.0
    if loose > 0.0:
        properties["jointDamping"] = min(joint.damping, STEPS_PER_SECOND / loose)
    if joint.kind in LIMITED and {"lower", "upper"} & set(joint.limits):
        # A lower limit above the upper one means none, and PyBullet passes over it.
        properties["jointLowerLimit"] = joint.limits.get("lower", -FAR)
        properties["jointUpperLimit"] = joint.limits.get("upper", FAR)
    return properties


def allowed_effort(joint: Joint, effort: float, velocity: float) -> float:
    """Return what is left of an effort (N m or N) on a joint with a velocity (rad/s or m/s).

    As in Gazebo, it is no more than the joint's effort limit, and nothing in the direction in
    which the joint moves faster than its velocity limit. A negative limit is none.
    """
    most, fastest = (joint.limits.get(key, -1.0) for key in ("effort", "velocity"))
    if 0.0 <= fastest < abs(velocity) and velocity * effort > 0.0:
        return 0.0
    return effort if most < 0.0 else min(max(effort, -most), most)


def net_motor(joint: Joint, velocity: float, effort: float) -> Tuple[float, float]:
    """Return what a motor and the joint's friction are together: a motor.

    Friction helps a motor that stops the joint, and hinders one that moves it.

    Args:
        joint: that has the friction.
        velocity: that the motor tries to reach, in rad/s or m/s.
        effort: the most that the motor exerts, in N m or N.

    Returns:
        Velocity and greatest effort of the two.
    """
    friction = max(0.0, joint.friction)
    if velocity == 0.0:
        return 0.0, effort + friction
    if effort > friction:
        return velocity, effort - friction
    return 0.0, friction - effort


def _mobility(joint: Joint, parent: Link, child: Link) -> float:
    """Return the acceleration per effort of a joint between two links that nothing else holds."""
    turning = joint.kind != "prismatic"
    ends = ((child.inertia, joint.axis), (parent.inertia, joint.pose.rotate(joint.axis)))
    return sum(mobility(inertia, axis, turning) for inertia, axis in ends if inertia is not None)
