"""The report's noise with each of its defects as a switch, for many noisy paths at a time.

With all of them on it is `published_noise.PublishedNoise`; with all of them off it is
`odometry_noise.NoisyPath` with `ReportRule`, but for one thing: a step backwards counts as a
half turn, a step forwards and another half turn, as in the report, and gets noise accordingly.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import astuple, dataclass, fields
from typing import Any, Tuple

import numpy as np

from bullet_lab.core.se2 import wrap
from bullet_lab.noise.odometry_noise import MIN_TRANSLATION, NoiseError, ReportRule

_STAMP_TOLERANCE = 1e-6  # s; a double cannot tell stamps of today much closer


@dataclass(frozen=True)
class Defects:
    """Which of the report's defects are in; by default none of them.

    Attributes:
        aliasing: the message remembered as the last perfect one is the one that is overwritten
            with the noisy pose, so that each step starts from there.
        unwrapped: rot1 and rot2 are differences of angles that nobody wraps.
        noise_at_rest: a robot at rest has rot1 = atan2(0, 0) - yaw = -yaw, and noise for it.
        sampled: only the newest message is used, 0.9 times a second.
        unbent: a step is laid along the remembered heading, not along the noisy one.
    """

    aliasing: bool = False
    unwrapped: bool = False
    noise_at_rest: bool = False
    sampled: bool = False
    unbent: bool = False

    @property
    def names(self) -> Tuple[str, ...]:
        """The names of those that are in."""
        return tuple(name for name, is_in in zip(DEFECTS, astuple(self)) if is_in)

    def __str__(self) -> str:
        return " + ".join(self.names) or "none"


DEFECTS = tuple(field.name for field in fields(Defects))
"""The names of the defects, in the order in which the listings run into them."""

ALL = Defects(*[True] * len(DEFECTS))
"""The report's algorithm as it was published."""

NONE = Defects()
"""The mended algorithm."""


def combinations() -> Tuple[Defects, ...]:
    """Return all 32 combinations: those of fewer defects first, none to all."""
    switches = itertools.product((False, True), repeat=len(DEFECTS))
    return tuple(sorted((Defects(*s) for s in switches), key=lambda d: len(d.names)))


def noisy_paths(poses, draws, std: float, defects: Defects, functions: Any = np) -> np.ndarray:
    """Put noise on the poses that the algorithm sees.

    `Defects.sampled` is not looked at here: it says which poses these are, see `sampled`.

    Args:
        poses: perfect x (m), y (m) and yaw (rad), shape (n, m, 3) for m different paths or
            (n, 1, 3) for m noisy versions of one.
        draws: standard normal, for trans, rot1 and rot2 of each step, shape (n - 1, m, 3). Path
            k is that of a live algorithm whose generator draws `draws[:, k]`.
        std: standard deviation per metre and per radian, for each step, >= 0.
        defects: which are in.
        functions: what has sin, cos, arctan2 and hypot for arrays. Numpy's are as fast as they
            come, and their last bit is up to the processor.

    Returns:
        Noisy poses, shape (n, m, 3), yaw in [-pi, pi].

    Raises:
        NoiseError: the shapes do not go together, a pose is not finite or std cannot be used.
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
    """Listings 3 to 7 of the report, with the switches in them."""

    std: float
    defects: Defects
    functions: Any

    def step(self, pose, noisy_yaw, before, now, draws):
        """Return the summed pose (x, y and a yaw that is never wrapped) after one more step.

        Args:
            pose: the summed pose so far.
            noisy_yaw: its yaw as published.
            before: the perfect pose before, shape (3, m).
            now: the perfect pose now, shape (3, m).
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
        """Return a yaw (rad) as it is read back from the quaternion of a message."""
        z, w = self.functions.sin(0.5 * yaw), self.functions.cos(0.5 * yaw)
        return self.functions.arctan2(2.0 * (w * z + 0.0), w * w - z * z)


def sampled(stamps, rate: float, phases) -> np.ndarray:
    """Return which messages a node sees that polls at a fixed rate.

    Args:
        stamps: of the messages, s, increasing, shape (n,).
        rate: Hz, > 0.
        phases: s, >= 0, from the first stamp to the first look, one for each path, shape (m,).

    Returns:
        The index of the first message at or after each look, shape (number of looks, m). There
        are as many looks as every path has before the messages end.

    Raises:
        NoiseError: the rate is not finite or not > 0, or a path never looks.
    """
    stamps, phases = np.asarray(stamps, dtype=float), np.asarray(phases, dtype=float)
    if not 0.0 < rate < math.inf:
        raise NoiseError(f"rate must be finite and > 0, not {rate!r}")
    rest = stamps[-1] - stamps[0] - phases.max() if stamps.size and phases.size else -1.0
    if not rest >= 0.0:
        raise NoiseError("there are no messages for some path to look at")
    looks = math.floor(rest * rate) + 1
    times = stamps[0] + phases + np.arange(looks)[:, np.newaxis] / rate
    return np.searchsorted(stamps, times - _STAMP_TOLERANCE)
