r"""Mean and covariance of a noisy path without drawing one: exactly, and to first order.

For independent Gaussian noise, P = x + iy, step k of signed length d_k along psi_k, noise e1_k,
et_k and e2_k of variances a_k, s_k² and b_k. Translation k is laid along psi_k + H_k, where

    H_k = sum_{j<k} (e1_j + e2_j) + e1_k,    V_k = Var H_k = sum_{j<k} (a_j + b_j) + a_k:

the first rotation of a step bends that step's own translation, the second only later ones. With
T_k = (d_k + et_k) exp(i (psi_k + H_k)) the end is P_0 + sum T_k. All follows from the
characteristic function of a Gaussian, E exp(i c H) = exp(-c² Var H / 2), and from the fact that
for j < k the increment H_k - H_j is independent of H_j and has the variance V_k - V_j:

    E T_k           = d_k exp(i psi_k - V_k / 2)
    E conj(T_j) T_k = d_j d_k exp(i (psi_k - psi_j)) exp(-(V_k - V_j) / 2)
    E T_j T_k       = d_j d_k exp(i (psi_j + psi_k)) exp(-2 V_j - (V_k - V_j) / 2)
    E |T_k|²        = d_k² + s_k²
    E T_k²          = (d_k² + s_k²) exp(2i psi_k - 2 V_k)
    E T_k H_n       = i V_k d_k exp(i psi_k - V_k / 2)

(the last, for the heading error H_n of any pose n >= k, since E H exp(iH) = i V exp(-V / 2)).
Taking the products of the means away *before* summing leaves a factor expm1(-V_j) in each
covariance, so that nothing is lost to rounding where the noise is small:

    Cov(conj T_j, T_k) = -d_j d_k exp(i (psi_k - psi_j)) exp(-(V_k - V_j) / 2) expm1(-V_j)
    Cov(T_j, T_k)      =  d_j d_k exp(i (psi_j + psi_k)) exp(-(V_k + V_j) / 2) expm1(-V_j)
    Var T_k            =  s_k² - d_k² expm1(-V_k)
    PseudoVar T_k      =  exp(2i psi_k) (s_k² exp(-2 V_k) + d_k² exp(-V_k) expm1(-V_k))

With C = E |P - E P|² and G = E (P - E P)²: Var x, Var y = (C ± Re G) / 2, Cov(x, y) = Im G / 2.
The inner sums over j < k are running sums, so all poses of a path take O(n).

The covariance to first order is what the recursion F S F' + G Q G' of `NoisyPath` adds up to:
noise of the heading at pose m moves pose n by i (P_n - P_m) per radian.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bullet_lab.noise.noisy_paths import NoisyBlock, NoisySteps


@dataclass(frozen=True, eq=False)
class Moments:
    """Mean and covariance of the pose error, noisy minus perfect, at each pose of a path.

    Attributes:
        mean: of the errors of x (m), y (m) and heading (rad, not wrapped), shape (n+1, 3).
        covariance: shape (n+1, 3, 3), in the odometry frame.
    """

    mean: np.ndarray
    covariance: np.ndarray

    def rms_distance(self) -> np.ndarray:
        """Return the root mean square distance (m) from the perfect position, shape (n+1,)."""
        bias = np.sum(np.square(self.mean[:, :2]), axis=1)
        spread = self.covariance[:, 0, 0] + self.covariance[:, 1, 1]
        return np.sqrt(bias + np.maximum(spread, 0.0))


def exact_moments(steps: NoisySteps) -> Moments:
    """Return the moments for independent Gaussian noise; see the head of this module.

    >>> from bullet_lab.noise.noisy_paths import noisy_steps
    >>> from bullet_lab.noise.odometry_noise import ProbabilisticRule
    >>> rule = ProbabilisticRule(0.0, 0.0, 0.25, 0.0)
    >>> line = noisy_steps([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], rule)
    >>> exact_moments(line).covariance[-1].diagonal()
    array([0.25, 0.  , 0.  ])
    """
    d, s2, unit = steps.trans, steps.variance_trans, steps.direction
    turned = steps.variance1 + steps.variance2
    v = np.cumsum(turned) - steps.variance2
    way, faded = d * unit, np.exp(-0.5 * v)
    lost = np.expm1(-v)

    earlier = _fading_sum(-way.conj() * lost, np.exp(-0.5 * np.diff(v)))
    c = s2 - d * d * lost + 2.0 * (way * earlier).real
    earlier = _from_zero(np.cumsum(way * faded * lost))[:-1]
    g = unit * unit * (s2 * np.exp(-2.0 * v) + d * d * np.exp(-v) * lost)
    g += 2.0 * way * faded * earlier
    heading = 1j * v * way * faded

    # The mean of P less the perfect P, again without subtracting what is nearly the same.
    shift = way * np.expm1(-0.5 * v)
    mean = _from_zero(np.cumsum(shift))
    return Moments(
        np.column_stack([mean.real, mean.imag, np.zeros(len(mean))]),
        _covariance(*(_from_zero(np.cumsum(terms)) for terms in (c, g, heading, turned))),
    )


def _fading_sum(terms: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Return r with r[0] = 0 and r[k+1] = (r[k] + terms[k]) factors[k], shape of the terms.

    The closed form would divide by products of factors, which may be zero to rounding.
    """
    result, value = [0j], 0j
    for term, factor in zip(terms[:-1].tolist(), factors.tolist()):
        value = (value + term) * factor
        result.append(value)
    return np.array(result)


def first_order_moments(steps: NoisySteps) -> Moments:
    """Return the moments to first order: no bias, and the covariance along the perfect path."""
    before, after = steps.position[:-1], steps.position[1:]
    a, b = steps.variance1, steps.variance2
    sums = (
        a + b,
        a * before + b * after,
        a * before**2 + b * after**2,
        a * np.abs(before) ** 2 + b * np.abs(after) ** 2,
        steps.variance_trans,
        steps.variance_trans * steps.direction**2,
    )
    sums = [_from_zero(np.cumsum(terms)) for terms in sums]
    covariance = _first_order(steps.position, *sums)
    return Moments(np.zeros((len(covariance), 3)), covariance)


def published_covariances(steps: NoisySteps, block: NoisyBlock) -> np.ndarray:
    """Return the covariance that `NoisyPath` gives with the last pose of each path of a block.

    It follows the noisy path, the only one that a robot knows, not the perfect one.

    Returns:
        Of (x, y, yaw) in the odometry frame, shape (b, 3, 3).
    """
    weights = np.zeros(len(steps) + 1)
    weights[:-1] += steps.variance1
    weights[1:] += steps.variance2
    position = block.position
    # einsum would do as well; products with a vector of the same type are some times as fast.
    complex_weights = weights.astype(complex)
    along = steps.variance_trans.astype(complex)
    return _first_order(
        position[:, -1],
        weights.sum(),
        position @ complex_weights,
        np.square(position) @ complex_weights,
        np.square(position.real) @ weights + np.square(position.imag) @ weights,
        steps.variance_trans.sum(),
        np.square(block.direction) @ along,
    )


def _first_order(end, turned, first, second, square, driven, along) -> np.ndarray:
    """Return covariances from sums over the noise of the headings and of the translations.

    Args:
        end: P of the pose in question.
        turned: sum of the variances w of the heading.
        first: sum of w P, P where each of them acts.
        second: sum of w P².
        square: sum of w |P|².
        driven: sum of the variances of the translations.
        along: sum of them times exp(2i psi).
    """
    levers = end * end * turned - 2.0 * end * first + second
    square_levers = np.abs(end) ** 2 * turned - 2.0 * (end.conj() * first).real + square
    return _covariance(square_levers + driven, along - levers, 1j * (end * turned - first), turned)


def _covariance(c, g, heading, turned) -> np.ndarray:
    """Return 3x3 covariances from C, G, the covariance of P and heading, and that of heading."""
    result = np.empty((*np.shape(c), 3, 3))
    result[..., 0, 0] = 0.5 * (c + g.real)
    result[..., 1, 1] = 0.5 * (c - g.real)
    result[..., 0, 1] = result[..., 1, 0] = 0.5 * g.imag
    result[..., 0, 2] = result[..., 2, 0] = heading.real
    result[..., 1, 2] = result[..., 2, 1] = heading.imag
    result[..., 2, 2] = turned
    return result


def _from_zero(sums: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros(1, dtype=sums.dtype), sums])
