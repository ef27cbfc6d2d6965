"""The noise of the report as it was published, with a switch for each of its defects.

With all defects it is the algorithm of listings 3 to 7 of the report, to the last bit. Without
defects it is `odometry_noise.NoisyPath` with `ReportRule`, except that a step backwards counts as a
half turn, a step forwards and another half turn, as in the report, with noise accordingly.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import astuple, dataclass, fields
from types import SimpleNamespace
from typing import Any, Optional, Tuple

import numpy as np

from bullet_lab.core.se2 import PlanarPose, atan2, hypot, wrap
from bullet_lab.noise.odometry_noise import MIN_TRANSLATION

PUBLISHED_RATE = 0.9
"""Hz; rate at which the published node samples the odometry."""

# s; the resolution of present-day stamps as doubles is not much finer.
_STAMP_TOLERANCE = 1e-6
# For floats; the functions of numpy are for arrays.
_MATH = SimpleNamespace(sin=math.sin, cos=math.cos, arctan2=atan2, hypot=hypot)


@dataclass(frozen=True)
class Defects:
    """The report's defects that are enabled; by default none.

    Attributes:
        aliasing: the message that is kept as the last perfect one is overwritten with the noisy
            pose, so that each step starts from the noisy pose.
        unwrapped: rot1 and rot2 are differences of angles that are not wrapped.
        noise_at_rest: a robot at rest has rot1 = atan2(0, 0) - yaw = -yaw, and noise for it.
        sampled: only the newest message is used, 0.9 times a second.
        unbent: a step follows the perfect heading, not the noisy one.
    """

    aliasing: bool = False
    unwrapped: bool = False
    noise_at_rest: bool = False
    sampled: bool = False
    unbent: bool = False

    @property
    def names(self) -> Tuple[str, ...]:
        """The names of the enabled defects."""
        return tuple(name for name in DEFECTS if getattr(self, name))

    def __str__(self) -> str:
        return " + ".join(self.names) or "none"


DEFECTS = tuple(field.name for field in fields(Defects))
"""The names of the defects, in the order in which the listings have them."""

ALL = Defects(*[True] * len(DEFECTS))
"""The report's algorithm as published."""

NONE = Defects()
"""The corrected algorithm."""


def combinations() -> Tuple[Defects, ...]:
    """Return all 32 combinations, sorted by their number of defects."""
    switches = itertools.product((False, True), repeat=len(DEFECTS))
    return tuple(sorted((Defects(*s) for s in switches), key=lambda d: sum(astuple(d))))


class PublishedAlgorithm:
    """The report's algorithm, with some of its defects, message by message, for one path or many.

    Args:
        std: standard deviation per metre and per radian, >= 0.
        defects: the enabled ones; `sampled` decides which messages it gets, see the function.
        functions: module with sin, cos, arctan2 and hypot for the numbers.
    """

    def __init__(self, std: float, defects: Defects, functions: Any):
        self._std = std
        self._defects = defects
        self._functions = functions
        self.restart()

    def restart(self) -> None:
        """Start a new path with the next pose."""
        # Summed up, with a yaw that is not wrapped.
        self._pose: Any = None

    def step(self, x, y, yaw, draws):
        """Return the noisy pose, yaw in [-pi, pi], for the next perfect pose (m, m, rad).

        `draws` are standard normal, for trans, rot1 and rot2; a first pose needs none.
        """
        now = x, y, self._through_message(yaw)
        self._pose = now if self._pose is None else self._moved(now, draws)
        self._before = now
        self._noisy = (*self._pose[:2], self._through_message(self._pose[2]))
        return self._noisy

    def _moved(self, now, draws):
        """Return the summed pose (x, y and an unwrapped yaw) after one more step."""
        x, y, summed_yaw = self._pose
        remembered = self._noisy if self._defects.aliasing else self._before
        dx, dy = now[0] - remembered[0], now[1] - remembered[1]
        turn = now[2] - remembered[2]
        trans = self._functions.hypot(dx, dy)
        rot1 = self._functions.arctan2(dy, dx) - remembered[2]
        rot2 = turn - rot1
        if not self._defects.unwrapped:
            rot1, rot2, turn = wrap(rot1), wrap(rot2), wrap(turn)
        noise1, noise2 = rot1, rot2
        if not self._defects.noise_at_rest:
            at_rest = trans < MIN_TRANSLATION
            noise1, noise2 = np.where(at_rest, 0.0, rot1), np.where(at_rest, turn, rot2)

        trans = trans + abs(self._std * trans) * draws[0]
        rot1 = rot1 + abs(self._std * noise1) * draws[1]
        rot2 = rot2 + abs(self._std * noise2) * draws[2]
        direction = (remembered if self._defects.unbent else self._noisy)[2] + rot1
        return (
            x + trans * self._functions.cos(direction),
            y + trans * self._functions.sin(direction),
            summed_yaw + rot1 + rot2,
        )

    def _through_message(self, yaw):
        """Return a yaw (rad) after conversion to the quaternion of a message and back."""
        z, w = self._functions.sin(0.5 * yaw), self._functions.cos(0.5 * yaw)
        return self._functions.arctan2(2.0 * (w * z + 0.0), w * w - z * z)


def noisy_paths(poses, draws, std: float, defects: Defects, functions: Any = np) -> np.ndarray:
    """Return noisy versions of the poses that the algorithm sees, (n, m, 3), yaw in [-pi, pi].

    Args:
        poses: perfect x (m), y (m) and yaw (rad), finite, shape (n, m, 3) for m different paths or
            (n, 1, 3) for m noisy versions of one.
        draws: standard normal, for trans, rot1 and rot2 of each step, shape (n - 1, m, 3). Path
            k is that of a `PublishedNoise` whose generator draws `draws[:, k]`.
        std: standard deviation per metre and per radian, for each step, >= 0.
        defects: the enabled ones.
        functions: as of `PublishedAlgorithm`, for arrays. Numpy's are the fastest, and their last
            bit depends on the processor.
    """
    algorithm = PublishedAlgorithm(std, defects, functions)
    noisy = np.empty((len(poses), draws.shape[1], 3))
    for row, pose, draw in zip(noisy, poses, (None, *np.moveaxis(draws, 2, 1))):
        for column, values in zip(row.T, algorithm.step(*pose.T, draw)):
            column[:] = values
    return noisy


class PublishedNoise(PublishedAlgorithm):
    """The algorithm with all defects, for one path; a seed of None is a different one each time.

    >>> published = PublishedNoise(0.0, seed=1)
    >>> [published.update(x, 0.0, 0.0) for x in (0.0, 0.5)]
    [(0.0, 0.0, 0.0), (0.5, 0.0, 0.0)]
    """

    def __init__(self, std: float, seed: Optional[int]):
        super().__init__(std, ALL, _MATH)
        self._generator = np.random.default_rng(seed)

    def update(self, x: float, y: float, yaw: float) -> PlanarPose:
        """Return the noisy pose, yaw in [-pi, pi], for the next perfect pose (m, m, rad).

        `restart` does not reset the random generator.
        """
        is_first = self._pose is None
        return self.step(x, y, yaw, () if is_first else self._generator.standard_normal(3).tolist())


class Sampler:
    """Selects the messages that a node would receive that polls at a fixed rate (Hz).

    The node sleeps before its first poll, so tick k = 1, 2, … is at the first stamp + k / rate.

    >>> sampler = Sampler(1.0)
    >>> [sampler.due(stamp) for stamp in (0.0, 0.6, 1.2, 1.8)]
    [False, False, True, False]
    """

    def __init__(self, rate: float):
        self._rate = rate
        self.restart()

    def restart(self) -> None:
        """Count ticks from the next stamp."""
        self._start: Optional[float] = None
        self._tick = 1

    def due(self, stamp: float) -> bool:
        """Return whether this message (stamp in s) is the first at or after a tick.

        Several ticks between two messages count once.
        """
        if self._start is None:
            self._start = stamp
            return False
        ticks = math.floor((stamp - self._start + _STAMP_TOLERANCE) * self._rate)
        if ticks < self._tick:
            return False
        self._tick = ticks + 1
        return True


def sampled(stamps, rate: float, phases) -> np.ndarray:
    """Return the index of the first message at or after each poll of a node, (polls, m).

    Args:
        stamps: of the messages, s, increasing, shape (n,).
        rate: of the polls, Hz, > 0.
        phases: s, >= 0, from the first stamp to the first poll, one for each path, shape (m,). Only
            polls count that every path makes before the messages end.
    """
    stamps, phases = np.asarray(stamps, dtype=float), np.asarray(phases, dtype=float)
    polls = math.floor((stamps[-1] - stamps[0] - phases.max()) * rate) + 1
    times = stamps[0] + phases + np.arange(polls)[:, np.newaxis] / rate
    return np.searchsorted(stamps, times - _STAMP_TOLERANCE)
