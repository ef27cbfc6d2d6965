"""The noise of noisy_odom, message by message, and noise that was measured on real robots."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any, Dict, Mapping, Optional, Sequence, TypeVar

import numpy as np

from bullet_lab.core.parameters import choice, part_of
from bullet_lab.noise.odometry_noise import NoisyPath, NoisyStep, rule_of
from bullet_lab.noise.published_noise import PUBLISHED_RATE, PublishedNoise, Sampler
from bullet_lab.noise.systematic import SpreadPath, SystematicErrors, SystematicSpread

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


class OdometryNoise:
    """Systematic errors and noise that noisy_odom adds to the perfect odometry of a robot.

    Args:
        parameters: of noisy_odom: of all noise models, of `SystematicErrors` and
            `SystematicSpread`, and model, noise, seed and as_published.
        rate: Hz at which messages are sampled if as_published is set.

    Attributes:
        parameters: with those of the preset that they name.
        path: which adds the noise, unless as_published is set.
    """

    def __init__(self, parameters: Any, rate: float = PUBLISHED_RATE):
        self.parameters = known = with_preset(parameters)
        errors, spread = (part_of(kind, known) for kind in (SystematicErrors, SystematicSpread))
        self._systematic = SpreadPath(errors, spread, known.seed)
        self.path = NoisyPath(rule_of(known.model, asdict(known)), known.seed)
        self._published = PublishedNoise(known.std, known.seed)
        self._sampler = Sampler(rate)

    @property
    def ticks(self) -> Sequence[int]:
        """Ticks that the left and the right encoder have counted."""
        return self._systematic.ticks

    def restart(self) -> None:
        """Start a new path with the next pose."""
        for part in (self._systematic, self.path, self._published, self._sampler):
            part.restart()

    def update(self, stamp: float, pose: Sequence[float]) -> Optional[NoisyStep]:
        """Return the report for the next pose (m, m, rad) and its stamp (s).

        Returns:
            None for a message that is not sampled. The report's noise leaves covariances alone.
        """
        reported = self._systematic.update(*pose)
        if not self.parameters.as_published:
            step = self.path.update(*reported.pose)
            return replace(
                step,
                covariance=step.covariance + self._systematic.covariance,
                motion_error=tuple(map(sum, zip(reported.motion_error, step.motion_error))),
            )
        if not self._sampler.due(stamp):
            return None
        nothing = np.zeros((3, 3))
        return NoisyStep(
            self._published.update(*reported.pose), nothing, (0.0, 0.0, 0.0), nothing
        )
