"""Files of pairs of paths, and noise rules by name."""

import numpy as np

from bullet_lab.core.trajectory import CSV_HEADER, Trajectory
from bullet_lab.noise.odometry_noise import named_alphas, rule_of


def make_rule(model, std, alphas=()):
    """Return the noise rule of a model from its parameters in order."""
    return rule_of(model, {"std": std, **named_alphas(model, alphas)})


def read_paths_csv(path):
    """Return the perfect and the noisy path of a file such as paths.csv."""
    assert path.read_text().startswith(f"{CSV_HEADER}\n")
    table = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    return Trajectory(table[:, 0], table[:, 1:4]), Trajectory(table[:, 0], table[:, 4:])
