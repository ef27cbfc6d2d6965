"""What can be told from a pair of paths, the perfect and the noisy one; noise rules by name."""

from dataclasses import dataclass

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.se2 import wrap
from bullet_lab.core.trajectory import CSV_HEADER, Trajectory
from bullet_lab.noise.odometry_noise import (
    MIN_TRANSLATION,
    decompose_steps,
    named_alphas,
    rule_of,
)


def make_rule(model, std, alphas=()):
    """Return the noise rule of a model from its parameters in order."""
    return rule_of(model, {"std": std, **named_alphas(model, alphas)})


def poses_of(block, perfect):
    """Return x (m), y (m) and yaw (rad, not wrapped) of a `NoisyBlock`, shape (b, n+1, 3)."""
    x, y = perfect[0, 0] + block.position.real, perfect[0, 1] + block.position.imag
    return np.stack([x, y, perfect[:, 2] + block.heading_error], axis=-1)


def read_paths_csv(path):
    """Return the perfect and the noisy path of a file such as paths.csv."""
    assert path.read_text().startswith(f"{CSV_HEADER}\n")
    table = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    return Trajectory(table[:, 0], table[:, 1:4]), Trajectory(table[:, 0], table[:, 4:])


@dataclass(frozen=True, eq=False)
class RecoveredNoise:
    """The noise of each step of a noisy path, and what it was added to.

    Attributes:
        components: (n-1, 3), rot1 (rad), trans (m, signed) and rot2 (rad) of the true steps.
        noise: (n-1, 3), what was added to each. Where the true step has no direction (see
            `MIN_TRANSLATION`), rot1 is NaN and rot2 is the sum of the noise of both rotations,
            all that can be told then.
    """

    components: np.ndarray
    noise: np.ndarray


def recover_noise(true_poses, noisy_poses):
    """Find the noise that `NoisyPath` added at each step, from two paths of shape (n, 3).

    The noise of rot1 is taken to be less than a quarter turn; a noisy step in the opposite
    direction is one whose translation changed its sign.
    """
    true_steps, noisy_steps = se2.steps(true_poses), se2.steps(noisy_poses)
    direction, trans = directions(true_steps[:, 0], true_steps[:, 1])

    # Seen along the true direction, the noisy step points at the noise of rot1.
    cos, sin = np.cos(direction), np.sin(direction)
    sign = np.where(trans < 0.0, -1.0, 1.0)
    ahead = sign * (cos * noisy_steps[:, 0] + sin * noisy_steps[:, 1])
    aside = sign * (cos * noisy_steps[:, 1] - sin * noisy_steps[:, 0])
    noise1, length = directions(ahead, aside)
    noise1 = np.where(np.abs(trans) >= MIN_TRANSLATION, noise1, np.nan)
    noise2 = wrap(noisy_steps[:, 2] - true_steps[:, 2] - np.nan_to_num(noise1))
    noise = np.stack([noise1, sign * length - trans, noise2], axis=-1)
    return RecoveredNoise(decompose_steps(true_steps), noise)


def directions(dx, dy):
    """Return the line of travel (rad, in [-pi/2, pi/2]) and the signed length (m) along it."""
    sign = np.where(dx < 0.0, -1.0, 1.0)
    return np.arctan2(sign * dy, np.abs(dx)), sign * np.hypot(dx, dy)
