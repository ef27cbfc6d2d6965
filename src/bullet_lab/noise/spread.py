"""Systematic errors that are not exactly known, and differ from path to path.

Each path has errors of its own, drawn from independent Gaussians about the given ones. What that
does to the reported pose is followed by one more path for each error, with the error one standard
deviation larger: to first order, the covariance is the sum of the squares of their distances.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from bullet_lab.core.parameters import number
from bullet_lab.core.se2 import wrap
from bullet_lab.noise.systematic import (
    LARGEST_BIAS,
    LARGEST_ERROR,
    LARGEST_LOSS,
    SystematicErrors,
    SystematicPath,
    SystematicStep,
)

_SUFFIX = "_std"
_LARGEST = {"gyro_bias_per_metre": LARGEST_BIAS, "way_per_turn": LARGEST_LOSS}
# Keeps the draws apart from those of the noise.
_STREAM = 5


def _spread(name: str, largest: float = LARGEST_ERROR) -> Any:
    return number(0.0, f"standard deviation of {name}, from path to path", 0.0, maximum=largest)


@dataclass(frozen=True)
class SystematicSpread:
    """Standard deviations of the systematic errors from path to path; 0 if they are known.

    Attributes:
        scale_error_std: of scale_error, and so on.
        base_error_std: likewise.
        diameter_error_std: likewise.
        gyro_bias_per_metre_std: rad/m.
        way_per_turn_std: m/rad.
    """

    scale_error_std: float = _spread("scale_error")
    base_error_std: float = _spread("base_error")
    diameter_error_std: float = _spread("diameter_error")
    gyro_bias_per_metre_std: float = _spread("gyro_bias_per_metre", LARGEST_BIAS)
    way_per_turn_std: float = _spread("way_per_turn", LARGEST_LOSS)

    @classmethod
    def of(cls, parameters) -> SystematicSpread:
        """Return those among the parameters of a node or a study."""
        return cls(**{entry.name: getattr(parameters, entry.name) for entry in fields(cls)})


class SpreadPath:
    """Makes reported paths from true ones, each with errors of its own; like `SystematicPath`.

    >>> path = SpreadPath(SystematicErrors(), SystematicSpread(scale_error_std=0.1), seed=1)
    >>> for x in (0.0, 1.0):
    ...     step = path.update(x, 0.0, 0.0)
    >>> path.covariance.round(4)[0]
    array([0.0083, 0.    , 0.    ])

    Args:
        errors: their means.
        spread: their standard deviations.
        seed: of the draws, >= 0.
    """

    def __init__(self, errors: SystematicErrors, spread: SystematicSpread, seed: int):
        self._errors = errors
        self._stds = {
            name[: -len(_SUFFIX)]: std for name, std in asdict(spread).items() if std > 0.0
        }
        self._generator = np.random.default_rng([seed, _STREAM])
        self._known = SystematicPath(errors)
        self._others = [
            SystematicPath(replace(errors, **{name: getattr(errors, name) + std}))
            for name, std in self._stds.items()
        ]
        self.restart()

    def restart(self) -> None:
        """Start a new path, with errors of its own, with the next pose."""
        drawn = {}
        for name, std in self._stds.items():
            value = getattr(self._errors, name) + std * self._generator.standard_normal()
            largest = _LARGEST.get(name, LARGEST_ERROR)
            drawn[name] = float(np.clip(value, -largest, largest))
        self._own = SystematicPath(replace(self._errors, **drawn))
        for path in (self._known, *self._others):
            path.restart()
        self.covariance = np.zeros((3, 3))

    def update(self, x: float, y: float, yaw: float) -> SystematicStep:
        """Return the report for the next true pose (m, m, rad), which is finite.

        `covariance` is then that of its x (m), y (m) and yaw (rad) from path to path, (3, 3).
        """
        if self._others:
            known = self._known.update(x, y, yaw).pose
            rows = np.array([path.update(x, y, yaw).pose for path in self._others]) - known
            rows[:, 2] = wrap(rows[:, 2])
            self.covariance = rows.T @ rows
        return self._own.update(x, y, yaw)
