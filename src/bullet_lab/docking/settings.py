"""What docking can be told beside the dock itself."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from bullet_lab.docking.marker_model import PixelNoise


@dataclass(frozen=True)
class DockingSettings:
    """Speeds, patience and limits; lengths in m, angles in rad, times in s.

    Attributes:
        drive_speed: in the open.
        approach_speed: on the dock's axis.
        turn_speed: on the spot.
        acceleration: of the wheels' mean, m/s².
        turn_acceleration: rad/s².
        settle_time: from standstill to the first image that counts.
        look_frames: images that a look takes.
        measure_frames: images at rest before a decision.
        final_frames: images at rest that say "docked".
        max_retries: retreats from the last metre before it gives up.
        max_stagings: drives to the staging point.
        time_limit: of all.
        image_timeout: without any image while they are wanted.
        unseen_timeout: without the marker while driving at it.
        odometry_timeout: without odometry.
        gate_distance: way left from which on the gate counts.
        gate_lateral: beside the axis, aborts.
        gate_yaw: against the axis, aborts.
        wall_margin: kept between robot and walls.
        smallest_marker: px in the image at which the marker should be found.
        missed: probability that a look misses a marker that it should find.
        give_up_mass: share of the prior below which the marker is held to be missing.
        sure: probability of being the real marker, asked for before driving in.
        noise: of the marker's corners in the image.
    """

    drive_speed: float = 0.4
    approach_speed: float = 0.25
    turn_speed: float = 0.8
    acceleration: float = 0.5
    turn_acceleration: float = 2.0
    settle_time: float = 0.3
    look_frames: int = 3
    measure_frames: int = 4
    final_frames: int = 5
    max_retries: int = 5
    max_stagings: int = 10
    time_limit: float = 300.0
    image_timeout: float = 3.0
    unseen_timeout: float = 1.2
    odometry_timeout: float = 1.0
    gate_distance: float = 0.40
    gate_lateral: float = 0.025
    gate_yaw: float = math.radians(6.0)
    wall_margin: float = 0.04
    smallest_marker: float = 18.0
    missed: float = 0.25
    give_up_mass: float = 0.004
    sure: float = 0.9
    noise: PixelNoise = field(default_factory=PixelNoise)
