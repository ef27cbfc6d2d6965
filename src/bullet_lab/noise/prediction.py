"""How well parameters that were fitted to some steps predict where others end.

For each window of the truth's path, systematic errors give the pose that the odometry should report
at its end, and the noise the second moments of the difference. With the variances V of the
parameters and the slopes J of the end,

    M = dispersion (moments of the noise + J `OWN` V J').

The dispersion is that for which 95 % of the ends are within their regions (more of few ends, as in
conformal prediction: of n windows the share 0.95 (1 + 1/n)), for the length for which it is
largest: errors of a few metres are often larger than steps show, as they are neither independent
nor Gaussian. docs/jobs/calibrate.md has the rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence, Tuple

import numpy as np
from numpy import ndarray
from scipy.stats import chi2

from bullet_lab.core import se2
from bullet_lab.core.se2 import LEVEL
from bullet_lab.noise.calibration import Fit, covariance
from bullet_lab.noise.exact_moments import exact_moments
from bullet_lab.noise.likelihood import StepPairs
from bullet_lab.noise.noisy_paths import noisy_steps

LENGTHS = (1.0, 5.0, 20.0)
"""m, of windows."""

INSIDE = float(chi2.ppf(LEVEL, 3))
"""Square of a whitened error of the pose at the border of the region of 95 %."""

OWN = 2.0
"""Factor of the covariance of fitted parameters: the path that is predicted has its own errors."""

FEWEST = 6
"""Windows of a length that count."""

# Windows begin at each quarter of their length, as there are few of the long ones.
_OVERLAP = 4
_DIFFERENCE = 1e-5


@dataclass(frozen=True, eq=False)
class Windows:
    """Ends of windows of one length, predicted and reported, for w windows and s errors.

    Attributes:
        length: m.
        error: reported minus predicted end (m, m, rad) in the frame of the start, (w, 3).
        moments: of the noise and of uncertain parameters, M without the dispersion, (w, 3, 3).
        apart: whether the window does not overlap the one before it that is, (w,).
    """

    length: float
    error: ndarray
    moments: ndarray
    apart: ndarray

    def __len__(self) -> int:
        return len(self.error)

    def squares(self, dispersion: float = 1.0):
        """Return whitened squares, (w,), and logarithms of the density, (w,)."""
        moments = dispersion * self.moments
        solved = np.linalg.solve(moments, self.error[..., np.newaxis])[..., 0]
        squares = np.einsum("wi,wi->w", self.error, solved)
        size = np.linalg.slogdet(2.0 * np.pi * moments)[1]
        return squares, -0.5 * (squares + size)


@dataclass(frozen=True)
class Score:
    """How windows of one length were predicted.

    Attributes:
        length: m.
        windows: number of those that do not overlap.
        density: mean logarithm of the density at the ends, of all windows.
        held: share of the ends within the region of 95 %, of all windows.
    """

    length: float
    windows: int
    density: float
    held: float


@dataclass(frozen=True, eq=False)
class Prediction:
    """How well a model predicts each half of the steps by a fit of the other.

    Attributes:
        dispersion: factor of all variances, >= 1.
        scores: of each length of which there are enough windows.
    """

    dispersion: float
    scores: Tuple[Score, ...]

    @property
    def density(self) -> float:
        """Sum of the mean logarithms of all lengths: the more, the better."""
        return sum(score.density for score in self.scores)


def judged(found: Sequence[Windows]) -> Prediction:
    """Return the dispersion and the scores of windows."""
    lengths = sorted({one.length for one in found})
    groups = [[one for one in found if one.length == length] for length in lengths]
    groups = [group for group in groups if sum(map(len, group)) >= FEWEST]
    dispersion = 1.0
    for group in groups:
        squares = np.concatenate([one.squares()[0] for one in group])
        # With few windows the next one is more often beyond their quantile than 1 - LEVEL.
        level = min(1.0, LEVEL * (1.0 + 1.0 / _number_apart(group)))
        dispersion = max(dispersion, float(np.quantile(squares, level)) / INSIDE)
    return Prediction(dispersion, tuple(_score(group, dispersion) for group in groups))


def _number_apart(group: Sequence[Windows]) -> int:
    return sum(int(one.apart.sum()) for one in group)


def _score(group: Sequence[Windows], dispersion: float) -> Score:
    both = zip(*(one.squares(dispersion) for one in group))
    squares, densities = map(np.concatenate, both)
    held = float(np.mean(squares <= INSIDE))
    return Score(group[0].length, _number_apart(group), float(densities.mean()), held)


def predicted(found: Fit, pairs: StepPairs, follows: ndarray, length: float) -> Windows:
    """Predict windows of other steps by a fit.

    Args:
        found: fit of one odometry.
        pairs: short steps to predict, one odometry.
        follows: whether each begins where the one before it ended, (n,).
        length: of the windows, m of the truth.
    """
    problem, rule = found.problem, found.rule()
    moved = _DIFFERENCE * np.eye(len(problem.names))[~problem.logarithmic]
    values = found.estimates + np.vstack((np.zeros(len(problem.names)), moved))
    begins, ends = windows(pairs.true, follows, length)
    reported = path_of(pairs.odometry[0])
    paths = [path_of(steps) for steps in problem.errors(values, 1).steps(pairs.true)]
    expected, *others = (se2.between(path[begins], path[ends]) for path in paths)
    changes = [se2.between(expected, other) for other in others]
    slopes = _slopes(changes, expected)
    noise = [
        exact_moments(noisy_steps(paths[0][begin : end + 1], rule)).about_perfect()[-1]
        for begin, end in zip(begins, ends)
    ]
    noise = _turned(np.array(noise).reshape(-1, 3, 3), -paths[0][begins, 2])
    noise += np.diag(pairs.floor + 1e-12)
    spread = OWN * (slopes * parameter_variances(found)) @ slopes.swapaxes(1, 2)
    error = se2.wrapped(se2.between(reported[begins], reported[ends]) - expected)
    return Windows(length, error, noise + spread, _apart(begins, ends))


def parameter_variances(found: Fit) -> ndarray:
    """Return the variances of the systematic errors by the information of a fit, (s,)."""
    problem = found.problem
    inverse, scale = covariance(found.information)
    units = problem.values(np.ones((1, len(problem.names))))[0]
    variances = np.diagonal(inverse[0]) * np.square(units / scale[0])
    return variances[~problem.logarithmic]


def windows(true: ndarray, follows: ndarray, length: float):
    """Return indices of the poses at begin and end of windows, which go over no gap, (w,), (w,).

    Args:
        true: steps (dx m, dy m, dyaw rad), (n, 3).
        follows: whether each begins where the one before it ended, (n,).
        length: m.
    """
    way = np.concatenate(([0.0], np.cumsum(np.hypot(true[:, 0], true[:, 1]))))
    stretch = np.concatenate(([0], np.cumsum(~np.asarray(follows))))
    begins = np.searchsorted(way, np.arange(0.0, way[-1] - length, length / _OVERLAP))
    ends = np.searchsorted(way, way[begins] + length)
    whole = ends < len(way)
    begins, ends = begins[whole], ends[whole]
    # Step k ends at pose k + 1.
    whole = stretch[ends] == stretch[begins + 1]
    return begins[whole], ends[whole]


def _apart(begins: ndarray, ends: ndarray) -> ndarray:
    last, apart = -1, np.zeros(len(begins), dtype=bool)
    for index, (begin, end) in enumerate(zip(begins, ends)):
        if begin >= last:
            apart[index], last = True, end
    return apart


def path_of(steps: ndarray) -> ndarray:
    """Return the poses that steps lead to, the start included: (n, 3) to (n + 1, 3)."""
    heading = np.concatenate(([0.0], np.cumsum(steps[:, 2])))
    moves = (steps[:, 0] + 1j * steps[:, 1]) * np.exp(1j * heading[:-1])
    places = np.concatenate(([0j], np.cumsum(moves)))
    return np.column_stack((places.real, places.imag, se2.wrap(heading)))


def _slopes(moved: Sequence[ndarray], expected: ndarray) -> ndarray:
    """Return slopes (w, 3, s) from the changes of ends as seen from the expected ones."""
    if not moved:
        return np.zeros((*expected.shape, 0))
    return _rotations(expected[:, 2]) @ np.stack(moved, axis=-1) / _DIFFERENCE


def _rotations(angles: ndarray) -> ndarray:
    matrices = np.zeros((len(angles), 3, 3))
    matrices[:, 0, 0] = matrices[:, 1, 1] = np.cos(angles)
    matrices[:, 1, 0] = np.sin(angles)
    matrices[:, 0, 1] = -matrices[:, 1, 0]
    matrices[:, 2, 2] = 1.0
    return matrices


def _turned(matrices: ndarray, angles: ndarray) -> ndarray:
    rotations = _rotations(angles)
    return rotations @ matrices @ rotations.swapaxes(1, 2)
