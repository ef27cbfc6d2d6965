"""A PID loop with the gains, clamps and wind-up rules of control_toolbox."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional

from bullet_lab.simulation.plugins.controllers.parameters import ControlError, ControlParameters


@dataclass(frozen=True)
class PidGains:
    """Gains, and the limits of what the integral may contribute.

    With `antiwindup` the integral itself is kept within them, else only its contribution.
    """

    p: float
    i: float = 0.0
    d: float = 0.0
    i_min: float = 0.0
    i_max: float = 0.0
    antiwindup: bool = False

    @classmethod
    def of(cls, parameters: ControlParameters) -> PidGains:
        """Read p, i, d, i_clamp (or i_clamp_min, i_clamp_max) and antiwindup.

        Raises:
            ControlError: there is no p.
        """
        p = parameters.optional_number("p")
        if p is None:
            raise ControlError(f"{parameters.where}/p is missing")
        clamp = parameters.number("i_clamp", 0.0)
        return cls(
            p,
            parameters.number("i", 0.0),
            parameters.number("d", 0.0),
            -abs(parameters.number("i_clamp_min", clamp)),
            abs(parameters.number("i_clamp_max", clamp)),
            parameters.boolean("antiwindup", False),
        )


class Pid:
    """The loop: what to do about an error, again and again."""

    def __init__(self, gains: PidGains):
        self.gains = gains
        self.reset()

    def reset(self) -> None:
        """Forget what has been."""
        self._integral = 0.0
        # As in control_toolbox, the first step of a loop has a derivative: it begins without error.
        self._last: float = 0.0

    def command(self, error: float, seconds: float, slope: Optional[float] = None) -> float:
        """Return the command for an error, `seconds` after the last one.

        `slope` is the error's derivative, if somebody knows it. What is not finite gives 0.
        """
        if seconds <= 0.0 or not math.isfinite(error):
            return 0.0
        if slope is None:
            slope = (error - self._last) / seconds
            self._last = error
        gains = self.gains
        self._integral += seconds * error
        if gains.antiwindup and gains.i:
            low, high = sorted((gains.i_min / gains.i, gains.i_max / gains.i))
            self._integral = min(max(self._integral, low), high)
        contribution = gains.i * self._integral
        if not gains.antiwindup:
            contribution = min(max(contribution, gains.i_min), gains.i_max)
        return gains.p * error + contribution + gains.d * slope
