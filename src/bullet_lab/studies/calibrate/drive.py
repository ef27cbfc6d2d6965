"""A drive to calibrate by: all that a wheeled robot does, each way; with known noise on it."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, make_dataclass
from typing import Any, Dict, List

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.parameters import choice, integer, number
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.noise.odometry_noise import MODELS, NoisyPath, noise_fields, rule_of
from bullet_lab.noise.systematic import SystematicErrors, SystematicPath, chords
from bullet_lab.studies.calibrate.recordings import Recording

_COMMANDS = (
    (0.2, 0.0, 10.0),
    (0.0, 0.5236, 3.0),
    (0.2, -0.3, 5.0),
    (-0.2, 0.0, 5.0),
    (0.0, -0.5236, 3.0),
    (-0.15, 0.25, 6.0),
    (0.2, 0.3, 7.0),
)
"""m/s, rad/s and s, of a lap."""

_NoiseParameters: Any = make_dataclass("_NoiseParameters", noise_fields(), frozen=True)


def _error(name: str, value: float) -> Any:
    """Declare a systematic error as it is declared there, but for its default."""
    (entry,) = (entry for entry in fields(SystematicErrors) if entry.name == name)
    return field(default=value, metadata=entry.metadata)


@dataclass(frozen=True)
class DriveSettings(_NoiseParameters, SystematicErrors):
    """The drive that is made up where there are no data, and what is wrong with its odometry."""

    scale_error: float = _error("scale_error", 0.01)
    base_error: float = _error("base_error", -0.02)
    diameter_error: float = _error("diameter_error", 0.004)
    gyro_bias_per_metre: float = _error("gyro_bias_per_metre", 0.01)
    model: str = choice("probabilistic", "noise model of a drive that is made up", MODELS)
    rate: float = number(5.0, "Hz of its odometry", above=0.0, maximum=1000.0)
    laps: int = integer(3, "of it, 39 s and 6.3 m each", 1, 1000)

    def noise(self, model: str = "") -> Dict[str, float]:
        """Return the parameters of the random noise by a model, by name."""
        values = {name: getattr(self, name) for name, _, _ in noise_fields()}
        rule = rule_of(model or self.model, values)
        return {entry.name: getattr(rule, entry.name) for entry in fields(rule)}


def calibration_drive(settings: DriveSettings) -> Trajectory:
    """Return the true path of the drive."""
    period = 1.0 / settings.rate
    lap = [(v, w) for v, w, s in _COMMANDS for _ in range(max(1, round(s * settings.rate)))]
    arcs = np.array([(v * period, 0.0, w * period) for v, w in lap * settings.laps])
    poses: List[np.ndarray] = [np.zeros(3)]
    for step in chords(arcs):
        poses.append(se2.compose(poses[-1], step))
    return Trajectory(period * np.arange(len(poses)), np.array(poses))


def made_up(settings: DriveSettings, seed: int) -> Recording:
    """Return the drive, and an odometry of it as `noisy_odom` would make it of the truth."""
    truth = calibration_drive(settings)
    errors = SystematicPath(SystematicErrors.of(settings))
    noise = NoisyPath(rule_of(settings.model, settings.noise()), seed)
    poses = [noise.update(*errors.update(*pose).pose).pose for pose in truth.poses.tolist()]
    return Recording("a drive that was made up", truth, Trajectory(truth.stamps, np.array(poses)))
