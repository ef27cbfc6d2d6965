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

The covariance to first order is what the recursion F S F' + G Q G' of textbooks adds up to: noise
of the heading at pose m moves pose n by i (P_n - P_m) per radian.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bullet_lab.noise.noisy_paths import NoisySteps

_NO_VARIANCE = 1e-300


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

    def about_perfect(self) -> np.ndarray:
        """Return E(e e') of the errors themselves, shape (n+1, 3, 3): `NoisyPath` publishes it."""
        return self.covariance + self.mean[:, :, None] * self.mean[:, None, :]


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
    turned, v = steps.variance1 + steps.variance2, _acting_variances(steps)
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
    end, before, after = steps.position, steps.position[:-1], steps.position[1:]
    a, b = steps.variance1, steps.variance2
    sums = (
        a + b,
        a * before + b * after,
        a * before**2 + b * after**2,
        a * np.abs(before) ** 2 + b * np.abs(after) ** 2,
        steps.variance_trans,
        steps.variance_trans * steps.direction**2,
    )
    turned, first, second, square, driven, along = (_from_zero(np.cumsum(t)) for t in sums)
    levers = end * end * turned - 2.0 * end * first + second
    square_levers = np.abs(end) ** 2 * turned - 2.0 * (end.conj() * first).real + square
    covariance = _covariance(
        square_levers + driven, along - levers, 1j * (end * turned - first), turned
    )
    return Moments(np.zeros((len(covariance), 3)), covariance)


def quadratic_covariances(steps: NoisySteps) -> np.ndarray:
    """Return the covariance of what is quadratic in the noise, at each pose.

    To second order, translation k errs by

        exp(i psi_k) (et_k + i d_k H_k + i et_k H_k - d_k H_k² / 2).

    The first two terms are linear, and Gaussian. For the others, with j < k,

        Cov(H_j², H_k²) = 2 V_j²,    Var(et_k H_k) = s_k² V_k,

    and all else is uncorrelated. Where their share of the exact covariance is small in each
    direction, the error is nearly Gaussian; see `quadratic_shares`.

    Returns:
        Of the errors of x (m), y (m) and heading (rad), shape (n+1, 3, 3); the heading has none.
    """
    s2, unit = steps.variance_trans, steps.direction
    v = _acting_variances(steps)
    way = steps.trans * unit
    bent = way * v * v
    before = _from_zero(np.cumsum(bent))[:-1]
    c = s2 * v + 0.5 * (bent * way.conj()).real + (way * before.conj()).real
    g = -s2 * v * unit * unit + 0.5 * bent * way + way * before
    c, g = (_from_zero(np.cumsum(terms)) for terms in (c, g))
    return _covariance(c, g, 0.0 * g, 0.0)


def quadratic_shares(quadratic, covariance) -> np.ndarray:
    """Return which share of the variance is quadratic in the noise, where that is largest.

    It is the largest of u' Q u / u' C u over all directions u of (x, y, heading): 0 for an error
    that is Gaussian, and some 1 for a banana.

    Args:
        quadratic: Q, `quadratic_covariances` at some poses, shape (..., 3, 3).
        covariance: C, the exact ones there, of the same shape.

    Returns:
        Shape (...); 0 where there is no noise.

    >>> from bullet_lab.noise.noisy_paths import noisy_steps
    >>> from bullet_lab.noise.odometry_noise import RateInvariantRule
    >>> line = [(0.1 * k, 0.0, 0.0) for k in range(41)]
    >>> for std in (0.05, 0.1, 0.3):
    ...     steps = noisy_steps(line, RateInvariantRule(std))
    ...     quadratic, exact = quadratic_covariances(steps)[-1], exact_moments(steps).covariance[-1]
    ...     print(f"{quadratic_shares(quadratic, exact):.3f}")
    0.013
    0.052
    0.390
    """
    scale = np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), _NO_VARIANCE))
    size = scale[..., :, None] * scale[..., None, :]
    # What has no variance at all has no share in it.
    inverse = np.linalg.pinv(covariance / size, rcond=1e-12, hermitian=True)
    return np.linalg.eigvals((quadratic / size) @ inverse).real.max(axis=-1)


def _acting_variances(steps: NoisySteps) -> np.ndarray:
    """Return V_k, the variance (rad²) of the heading along which each translation is made."""
    return np.cumsum(steps.variance1 + steps.variance2) - steps.variance2


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
