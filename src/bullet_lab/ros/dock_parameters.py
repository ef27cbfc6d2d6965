"""What the dock node can be told."""

from __future__ import annotations

from dataclasses import dataclass

from bullet_lab.docking.settings import DockingSettings
from bullet_lab.ros import parameters

USUAL = DockingSettings()


@dataclass(frozen=True)
class DockParameters:
    """Private parameters of dock."""

    docks: str = parameters.text(
        "package://bullet_lab/config/docks.yaml", "dock database: a path or package://"
    )
    dock: str = parameters.text("dock", "what a dock is like that is given by its pose alone")
    odom: str = parameters.text("odom", "topic of the odometry, perfect or noisy")
    cmd_vel: str = parameters.text("cmd_vel", "topic of the commands")
    detections: str = parameters.text("aruco/detections", "topic of the markers seen")
    camera_info: str = parameters.text("mycamera/camera_info", "topic of the camera's geometry")
    base_frame: str = parameters.text("base_footprint", "frame of the robot on the floor")
    dock_frame: str = parameters.text("dock", "frame of the dock on TF; empty: none is published")
    rate: float = parameters.number(
        20.0, "commands per simulated second", minimum=10.0, maximum=100.0
    )
    odom_rate: float = parameters.number(
        20.0, "lock step: messages of odometry per second", above=0.0, maximum=1000.0
    )
    image_rate: float = parameters.number(
        30.0, "lock step: images per second", above=0.0, maximum=1000.0
    )
    patience: float = parameters.number(
        3.0, "s that odometry, camera and transforms may be missing at the start", above=0.0
    )
    time_limit: float = parameters.number(USUAL.time_limit, "s for a docking", above=0.0)
    max_retries: int = parameters.integer(
        USUAL.max_retries, "how often to retreat and try again", minimum=0, maximum=1000
    )
    drive_speed: float = parameters.number(
        USUAL.drive_speed, "m/s in the open", above=0.0, maximum=1.0
    )
    approach_speed: float = parameters.number(
        USUAL.approach_speed, "m/s on the dock's axis", above=0.0, maximum=1.0
    )
    turn_speed: float = parameters.number(
        USUAL.turn_speed, "rad/s on the spot", above=0.0, maximum=2.0
    )
    tolerance_distance: float = parameters.number(
        0.0, "m, what counts as docked along the axis; 0: as the database says", minimum=0.0
    )
    tolerance_lateral: float = parameters.number(
        0.0, "m, across the axis; 0: as the database says", minimum=0.0
    )
    tolerance_yaw: float = parameters.number(
        0.0, "rad, against the axis; 0: as the database says", minimum=0.0
    )
    seed: int = parameters.integer(0, "of what is random in docking", minimum=0)
    lock_step: bool = parameters.boolean(False, "hold simulated time back while working")
