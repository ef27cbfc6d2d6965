"""Noise that was measured on real robots, by name, with its source."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Dict, Mapping, TypeVar

from bullet_lab.core.parameters import choice

T = TypeVar("T")

NONE = "none"

PRESETS: Dict[str, Mapping[str, Any]] = {
    # Five iRobot Creates in the data set MRCLAM 7 (K. Leung and others, University of Toronto,
    # 2009), truth by Vicon, odometry from logged velocities; 220 m, by the job calibrate: noise
    # with the dispersion over 1 and 5 m, spread from robot to robot.
    "create_vicon": {
        "model": "random_walk",
        "way_std": 0.056,
        "heading_std": 0.0,
        "turn_std": 0.143,
        "scale_error": 0.056,
        "base_error": 0.098,
        "diameter_error": -0.008,
        "way_per_turn": 0.106,
        "scale_error_std": 0.011,
        "base_error_std": 0.028,
        "diameter_error_std": 0.010,
        "way_per_turn_std": 0.011,
    },
    # LoCoBot by its commands, controller ILQR, from PyRobot (A. Murali and others, 2019) in the
    # numbers and the reading of Habitat's simulator: means and variances of an action of 0.25 m,
    # (0.014 m, 0.006 m²) and (0.008 rad, 0.004 rad²), and the variance of one of 10°, 0.012 rad².
    # Errors across the way and the mean of turns are left out.
    "locobot_pyrobot": {
        "model": "random_walk",
        "way_std": 0.155,
        "heading_std": 0.126,
        "turn_std": 0.262,
        "scale_error": 0.056,
        "gyro_bias_per_metre": -0.032,
    },
}
"""Parameters of noisy_odom by the name of the robot."""


def preset() -> Any:
    """Declare the parameter `noise`."""
    return choice(NONE, "measured noise, instead of the parameters of noise", (NONE, *PRESETS))


def with_preset(parameters: T) -> T:
    """Return parameters of noisy_odom with those of the preset that they name as `noise`."""
    return replace(parameters, **PRESETS.get(parameters.noise, {}))
