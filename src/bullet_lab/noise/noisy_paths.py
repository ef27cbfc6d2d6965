"""Many noisy versions of one perfect path at once: a vectorised `NoisyPath`.

The poses of a noisy path are sums. With P = x + iy, step k of signed length d_k along the
direction psi_k, and the noise e1, et, e2 of its three parts,

    H_k = sum of (e1 + e2) over the steps before k, plus e1 of step k itself,
    P_n = P_0 + sum over k <= n of (d_k + et_k) exp(i (psi_k + H_k)),

so whole blocks of paths come from two cumulative sums.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Iterator

import numpy as np
from numpy import ndarray

from bullet_lab.core import se2
from bullet_lab.noise.exact_moments import NoisySteps
from bullet_lab.noise.odometry_noise import MODELS, NoiseRule, decompose, line_of_travel

STEPS_PER_BLOCK = 16384
"""Steps of a block: their arrays, about 1.5 MB, fit into the processor's cache."""


def noisy_steps(poses, rule: NoiseRule) -> NoisySteps:
    """Return the steps of a perfect path: x (m), y (m), yaw (rad), finite, (n+1, 3), n >= 1.

    >>> from bullet_lab.noise.odometry_noise import ReportRule
    >>> steps = noisy_steps([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0)], ReportRule(0.5))
    >>> len(steps), steps.trans, steps.variance_trans
    (1, array([2.]), array([1.]))
    """
    poses = np.asarray(poses, dtype=float)
    body = se2.steps(poses)
    parts = decompose(body)
    # As in NoisyPath, a step that is too short for a rot1 keeps its direction.
    angle = poses[:-1, 2] + line_of_travel(body[:, 0], body[:, 1])[0]
    shape = parts.shape[:1]
    variances = [np.broadcast_to(v, shape).astype(float) for v in rule.variances(*parts.T)]
    moved = poses - poses[0]
    return NoisySteps(
        moved[:, 0] + 1j * moved[:, 1], np.exp(1j * angle), angle, parts[:, 1], *variances
    )


@dataclass(frozen=True, eq=False)
class NoisyBlock:
    """A block of noisy paths.

    Attributes:
        first: index of the first of them among all.
        position: x + iy (m) of each pose, relative to the first pose but not rotated: b paths of
            n + 1 poses, shape (b, n+1).
        heading_error: rad, noisy minus perfect, not wrapped, shape (b, n+1).
    """

    first: int
    position: ndarray
    heading_error: ndarray

    def __len__(self) -> int:
        return len(self.position)

    def poses(self, perfect: ndarray) -> ndarray:
        """Return x (m), y (m) and yaw (rad, not wrapped) for the perfect ones, (b, n+1, 3)."""
        x, y = perfect[0, 0] + self.position.real, perfect[0, 1] + self.position.imag
        return np.stack([x, y, perfect[:, 2] + self.heading_error], axis=-1)


def noisy_blocks(
    steps: NoisySteps,
    generator: np.random.Generator,
    count: int,
    steps_per_block: int = STEPS_PER_BLOCK,
) -> Iterator[NoisyBlock]:
    """Yield noisy paths in blocks, so that memory does not grow with their number.

    For any block size they equal, to rounding, those of `NoisyPath` with the same generator,
    restarted before each path. A block has about `steps_per_block`; a path is not divided.
    """
    n = len(steps)
    size = max(1, steps_per_block // n)
    stds = np.sqrt(np.stack([steps.variance_trans, steps.variance1, steps.variance2], axis=-1))
    for first in range(0, count, size):
        b = min(size, count - first)
        draws = generator.standard_normal((b, n, 3))
        draws *= stds
        angle, turn = draws[..., 1], draws[..., 2]
        turn += angle
        heading = np.zeros((b, n + 1))
        np.cumsum(turn, axis=1, out=heading[:, 1:])
        angle += heading[:, :-1]
        angle += steps.angle
        trans = draws[..., 0]
        trans += steps.trans
        moves = np.empty((b, n), dtype=complex)
        np.multiply(np.cos(angle), trans, out=moves.real)
        np.multiply(np.sin(angle), trans, out=moves.imag)
        position = np.zeros((b, n + 1), dtype=complex)
        np.cumsum(moves, axis=1, out=position[:, 1:])
        yield NoisyBlock(first, position, heading)


def study_generator(seed: int, model: str, std: float, rate: float) -> np.random.Generator:
    """Return the random generator of one case of a study: a model at a level and a rate (Hz).

    Its stream is spawned from the seed (>= 0) with a key made of the case, so that it does not
    depend on the other cases, on the registered models, or on their order.

    >>> stds = (0.0, -0.0, 0.2)
    >>> one, same, other = (study_generator(1, "report", s, 20.0).standard_normal() for s in stds)
    >>> one == same, one == other
    (True, False)
    """
    # Not the index of the model in a list, which another model might change.
    # Adding 0.0 turns -0.0 into 0.0.
    words = struct.unpack("<4I", struct.pack("<2d", std + 0.0, rate + 0.0))
    sequence = np.random.SeedSequence(seed, spawn_key=(MODELS[model].stream, *words))
    # Normal draws take half of the time, and numpy's default generator a third longer.
    return np.random.Generator(np.random.SFC64(sequence))
