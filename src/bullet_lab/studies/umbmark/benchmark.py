"""The squares of a benchmark: how they are driven, and their evaluation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.parameters import choice, integer, number, text
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.drive.square import Square
from bullet_lab.noise.odometry_noise import LARGEST_PARAMETER, MODELS, NoisyPath, derived_seed
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.studies.study import MOST_SEED, Settings
from bullet_lab.studies.umbmark.estimate import LARGEST, Estimate, Umbmark, fit, umbmark
from bullet_lab.studies.umbmark.robots import FloorPlan, IdealRobot, Wheels, drive_square
from bullet_lab.studies.umbmark.runs import CLOCKWISE, DIRECTIONS, Run, RunError, return_errors

LARGEST_ERROR = 0.1
# m, of ideal wheels.
DIAMETER = 0.2
# Sides: half the perimeter, farther than wheels with errors of some percent bring a robot.
MOST_OF_SIDE = 2.0
# Of the return error: wheels explain less of it than they leave.
MOST_LEFT = 0.5
# Of the side: the error of rulers and random noise.
LEAST_LEFT = 0.01
# Standard errors beyond chance.
SURE = 3.0
# m and rad: equal except for rounding.
SAME = 1e-9


@dataclass(frozen=True)
class DriveSettings(Settings):
    """The robot and its squares."""

    robot: str = text(
        "package://bullet_lab/urdf/camera_robot.urdf", "URDF of a robot on two wheels"
    )
    controller: str = text(
        "", "YAML file of its diff_drive_controller; else its plugin diff_drive drives it"
    )
    diameter_error: float = number(
        0.0,
        "right / left diameter of the true wheels, relative to the assumed ones, - 1",
        -LARGEST_ERROR,
        maximum=LARGEST_ERROR,
    )
    base_error: float = number(
        0.0,
        "base of the true wheels / the one that odometry assumes - 1",
        -LARGEST_ERROR,
        maximum=LARGEST_ERROR,
    )
    side: float = number(4.0, "m, of the square", 0.1, maximum=100.0)
    runs: int = integer(5, "squares in each direction", 1, 1000)
    speed: float = number(0.2, "m/s, on the sides", above=0.0)
    turn_speed: float = number(0.5236, "rad/s, at the corners", above=0.0)
    std: float = number(
        0.0005, "level of random noise on the odometry", 0.0, maximum=LARGEST_PARAMETER
    )
    model: str = choice("rate_invariant", "rule of the noise", MODELS)
    seed: int = integer(1, "seed of the noise", 0, MOST_SEED)

    @property
    def plan(self) -> FloorPlan:
        """The files of the robot."""
        return FloorPlan(self.robot, self.controller)

    @property
    def errors(self) -> SystematicErrors:
        """Errors of the true wheels, relative to those that odometry assumes at first."""
        return SystematicErrors(diameter_error=self.diameter_error, base_error=self.base_error)

    def square(self, direction: str) -> Square:
        """Return the square in a direction."""
        turn = -self.turn_speed if direction == CLOCKWISE else self.turn_speed
        return Square(side=self.side, speed=self.speed, turn_speed=turn)

    def noise(self, number: int, laps: int) -> Callable[[PlanarPose], PlanarPose]:
        """Return a function that makes the noisy pose of each odometry pose of a run."""
        if self.std == 0.0:
            return lambda pose: pose
        rule = MODELS[self.model].at_level(self.std)
        path = NoisyPath(rule, derived_seed(derived_seed(self.seed, laps), number))
        return lambda pose: path.update(*pose).pose


def drive_run(
    settings: DriveSettings,
    correction: SystematicErrors,
    laps: int,
    ideal_base: Optional[float],
    number: int,
) -> Tuple[Run, float]:
    """Drive a run, clockwise if its number is even; return it, and the base (m) assumed in it.

    Args:
        settings: of the drive.
        correction: errors that an earlier calibration has found.
        laps: number of rounds of runs before this one; it selects the noise.
        ideal_base: m, of a robot whose wheels roll ideally; None for a robot on the floor.
        number: of the run, from 0 on.
    """
    direction = DIRECTIONS[number % len(DIRECTIONS)]
    if ideal_base is None:
        robot: Any = settings.plan.build(settings.errors, correction)
    else:
        wheels = Wheels(DIAMETER, DIAMETER, ideal_base)
        robot = IdealRobot(wheels.times(settings.errors), wheels.times(correction))
    try:
        name, noise = f"{direction} {number // len(DIRECTIONS) + 1}", settings.noise(number, laps)
        return drive_square(robot, settings.square(direction), name, noise), robot.believed.base
    finally:
        robot.close()


@dataclass(frozen=True)
class Benchmark:
    """Runs and their evaluation."""

    runs: Tuple[Run, ...]
    base: float
    figures: Umbmark
    estimate: Estimate

    @classmethod
    def of(cls, runs: Sequence[Run], base: float, side: Optional[float] = None) -> Benchmark:
        """Evaluate runs; raises RunError unless there are runs in both directions.

        Args:
            runs: in both directions.
            base: m, as odometry assumes it.
            side: m; the mean reported one by default.
        """
        if {run.direction for run in runs} != set(DIRECTIONS):
            raise RunError("squares have to be driven both ways, clockwise and counter-clockwise")
        length = float(np.mean([run.side() for run in runs])) if side is None else side
        return cls(tuple(runs), base, umbmark(runs, length, base), fit(runs, base))

    @classmethod
    def of_drives(cls, drives: Sequence[Tuple[Run, float]], side: float) -> Benchmark:
        """Evaluate runs of `drive_run`.

        The fit counts turns by the base that was assumed, which includes the correction.
        """
        return cls.of([run for run, _ in drives], drives[0][1], side)

    def warnings(self) -> List[str]:
        """Return the reasons to distrust the result, with likely causes; empty without any."""
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
        """Return the larger standard error (m) of both centres; 0 for single runs."""
        errors = [return_errors(self.runs, direction)[:, :2] for direction in DIRECTIONS]
        return max(
            math.sqrt(float(one.var(axis=0, ddof=1).sum()) / len(one)) if len(one) > 1 else 0.0
            for one in errors
        )

    def summary(self) -> Dict[str, Any]:
        """Return the figures of the benchmark by their usual names."""
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
