"""Noise on planar odometry that accumulates like the error of real odometry.

Each displacement between two poses is decomposed into a rotation, a translation and a second
rotation. A noise rule gives the variance of each part, and the noisy path is composed of the noisy
parts. The model is that of Thrun, Burgard and Fox, Probabilistic Robotics, section 5.4, with a
signed translation, so that driving backwards is not two half turns.
"""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass, field, fields, make_dataclass, replace
from typing import Any, ClassVar, Dict, Mapping, Sequence, Tuple, Type

import numpy as np
from numpy import ndarray

from bullet_lab.core.parameters import declarations, number
from bullet_lab.core.se2 import PlanarPose, atan2, columns, hypot, wrap
from bullet_lab.errors import LabError
from bullet_lab.noise.exact_moments import RunningMoments

MIN_TRANSLATION = 1e-4
"""m; a shorter step has no direction (at 20 Hz this is 2 mm/s)."""

LARGEST_PARAMETER = 1e6
"""Far beyond any robot; keeps squares and sums finite."""


class NoiseError(LabError):
    """The noise model is unknown, or its parameters have another number."""


def decompose(steps) -> ndarray:
    """Decompose displacements (m, m, rad) in the body frame before each into rot1, trans and rot2.

    Turning by rot1 (rad, in [-pi/2, pi/2]), going trans ahead (m, back when negative) and turning
    by rot2 (rad, in [-pi, pi)) leads to the same pose. A step shorter than `MIN_TRANSLATION` has no
    meaningful direction: its rot1 is 0. Both arrays are of shape (..., 3).

    >>> decompose((0.5, 0.0, 0.25))
    array([0.  , 0.5 , 0.25])
    """
    dx, dy, dyaw = columns(steps)
    direction, trans = line_of_travel(dx, dy)
    rot1 = np.where(np.abs(trans) >= MIN_TRANSLATION, direction, 0.0)
    return np.stack([rot1, trans, wrap(dyaw - rot1)], axis=-1)


def line_of_travel(dx, dy) -> Tuple[ndarray, ndarray]:
    """Return the line of travel (rad, in [-pi/2, pi/2]) and the signed length (m) along it.

    dx (m, ahead) and dy (m, to the left) are arrays of a shape. Unlike in `decompose`, even the
    shortest step has a direction.
    """
    sign = np.where(dx < 0.0, -1.0, 1.0)
    return np.arctan2(sign * dy, np.abs(dx)), sign * hypot(dx, dy)


def _direction(dx: float, dy: float) -> Tuple[float, float]:
    """Return what `line_of_travel` returns, for floats."""
    length = hypot(dx, dy)
    if dx < 0.0:
        return atan2(-dy, -dx), -length
    # Adding 0.0 turns -0.0, whose arc tangent is pi, into 0.0.
    return atan2(dy, dx + 0.0), length


@dataclass(frozen=True)
class NoiseRule(abc.ABC):
    """A noise model, a frozen dataclass below `register`: it gives the variances of a step.

    Its fields, declared with `bullet_lab.core.parameters.number`, are >= 0 and parameters of
    noisy_odom; models share parameters of the same name. A value is checked where it is read from a
    user, and not again. Studies choose a level of noise by `at_level`.

    Attributes:
        name: of the model, as in the parameter `model`.
        title: of the model in figures.
        stream: number in the key of a study's random generators. It never changes, so that the
            results of studies do not depend on other models.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    stream: ClassVar[int]

    @classmethod
    def at_level(cls, std: float) -> NoiseRule:
        """Return the rule at a level of noise."""
        return rule_of(cls.name, {"std": std})

    def scaled(self, factor: float) -> NoiseRule:
        """Return the rule with so many times the variances; parameters are standard deviations."""
        root = math.sqrt(factor)
        return replace(self, **{name: root * value for name, value in vars(self).items()})

    @abc.abstractmethod
    def variances(self, rot1, trans, rot2):
        """Return the variances of rot1 (rad²), trans (m²) and rot2 (rad²) of a step.

        The parts (rad, m and signed, rad) are floats, or arrays of one shape.
        """


MODELS: Dict[str, Type[NoiseRule]] = {}
"""The noise models by name."""


def register(model: Type[NoiseRule]) -> Type[NoiseRule]:
    """Register a noise model: a decorator of its class.

    Raises ValueError if there is one with this name or stream.
    """
    for other in MODELS.values():
        if model.name == other.name or model.stream == other.stream:
            raise ValueError(f"{model.__name__} has the name or the stream of {other.__name__}")
    MODELS[model.name] = model
    return model


def strength(default: float, doc: str) -> Any:
    """Declare a parameter of a noise model, >= 0: 0 for no noise."""
    return number(default, doc, minimum=0.0, maximum=LARGEST_PARAMETER)


@register
@dataclass(frozen=True)
class ReportRule(NoiseRule):
    """The rule of the report: standard deviation = std · |part|, for each message.

    >>> ReportRule(0.5).variances(0.0, -2.0, 1.0)
    (0.0, 1.0, 0.25)
    """

    name, title, stream = "report", "The report's", 0

    std: float = strength(
        0.1, "standard deviation per metre and per radian (rate_invariant: per root)"
    )

    def variances(self, rot1, trans, rot2):  # noqa: D102 - inherited
        std1, std_trans, std2 = self.std * rot1, self.std * trans, self.std * rot2
        return std1 * std1, std_trans * std_trans, std2 * std2


class WalkRule(NoiseRule):
    """A random walk: variances in proportion to way and angle, for steps of any length."""

    @abc.abstractmethod
    def walked(self, distance, angle):
        """Return the variances of heading (rad²) and translation (m²) of a way.

        Distance (m, forwards and backwards) and angle (rad, to both sides) are >= 0.
        """

    def variances(self, rot1, trans, rot2):  # noqa: D102 - inherited
        turned, moved = self.walked(abs(trans), abs(wrap(rot1 + rot2)))
        return 0.5 * turned, moved, 0.5 * turned


@register
@dataclass(frozen=True)
class RateInvariantRule(WalkRule):
    """Variance in proportion to the distance travelled, as of a random walk.

    The heading variance of a path, and the variance along a straight one, do not depend on the
    number of messages; across, N steps give 1 + 1/(2 N²) times the limit std² L³ / 3. Strafing
    counts as distance, not as two turns.

    The unit of std is m/√m and rad/√m and rad/√rad.

    >>> RateInvariantRule(0.5).variances(0.0, -2.0, 0.0)
    (0.25, 0.5, 0.25)
    """

    name, title, stream = "rate_invariant", "Rate-invariant", 1

    std: float = strength(0.1, "standard deviation per root of a metre and of a radian")

    def walked(self, distance, angle):  # noqa: D102 - inherited
        variance = self.std * self.std
        return variance * (distance + angle), variance * distance


@register
@dataclass(frozen=True)
class ProbabilisticRule(NoiseRule):
    """The odometry motion model of Probabilistic Robotics, 2nd and later printings, table 5.6.

    The parameters multiply squares, so each is a variance, not a standard deviation; alpha2 is in
    rad²/m², alpha4 in m²/rad².

    >>> ProbabilisticRule(0.5, 0.25, 2.0, 1.0).variances(0.0, 2.0, -1.0)
    (1.0, 9.0, 1.5)
    """

    name, title, stream = "probabilistic", "Probabilistic", 2

    alpha1: float = strength(0.01, "probabilistic: rotation from rotation")
    alpha2: float = strength(0.001, "probabilistic: rotation from distance")
    alpha3: float = strength(0.01, "probabilistic: distance from distance")
    alpha4: float = strength(0.001, "probabilistic: distance from rotation")

    @classmethod
    def at_level(cls, std: float) -> NoiseRule:
        """Return the rule with alpha1 = alpha3 = std² and alpha2 = alpha4 = std² / 10."""
        square = std * std
        return cls(square, 0.1 * square, square, 0.1 * square)

    def scaled(self, factor: float) -> NoiseRule:  # noqa: D102 - inherited
        return replace(self, **{name: factor * value for name, value in vars(self).items()})

    def variances(self, rot1, trans, rot2):  # noqa: D102 - inherited
        turn1, moved, turn2 = rot1 * rot1, trans * trans, rot2 * rot2
        return (
            self.alpha1 * turn1 + self.alpha2 * moved,
            self.alpha3 * moved + self.alpha4 * (turn1 + turn2),
            self.alpha1 * turn2 + self.alpha2 * moved,
        )


@register
@dataclass(frozen=True)
class RandomWalkRule(WalkRule):
    """Rate-invariant noise whose way and heading are not equally noisy, as those of real robots.

    The units are m/√m, rad/√m and rad/√rad.

    >>> RandomWalkRule(0.5, 0.0, 1.0).variances(0.0, 2.0, -1.0)
    (0.5, 0.5, 0.5)
    """

    name, title, stream = "random_walk", "Random walk", 3

    way_std: float = strength(0.03, "random_walk: distance, per root of a metre")
    heading_std: float = strength(0.03, "random_walk: heading, per root of a metre")
    turn_std: float = strength(0.08, "random_walk: heading, per root of a radian")

    @classmethod
    def at_level(cls, std: float) -> NoiseRule:
        """Return the rule whose heading has this level, and whose way a third of it."""
        return cls(std / 3.0, std, std)

    def walked(self, distance, angle):  # noqa: D102 - inherited
        on_ways, in_turns = self.heading_std * self.heading_std, self.turn_std * self.turn_std
        return on_ways * distance + in_turns * angle, self.way_std * self.way_std * distance


def model_named(name: str) -> Type[NoiseRule]:
    """Return the noise model of a name; raises NoiseError if it is not in `MODELS`."""
    try:
        return MODELS[name]
    except KeyError:
        raise NoiseError(f"unknown noise model {name!r}; choose from {', '.join(MODELS)}") from None


def noise_parameters() -> Any:
    """Return a frozen dataclass with the parameters of all models, each once: a base class."""
    found: Dict[str, Any] = {}
    for model in MODELS.values():
        for own in fields(model):
            found.setdefault(own.name, field(default=own.default, metadata=own.metadata))
    own_fields = [(name, float, copy) for name, copy in found.items()]
    return make_dataclass("NoiseParameters", own_fields, frozen=True)


def rule_of(model: str, values: Mapping[str, Any]) -> NoiseRule:
    """Return the noise rule of a model; raises NoiseError if it is unknown.

    The values of parameters by name have been checked. Those of other models are ignored, and
    missing ones have their defaults.

    >>> rule_of("report", {"std": 0.2, "alpha1": 0.1})
    ReportRule(std=0.2)
    """
    kind = model_named(model)
    return kind(**{name: values[name] for name in declarations(kind) if name in values})


def named_alphas(model: str, alphas: Sequence[float]) -> Dict[str, float]:
    """Return the parameters of a model other than std, by name, from their values in order.

    Raises NoiseError if the model is unknown, or has a different number of them, and not none.
    """
    names = [name for name in declarations(model_named(model)) if name != "std"]
    if names and len(alphas) != len(names):
        raise NoiseError(f"the {model} model takes {len(names)} alphas, not {len(alphas)}")
    return dict(zip(names, alphas))


def derived_seed(seed: int, index: int) -> int:
    """Return the seed, within 31 bits, of one of several independent sources.

    Unlike seed + index, neighbouring seeds (>= 0) do not share derived seeds.

    >>> derived_seed(1, 0), derived_seed(1, 1)
    (917752063, 594516694)
    """
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0]) >> 1


@dataclass(frozen=True, eq=False)
class NoisyStep:
    """The report of a noisy odometry for one message; all arrays are read-only.

    Attributes:
        pose: noisy x (m), y (m) and yaw (rad, in [-pi, pi)) in the odometry frame.
        covariance: 3x3, of (x, y, yaw) in the odometry frame: the exact second moments of the error
            about the perfect pose since the start. Its axes are the perfect path's.
        motion_error: noisy minus true step as (dx m, dy m, dyaw rad), each step in the body
            frame before it.
        motion_covariance: 3x3, likewise, of this step alone, in the body frame before it. Divided
            by the square of the time of the step it is that of the twist.
    """

    pose: PlanarPose
    covariance: ndarray
    motion_error: PlanarPose
    motion_covariance: ndarray


class NoisyPath:
    """Makes a noisy path from a perfect one, pose by pose.

    The first pose is returned unchanged. Each later pose adds the noisy step to the previous noisy
    pose, so that errors accumulate and a heading error bends the rest of the path. Message k uses
    the normal draws 3k-3 to 3k-1 of the generator (for trans, rot1 and rot2), whether the robot
    moves or not.

    Args:
        rule: gives the variances of a step.
        seed: of the path's random generator, >= 0; None for a different one each time.

    >>> path = NoisyPath(ReportRule(0.0), seed=1)
    >>> [path.update(x, 0.0, 0.0).pose for x in (0.0, 0.5)]
    [(0.0, 0.0, 0.0), (0.5, 0.0, 0.0)]
    """

    def __init__(self, rule: NoiseRule, seed: int | None):
        self._rule = rule
        self._generator = np.random.default_rng(seed)
        self._true = None
        self._noisy = None
        self._moments = RunningMoments()

    def restart(self) -> None:
        """Start a new path with the next pose. The random generator is not reset."""
        self._true = None

    def change_rule(self, rule: NoiseRule) -> None:
        """Use another rule from the next pose on; path, covariance and generator are kept."""
        self._rule = rule

    def update(self, x: float, y: float, yaw: float) -> NoisyStep:
        """Return the noisy pose for the next perfect pose (m, m, rad), which is finite."""
        before, self._true = self._true, (x, y, yaw)
        if before is None:
            return self._start(x, y, yaw)

        dx, dy, dyaw = body_step(before, self._true)
        direction, trans = _direction(dx, dy)
        # As of `decompose`, for floats.
        rot1 = direction if abs(trans) >= MIN_TRANSLATION else 0.0
        variances = self._rule.variances(rot1, trans, wrap(dyaw - rot1))
        error1, error_trans, error2 = self._draw(variances)
        self._moments.add(before[2] + direction, trans, variances)
        motion = RunningMoments()
        motion.add(direction, trans, variances)

        # The true direction is kept even if the step is too short for a rot1, so that the small
        # sideways drift of a robot that turns is not reported as driving ahead.
        direction += error1
        trans += error_trans
        error_yaw = wrap(error1 + error2)
        motion_error = (
            trans * math.cos(direction) - dx,
            trans * math.sin(direction) - dy,
            error_yaw,
        )
        noisy_x, noisy_y, noisy_yaw = self._noisy
        direction += noisy_yaw
        self._noisy = (
            noisy_x + trans * math.cos(direction),
            noisy_y + trans * math.sin(direction),
            wrap(noisy_yaw + dyaw + error_yaw),
        )
        covariance, own = self._moments.second_moments(), motion.second_moments()
        return NoisyStep(self._noisy, covariance, motion_error, own)

    def _start(self, x: float, y: float, yaw: float) -> NoisyStep:
        self._noisy = (x, y, wrap(yaw))
        self._moments = RunningMoments()
        zeros = self._moments.second_moments()
        return NoisyStep(self._noisy, zeros, (0.0, 0.0, 0.0), zeros)

    def _draw(self, variances) -> tuple[float, float, float]:
        draw_trans, draw1, draw2 = self._generator.standard_normal(3).tolist()
        root1, root_trans, root2 = map(math.sqrt, variances)
        return root1 * draw1, root_trans * draw_trans, root2 * draw2


def body_step(before, after) -> PlanarPose:
    """Return what `se2.between` returns, for two poses of floats, and many times as fast."""
    dx, dy = after[0] - before[0], after[1] - before[1]
    cos, sin = math.cos(before[2]), math.sin(before[2])
    return cos * dx + sin * dy, cos * dy - sin * dx, wrap(after[2] - before[2])
