"""A PID loop with the gains, clamps and anti-windup of control_toolbox."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bullet_lab.simulation.plugins.controllers.description import ControlError, ControlParameters


@dataclass(frozen=True)
class PidGains:
    """Gains, and the limits of the integral's contribution.

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
    """A PID loop on an error."""

    def __init__(self, gains: PidGains):
        self.gains = gains
        self.reset()

    def reset(self) -> None:
        """Forget the errors so far."""
        self._integral = 0.0
        # As in control_toolbox, the loop starts at error 0, so its first step has a derivative.
        self._last = 0.0

    def command(self, error: float, seconds: float) -> float:
        """Return the command for an error, `seconds` after the last one; 0 if it is not finite."""
        if seconds <= 0.0 or not math.isfinite(error):
            return 0.0
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
