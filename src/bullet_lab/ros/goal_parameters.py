"""What the drive_to_goal node can be told."""

from __future__ import annotations

from dataclasses import dataclass, fields

from bullet_lab.numerics.goal_driver import LEAST_TOLERANCE, GoalLimits
from bullet_lab.ros import parameters

USUAL = GoalLimits()


@dataclass(frozen=True)
class DriveToGoalParameters:
    """Private parameters of drive_to_goal."""

    cmd_vel: str = parameters.text("cmd_vel", "topic of the commands")
    odom: str = parameters.text("odom", "topic of the odometry, perfect or noisy")
    speed: float = parameters.number(USUAL.speed, "at most, m/s", above=0.0)
    turn_speed: float = parameters.number(USUAL.turn_speed, "at most, rad/s", above=0.0)
    acceleration: float = parameters.number(USUAL.acceleration, "at most, m/s²", above=0.0)
    turn_acceleration: float = parameters.number(
        USUAL.turn_acceleration, "at most, rad/s²", above=0.0
    )
    gain: float = parameters.number(USUAL.gain, "m/s for each m to the goal", above=0.0)
    turn_gain: float = parameters.number(USUAL.turn_gain, "rad/s for each rad", above=0.0)
    tolerance: float = parameters.number(
        USUAL.tolerance, "m from the goal to stop within", minimum=LEAST_TOLERANCE
    )
    yaw_tolerance: float = parameters.number(
        USUAL.yaw_tolerance, "rad from its heading to stop within", minimum=LEAST_TOLERANCE
    )
    heading: bool = parameters.boolean(True, "turn to the goal's heading at the end")
    rate: float = parameters.number(20.0, "commands per second", minimum=5.0, maximum=100.0)
    odom_rate: float = parameters.number(
        20.0, "lock step: messages of odometry per second", above=0.0, maximum=1000.0
    )
    stale: float = parameters.number(
        0.5, "s without odometry after which the robot is stopped", above=0.0
    )
    patience: float = parameters.number(
        5.0, "s without odometry after which the goal is given up", above=0.0
    )
    lock_step: bool = parameters.boolean(False, "hold simulated time back while working")

    def limits(self) -> GoalLimits:
        """Return how fast and how exactly to drive."""
        names = (field.name for field in fields(GoalLimits))
        return GoalLimits(**{name: getattr(self, name) for name in names})
