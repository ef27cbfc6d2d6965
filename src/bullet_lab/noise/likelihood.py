"""Likelihood of the steps of an odometry under a noise model, given the true steps.

For a step of direction psi, signed length d and turn phi, `NoisyPath` reports direction psi + e1,
length d + et and turn phi + e1 + e2, with independent Gaussian e1, et and e2 whose variances a, s²
and b are the rule's. So both steps give the noise, and its density is known exactly. The truth is
measured, too: for each step its position has variance p and its heading variance q. With the true
step's length D

    l = D e1 ~ N(0, D² a + p),    et ~ N(0, s² + p),    w = e1 + e2 ~ N(0, a + b + q),
    Cov(l, w) = D a,

and w is made independent of l: w - k l with k = D a / (D² a + p) has the variance
b + q + a p / (D² a + p). A step shorter than `MIN_TRANSLATION` has no direction: D is 0. The result
is three independent Gaussians for each step. p and q also cover the rounding of a file; without
them a robot that drives exactly straight, by a rule that gives no noise to turns of 0, would have a
likelihood of 0 or infinity.

The Jacobian of the odometry's (x, y) in polar coordinates depends on no parameter, and D is the
truth's, so likelihoods of all models and systematic errors are comparable.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from bullet_lab.core.se2 import wrap
from bullet_lab.noise.odometry_noise import (
    MIN_TRANSLATION,
    NoiseError,
    NoiseRule,
    line_of_travel,
)

RESOLUTION = 1e-9
"""m and rad; standard deviation of the truth's poses by default."""

PARTS = ("rot1", "trans", "rot2")


@dataclass(frozen=True, eq=False)
class StepPairs:
    """True steps, and the steps of b odometries that share them.

    Attributes:
        true: (dx m, dy m, dyaw rad) in the body frame before each step, shape (n, 3).
        odometry: the same as the odometries report it, shape (b, n, 3).
        truth_std_m: standard deviation of the truth's position, on each axis, > 0.
        truth_std_rad: standard deviation of the truth's heading, > 0.

    Raises:
        NoiseError: the shapes do not match.
    """

    true: np.ndarray
    odometry: np.ndarray
    truth_std_m: float = RESOLUTION
    truth_std_rad: float = RESOLUTION

    def __post_init__(self) -> None:
        shape = self.true.shape
        if self.true.ndim != 2 or shape[1] != 3 or self.odometry.shape[1:] != shape:
            raise NoiseError(f"steps of shape {shape} and {self.odometry.shape}")

    @property
    def truth_variances(self) -> Tuple[float, float]:
        """Variances of a step from the truth's errors: p (m²) and q (rad²)."""
        return 2.0 * self.truth_std_m**2, 2.0 * self.truth_std_rad**2

    def some(self, rows) -> StepPairs:
        """Return some of the odometries, by their indices."""
        return StepPairs(self.true, self.odometry[rows], self.truth_std_m, self.truth_std_rad)


@dataclass(frozen=True, eq=False)
class PartErrors:
    """The noise that was added to each part of each step.

    Attributes:
        lever: m, length of the true steps, 0 for those without a direction, shape (n,).
        sideways: m, error of rot1 at the end of the true step, shape (b, n).
        along: m, error of trans, shape (b, n).
        turned: rad, error of rot1 and rot2 together, in [-pi, pi), shape (b, n).
        parts: rot1, trans and rot2 of the steps without noise, shape (3, n) or (3, b, n).
    """

    lever: np.ndarray
    sideways: np.ndarray
    along: np.ndarray
    turned: np.ndarray
    parts: np.ndarray

    def some(self, rows) -> PartErrors:
        """Return those of some of the odometries, by their indices."""
        own = (self.sideways[rows], self.along[rows], self.turned[rows])
        parts = self.parts[:, rows] if self.parts.ndim > 2 else self.parts
        return PartErrors(self.lever, *own, parts)

    def residuals(self, rule: NoiseRule, p: float, q: float) -> Tuple[np.ndarray, np.ndarray]:
        """Return independent errors and their variances by a rule, see `residuals`."""
        variance1, variance_trans, variance2 = rule.variances(*self.parts)
        moved = self.lever * variance1
        variance_sideways = self.lever * moved + p
        rest = variance2 + q + variance1 * (p / variance_sideways)
        errors = np.empty((*self.turned.shape, 3))
        errors[..., 0], errors[..., 1] = self.sideways, self.along
        errors[..., 2] = self.turned - moved / variance_sideways * self.sideways
        variances = np.empty_like(errors)
        variances[..., 0], variances[..., 1] = variance_sideways, variance_trans + p
        variances[..., 2] = rest
        return errors, variances


def part_errors(pairs: StepPairs, expected=None) -> PartErrors:
    """Compare the reported steps with those expected without noise; see `residuals`."""
    expected = pairs.true if expected is None else expected
    direction, trans = line_of_travel(expected[..., 0], expected[..., 1])
    cos, sin = np.cos(direction), np.sin(direction)
    dx, dy, turn = np.moveaxis(pairs.odometry, -1, 0)
    ahead, aside = cos * dx + sin * dy, cos * dy - sin * dx
    side = np.where(ahead < 0.0, -1.0, 1.0)
    # The true step decides whether there is a direction. Otherwise the likelihood would jump where
    # a systematic error turns a rotation on the spot into a translation of 0.1 mm.
    lever = np.hypot(pairs.true[:, 0], pairs.true[:, 1])
    lever = np.where(lever >= MIN_TRANSLATION, lever, 0.0)
    rot1 = np.where(lever > 0.0, direction, 0.0)
    return PartErrors(
        lever=lever,
        sideways=lever * np.arctan2(side * aside, np.abs(ahead)),
        along=side * np.hypot(ahead, aside) - trans,
        turned=wrap(turn - expected[..., 2]),
        parts=np.stack((rot1, trans, wrap(expected[..., 2] - rot1))),
    )


def residuals(pairs: StepPairs, rule: NoiseRule, expected=None) -> Tuple[np.ndarray, np.ndarray]:
    """Return the noise that was added to each part of each step, and its variance under a rule.

    Args:
        pairs: b odometries of n steps.
        rule: the noise rule; its parameters may be arrays of shape (b, 1).
        expected: steps that the odometry would report without the noise, shape (n, 3) or
            (b, n, 3); the true ones by default.

    Returns:
        The errors of the parts rot1 (as m at the end of the true step), trans (m) and rot2 (rad,
        made independent of rot1), and their variances, both of shape (b, n, 3). Under the rule
        the errors are independent and Gaussian.

    >>> from bullet_lab.noise.odometry_noise import ReportRule
    >>> pairs = StepPairs(np.array([[1.0, 0.0, 0.0]]), np.array([[[1.2, 0.0, 0.0]]]))
    >>> error, variance = residuals(pairs, ReportRule(0.1))
    >>> error.round(6), variance.round(6)
    (array([[[0. , 0.2, 0. ]]]), array([[[0.  , 0.01, 0.  ]]]))
    """
    return part_errors(pairs, expected).residuals(rule, *pairs.truth_variances)


def whitened(pairs: StepPairs, rule: NoiseRule, expected=None) -> np.ndarray:
    """Return the errors of `residuals` over their standard deviations, shape (b, n, 3).

    If rule and expectation are right, they are standard normal. NaN if the rule gives the part less
    noise than the truth's poses have, and the error is not larger than that.
    """
    error, variance = residuals(pairs, rule, expected)
    p, q = pairs.truth_variances
    floor = np.array((p, p, q))
    shown = (variance > 2.0 * floor) | (error * error > 25.0 * floor)
    return np.where(shown, error / np.sqrt(variance), np.nan)


def drawn_pairs(
    true, rule: NoiseRule, generator: np.random.Generator, count: int, expected=None, **truth
) -> StepPairs:
    """Draw odometries whose `whitened` errors are standard normal.

    Args:
        true: the true steps, shape (n, 3).
        rule: the noise rule.
        generator: of the normal draws, three for each step.
        count: how many odometries.
        expected: steps without noise, shape (n, 3); the true ones by default.
        truth: truth_std_m and truth_std_rad as of `StepPairs`.
    """
    expected = true if expected is None else expected
    exact = StepPairs(true, np.asarray(expected)[np.newaxis], **truth)
    _, variance = residuals(exact, rule, expected)
    errors = part_errors(exact, expected)
    p, _ = exact.truth_variances
    draws = generator.standard_normal((count, len(true), 3)) * np.sqrt(variance)
    moved = errors.lever * np.broadcast_to(rule.variances(*errors.parts)[0], errors.lever.shape)
    turned = draws[..., 2] + moved / (errors.lever * moved + p) * draws[..., 0]
    direction, trans = line_of_travel(expected[:, 0], expected[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        error1 = np.where(errors.lever > 0.0, draws[..., 0] / errors.lever, 0.0)
    direction = direction + error1
    trans = trans + draws[..., 1]
    steps = (trans * np.cos(direction), trans * np.sin(direction), expected[:, 2] + turned)
    return StepPairs(true, np.stack(steps, axis=-1), **truth)
