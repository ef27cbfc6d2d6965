"""The report's noise with a switch for each of its defects, for many noisy paths at a time.

With all defects it is `published_noise.PublishedNoise`. Without defects it is
`odometry_noise.NoisyPath` with `ReportRule`, except that a step backwards counts as a half turn,
a step forwards and another half turn, as in the report, with noise accordingly.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import astuple, dataclass, fields
from typing import Any, Tuple

import numpy as np

from bullet_lab.core.se2 import wrap
from bullet_lab.noise.odometry_noise import MIN_TRANSLATION, NoiseError, ReportRule

_STAMP_TOLERANCE = 1e-6  # s; near the resolution of today's stamps in a double


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
        return tuple(name for name, enabled in zip(DEFECTS, astuple(self)) if enabled)

    def __str__(self) -> str:
        return " + ".join(self.names) or "none"


DEFECTS = tuple(field.name for field in fields(Defects))
"""The names of the defects, in the order in which the listings have them."""

ALL = Defects(*[True] * len(DEFECTS))
"""The report's algorithm as published."""

NONE = Defects()
"""The mended algorithm."""


def combinations() -> Tuple[Defects, ...]:
    """Return all 32 combinations, sorted by their number of defects."""
    switches = itertools.product((False, True), repeat=len(DEFECTS))
    return tuple(sorted((Defects(*s) for s in switches), key=lambda d: len(d.names)))


def noisy_paths(poses, draws, std: float, defects: Defects, functions: Any = np) -> np.ndarray:
    """Return noisy versions of the poses that the algorithm sees.

    `Defects.sampled` has no effect here: it decides which poses these are, see `sampled`.

    Args:
        poses: perfect x (m), y (m) and yaw (rad), shape (n, m, 3) for m different paths or
            (n, 1, 3) for m noisy versions of one.
        draws: standard normal, for trans, rot1 and rot2 of each step, shape (n - 1, m, 3). Path
            k is that of a live algorithm whose generator draws `draws[:, k]`.
        std: standard deviation per metre and per radian, for each step, >= 0.
        defects: the enabled ones.
        functions: module with sin, cos, arctan2 and hypot for arrays. Numpy's are the fastest, and
            their last bit depends on the processor.

    Returns:
        Noisy poses, shape (n, m, 3), yaw in [-pi, pi].

    Raises:
        NoiseError: the shapes do not match, a pose is not finite, or std is invalid.
    """
    poses, draws = np.asarray(poses, dtype=float), np.asarray(draws, dtype=float)
    _check(poses, draws)
    algorithm = _Algorithm(ReportRule(std).std, defects, functions)
    count = draws.shape[1]
    perfect = np.empty((len(poses), 3, count))
    perfect[:] = np.moveaxis(poses, 2, 1)
    perfect[:, 2] = algorithm.through_message(perfect[:, 2])

    noisy = np.empty((len(poses), count, 3))
    pose = tuple(perfect[0])
    noisy[0] = np.transpose(pose)
    before = perfect[0]
    for k, draw in enumerate(draws, start=1):
        pose = algorithm.step(pose, noisy[k - 1, :, 2], before, perfect[k], draw.T)
        noisy[k, :, 0], noisy[k, :, 1] = pose[:2]
        noisy[k, :, 2] = algorithm.through_message(pose[2])
        before = perfect[k]
    return noisy


def _check(poses: np.ndarray, draws: np.ndarray) -> None:
    if poses.ndim != 3 or poses.shape[2] != 3 or not len(poses):
        raise NoiseError(f"poses of shape (n, m, 3) are needed, not {poses.shape}")
    count = draws.shape[1] if draws.ndim == 3 else 0
    if draws.shape != (len(poses) - 1, count, 3) or poses.shape[1] not in (1, count):
        raise NoiseError(f"draws of shape {draws.shape} do not fit poses of shape {poses.shape}")
    if not np.isfinite(poses).all():
        raise NoiseError("a pose is not finite")


@dataclass(frozen=True)
class _Algorithm:
    """Listings 3 to 7 of the report, with the switches."""

    std: float
    defects: Defects
    functions: Any

    def step(self, pose, noisy_yaw, before, now, draws):
        """Return the summed pose (x, y and an unwrapped yaw) after one more step.

        Args:
            pose: the summed pose so far.
            noisy_yaw: its yaw as published.
            before: the last perfect pose, shape (3, m).
            now: the new perfect pose, shape (3, m).
            draws: for trans, rot1 and rot2, shape (3, m).
        """
        x, y, summed_yaw = pose
        remembered = (x, y, noisy_yaw) if self.defects.aliasing else before
        dx, dy = now[0] - remembered[0], now[1] - remembered[1]
        turn = now[2] - remembered[2]
        trans = self.functions.hypot(dx, dy)
        rot1 = self.functions.arctan2(dy, dx) - remembered[2]
        rot2 = turn - rot1
        if not self.defects.unwrapped:
            rot1, rot2, turn = wrap(rot1), wrap(rot2), wrap(turn)
        noise1, noise2 = rot1, rot2
        if not self.defects.noise_at_rest:
            at_rest = trans < MIN_TRANSLATION
            noise1, noise2 = np.where(at_rest, 0.0, rot1), np.where(at_rest, turn, rot2)

        trans = trans + abs(self.std * trans) * draws[0]
        rot1 = rot1 + abs(self.std * noise1) * draws[1]
        rot2 = rot2 + abs(self.std * noise2) * draws[2]
        direction = (remembered[2] if self.defects.unbent else noisy_yaw) + rot1
        return (
            x + trans * self.functions.cos(direction),
            y + trans * self.functions.sin(direction),
            summed_yaw + rot1 + rot2,
        )

    def through_message(self, yaw: np.ndarray) -> np.ndarray:
        """Return a yaw (rad) after conversion to the quaternion of a message and back."""
        z, w = self.functions.sin(0.5 * yaw), self.functions.cos(0.5 * yaw)
        return self.functions.arctan2(2.0 * (w * z + 0.0), w * w - z * z)


def sampled(stamps, rate: float, phases) -> np.ndarray:
    """Return the messages that a node sees which polls at a fixed rate.

    Args:
        stamps: of the messages, s, increasing, shape (n,).
        rate: Hz, > 0.
        phases: s, >= 0, from the first stamp to the first poll, one for each path, shape (m,).

    Returns:
        The index of the first message at or after each poll, shape (number of polls, m): the polls
        that every path makes before the messages end.
    """
    stamps, phases = np.asarray(stamps, dtype=float), np.asarray(phases, dtype=float)
    polls = math.floor((stamps[-1] - stamps[0] - phases.max()) * rate) + 1
    times = stamps[0] + phases + np.arange(polls)[:, np.newaxis] / rate
    return np.searchsorted(stamps, times - _STAMP_TOLERANCE)
