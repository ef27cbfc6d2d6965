"""What is driven for a benchmark, and what the runs of one say."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.parameters import choice, integer, number, text
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.drive.square import Square
from bullet_lab.noise.odometry_noise import MODELS, NoisyPath, derived_seed, model_named
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.studies.study import MOST_SEED, Settings
from bullet_lab.studies.umbmark.estimate import LARGEST, Estimate, Umbmark, fit, umbmark
from bullet_lab.studies.umbmark.floor import FloorPlan
from bullet_lab.studies.umbmark.runs import CLOCKWISE, DIRECTIONS, Run, return_errors

LARGEST_ERROR = 0.1
# Sides: half the way round, farther than wheels that are wrong by some percent bring a robot.
MOST_OF_SIDE = 2.0
# Of the return error: what wheels do not explain is more than what they do.
MOST_LEFT = 0.5
# Of the side: what rulers and random noise leave.
LEAST_LEFT = 0.01
# Standard errors that chance does not reach.
SURE = 3.0
# m and rad: equal but for rounding.
SAME = 1e-9


@dataclass(frozen=True)
class DriveSettings(Settings):
    """What is driven."""

    robot: str = text(
        "package://bullet_lab/urdf/camera_robot.urdf", "URDF of a robot on two wheels"
    )
    controller: str = text(
        "", "YAML file of its diff_drive_controller; else its plugin diff_drive drives it"
    )
    diameter_error: float = number(
        0.0,
        "right / left diameter of the wheels that roll, relative to what is believed, - 1",
        -LARGEST_ERROR,
        maximum=LARGEST_ERROR,
    )
    base_error: float = number(
        0.0,
        "base of the wheels that roll / the one that odometry believes in - 1",
        -LARGEST_ERROR,
        maximum=LARGEST_ERROR,
    )
    side: float = number(4.0, "m, of the square", 0.1, maximum=100.0)
    runs: int = integer(5, "squares each way", 1, 1000)
    speed: float = number(0.2, "m/s, on the sides", above=0.0)
    turn_speed: float = number(0.5236, "rad/s, at the corners", above=0.0)
    std: float = number(0.0005, "level of random noise on the odometry", 0.0)
    model: str = choice("rate_invariant", "rule of the noise", MODELS)
    seed: int = integer(1, "seed of the noise", 0, MOST_SEED)

    @property
    def plan(self) -> FloorPlan:
        """The robot that is driven."""
        return FloorPlan(self.robot, self.controller)

    @property
    def errors(self) -> SystematicErrors:
        """What the wheels that roll are, relative to what is believed at first."""
        return SystematicErrors(diameter_error=self.diameter_error, base_error=self.base_error)

    def square(self, direction: str) -> Square:
        """Return what is driven in a direction."""
        turn = -self.turn_speed if direction == CLOCKWISE else self.turn_speed
        return Square(side=self.side, speed=self.speed, turn_speed=turn)

    def noise(self, number: int, laps: int) -> Callable[[PlanarPose], PlanarPose]:
        """Return what makes the noisy poses of a run out of those of the odometry."""
        if self.std == 0.0:
            return lambda pose: pose
        rule = model_named(self.model).at_level(self.std)
        path = NoisyPath(rule, derived_seed(derived_seed(self.seed, laps), number))

        def noisy(pose: PlanarPose) -> PlanarPose:
            return path.update(*pose).pose

        return noisy


@dataclass(frozen=True)
class Benchmark:
    """Runs, and what they say."""

    runs: Tuple[Run, ...]
    base: float
    figures: Umbmark
    estimate: Estimate

    @classmethod
    def of(cls, runs: Sequence[Run], base: float, side: Optional[float] = None) -> Benchmark:
        """Evaluate runs; raises RunError where one of the ways is missing.

        Args:
            runs: both ways.
            base: m, believed.
            side: m; as the odometry reports where it is not said.
        """
        length = float(np.mean([run.side() for run in runs])) if side is None else side
        return cls(tuple(runs), base, umbmark(runs, length, base), fit(runs, base))

    def doubts(self) -> List[str]:
        """Return why the result is not to be trusted, with likely causes; empty where it is."""
        largest, left = self.figures.e_max_syst, self.estimate.residual
        side = float(np.mean([run.side() for run in self.runs]))
        found = [
            f"{name} lies on the bound of the fit, {100.0 * LARGEST:.0f} %: "
            "are wheel_base and the units right?"
            for name in self.estimate.on_bounds()
        ]
        if largest > MOST_OF_SIDE * side:
            found.append(
                f"the mean return error of {largest:.3g} m is more than half the way round: "
                f"is the side {side:.3g} m, and are positions in m?"
            )
        if left > max(MOST_LEFT * largest, LEAST_LEFT * side, SURE * self._standard_error()):
            found.append(
                f"{left:.3g} m of the mean return error of {largest:.3g} m are not explained by "
                "wheels: are angles in rad and positions in m, and is the y axis to the left?"
            )
        if all(np.abs(run.return_error()).max() < SAME for run in self.runs):
            found.append("the odometry equals the truth: are both from the same topic or column?")
        return found

    def _standard_error(self) -> float:
        """Return the larger standard error (m) of both centres; 0 of single runs."""
        errors = [return_errors(self.runs, direction)[:, :2] for direction in DIRECTIONS]
        return max(
            math.sqrt(float(one.var(axis=0, ddof=1).sum()) / len(one)) if len(one) > 1 else 0.0
            for one in errors
        )

    def summary(self) -> Dict[str, Any]:
        """Return the figures as the field knows them."""
        figures = self.figures
        return {
            "squares": {d: sum(run.direction == d for run in self.runs) for d in DIRECTIONS},
            "centre_cw_m": list(figures.centre_cw),
            "centre_ccw_m": list(figures.centre_ccw),
            "r_cw_m": figures.r_cw,
            "r_ccw_m": figures.r_ccw,
            "e_max_syst_m": figures.e_max_syst,
            "alpha_deg": float(np.degrees(figures.alpha)),
            "beta_deg": float(np.degrees(figures.beta)),
            "e_d": figures.e_d,
            "e_b": figures.e_b,
        }
