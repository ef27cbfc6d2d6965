r"""Mean and covariance of a noisy path without sampling: exact, to first order, and on SE(2).

Cartesian moments
-----------------

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

The covariance to first order is the sum of the textbooks' recursion F S F' + G Q G': noise of the
heading at pose m moves pose n by i (P_n - P_m) per radian.

Moments in exponential coordinates
----------------------------------
The cloud of end poses of noisy paths, bent like a banana, is nearly Gaussian in the coordinates of
`se2.logarithm`, of the noisy pose as seen from the perfect one (A. W. Long, K. C. Wolfe, M. J.
Mashner, G. S. Chirikjian: The banana distribution is Gaussian, Robotics: Science and Systems 2012).

With p the error of the position, H that of the heading, h the same within half a turn and
f(h) = (h/2) (cot(h/2) - i), the coordinates are v = f(h) p and h. As functions of H alone, f, |f|²,
f² and so on are turned into a Fourier series, f(H) = sum_c F_c exp(icH); what remains are

    M(c) = E p exp(icH),   S(c) = E |p|² exp(icH),   G(c) = E p² exp(icH),

and E v = sum_c F_c M(c), E |v|² = sum_c |F|²_c S(c), and so on. As H gains a rotation, each is
multiplied by exp(-c² w / 2), w its variance. With translation k, let w_k = d_k exp(i psi_k) and
phi(c) = E exp(icH) = exp(-c² V_k / 2); p becomes p + (w_k + et_k exp(i psi_k)) exp(iH) - w_k and

    M(c) += w_k (phi(c+1) - phi(c)),
    S(c) += 2 Re(conj(w_k) (M(c-1) - M(c)))
            + d_k² (2 phi(c) - phi(c+1) - phi(c-1)) + s_k² phi(c),
    G(c) += 2 w_k (M(c+1) - M(c))
            + w_k² (phi(c+2) - 2 phi(c+1) + phi(c)) + s_k² exp(2i psi_k) phi(c+2).

S leaves out what is odd in c, which the coefficients of |f|² do not see, as |f| is even in h.

The series need not have the period of a turn. If H is small, a period of `_SPAN` of its standard
deviations is enough, and so are `_HARMONICS`, as M, S and G fall as exp(-c² V / 2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from bullet_lab.core.se2 import straightening

_NO_VARIANCE = 1e-300
# Standard deviations of the heading; 1e-12 of all headings are beyond.
_SPAN = 14.0
# To either side; if the period is _SPAN, 7.2 standard deviations of c.
_HARMONICS = 16
# Of the integral for a coefficient, for up to 16 waves.
_NODES = 128
# rad²; below it, first order is right to rounding.
_LEAST_VARIANCE = 1e-12


@dataclass(frozen=True, eq=False)
class NoisySteps:
    """The steps of a perfect path of n + 1 poses, with their variances under a rule.

    Attributes:
        position: x + iy (m) of each pose, relative to the first one but not rotated, shape (n+1,).
        direction: exp(i psi), psi the direction of travel of each step in the odometry frame,
            the opposite of it if the robot drives backwards, shape (n,).
        angle: psi (rad), shape (n,).
        trans: m, signed, shape (n,).
        variance1: rad², of the rotation before each translation, shape (n,).
        variance_trans: m², of each translation, shape (n,).
        variance2: rad², of the rotation after each translation, shape (n,).
    """

    position: ndarray
    direction: ndarray
    angle: ndarray
    trans: ndarray
    variance1: ndarray
    variance_trans: ndarray
    variance2: ndarray

    def __len__(self) -> int:
        return len(self.trans)


@dataclass(frozen=True, eq=False)
class Moments:
    """Mean and covariance of the pose error, noisy minus perfect, at each pose of a path.

    Attributes:
        mean: of the errors of x (m), y (m) and heading (rad, not wrapped), shape (n+1, 3).
        covariance: shape (n+1, 3, 3), in the odometry frame.
    """

    mean: ndarray
    covariance: ndarray

    def rms_distance(self) -> ndarray:
        """Return the root mean square distance (m) from the perfect position, shape (n+1,)."""
        bias = np.sum(np.square(self.mean[:, :2]), axis=1)
        spread = self.covariance[:, 0, 0] + self.covariance[:, 1, 1]
        return np.sqrt(bias + np.maximum(spread, 0.0))

    def about_perfect(self) -> ndarray:
        """Return E(e e') of the errors, shape (n+1, 3, 3): the covariance of `NoisyPath`."""
        return self.covariance + self.mean[:, :, None] * self.mean[:, None, :]


def exact_moments(steps: NoisySteps) -> Moments:
    """Return the moments for independent Gaussian noise; the module docstring derives them.

    >>> from bullet_lab.noise.noisy_paths import noisy_steps
    >>> from bullet_lab.noise.odometry_noise import ProbabilisticRule
    >>> rule = ProbabilisticRule(0.0, 0.0, 0.25, 0.0)
    >>> line = noisy_steps([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], rule)
    >>> exact_moments(line).covariance[-1].diagonal()
    array([0.25, 0.  , 0.  ])
    """
    d, s2, unit = steps.trans, steps.variance_trans, steps.direction
    turned, v = steps.variance1 + steps.variance2, _acting_variances(steps)
    step, faded = d * unit, np.exp(-0.5 * v)
    lost = np.expm1(-v)

    earlier = _fading_sum(-step.conj() * lost, np.exp(-0.5 * np.diff(v)))
    c = s2 - d * d * lost + 2.0 * (step * earlier).real
    earlier = _sums(step * faded * lost)[:-1]
    g = unit * unit * (s2 * np.exp(-2.0 * v) + d * d * np.exp(-v) * lost)
    g += 2.0 * step * faded * earlier
    heading = 1j * v * step * faded

    # The mean of P minus the perfect P, without subtracting numbers that are nearly equal.
    shift = step * np.expm1(-0.5 * v)
    mean = _sums(shift)
    return Moments(
        np.column_stack([mean.real, mean.imag, np.zeros(len(mean))]),
        _covariance(*map(_sums, (c, g, heading, turned))),
    )


def _fading_sum(terms: ndarray, factors: ndarray) -> ndarray:
    """Return r with r[0] = 0 and r[k+1] = (r[k] + terms[k]) factors[k], shape of the terms."""
    # The closed form would divide by products of factors, which may be zero to rounding.
    result = [0j]
    for term, factor in zip(terms.tolist(), factors.tolist()):
        result.append((result[-1] + term) * factor)
    return np.array(result)


def first_order_moments(steps: NoisySteps) -> Moments:
    """Return the moments to first order: no bias, and the covariance along the perfect path."""
    end, before, after = steps.position, steps.position[:-1], steps.position[1:]
    a, b = steps.variance1, steps.variance2
    turned = _sums(a + b)
    first = _sums(a * before + b * after)
    second = _sums(a * before**2 + b * after**2)
    square = _sums(a * np.abs(before) ** 2 + b * np.abs(after) ** 2)
    c = np.abs(end) ** 2 * turned - 2.0 * (end.conj() * first).real + square
    c += _sums(steps.variance_trans)
    levers = end * end * turned - 2.0 * end * first + second
    g = _sums(steps.variance_trans * steps.direction**2) - levers
    covariance = _covariance(c, g, 1j * (end * turned - first), turned)
    return Moments(np.zeros((len(covariance), 3)), covariance)


def quadratic_covariances(steps: NoisySteps) -> ndarray:
    """Return the covariance of what is quadratic in the noise, at each pose.

    To second order, the error of translation k is

        exp(i psi_k) (et_k + i d_k H_k + i et_k H_k - d_k H_k² / 2).

    The first two terms are linear, and Gaussian. For the others, with j < k,

        Cov(H_j², H_k²) = 2 V_j²,    Var(et_k H_k) = s_k² V_k,

    and all else is uncorrelated. The result is that of the errors of x (m), y (m) and heading
    (rad), shape (n+1, 3, 3); 0 for the heading.
    """
    s2, unit = steps.variance_trans, steps.direction
    v = _acting_variances(steps)
    step = steps.trans * unit
    bent = step * v * v
    before = _sums(bent)[:-1]
    c = s2 * v + 0.5 * (bent * step.conj()).real + (step * before.conj()).real
    g = -s2 * v * unit * unit + 0.5 * bent * step + step * before
    g = _sums(g)
    return _covariance(_sums(c), g, 0.0 * g, 0.0)


def quadratic_shares(quadratic, covariance) -> ndarray:
    """Return the largest u' Q u / u' C u over all directions u of (x, y, heading), 0 without noise.

    Q are `quadratic_covariances` at some poses, and C the exact ones there, both (..., 3, 3). It is
    0 for a Gaussian error, and about 1 for one that is bent like a banana.

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
    # The pseudo-inverse gives a share of 0 to directions without variance.
    inverse = np.linalg.pinv(covariance / size, rcond=1e-12, hermitian=True)
    return np.linalg.eigvals((quadratic / size) @ inverse).real.max(axis=-1)


class RunningMoments:
    """Accumulates the exact second moments of a noisy path's error, pose by pose.

    They are the sums of `exact_moments`.

    >>> moments = RunningMoments()
    >>> moments.add(0.0, 1.0, (0.0, 0.25, 0.5))
    >>> moments.second_moments().diagonal()
    array([0.25, 0.  , 0.5 ])
    """

    def __init__(self) -> None:
        # Variance of the heading, and its value at the latest translation.
        self._turned = 0.0
        self._acted = 0.0
        self._mean = 0j
        self._spread = 0.0
        self._pseudo = 0j
        self._with_heading = 0j
        # Correlation of the translations so far with the next one, and with its conjugate.
        self._shared = 0j
        self._mirrored = 0j

    def add(self, direction: float, trans: float, variances: tuple[float, float, float]) -> None:
        """Add the next step of the perfect path.

        Args:
            direction: rad, of travel, in the frame of the path.
            trans: m, signed.
            variances: of the rotation before it (rad²), of trans (m²) and of that after it (rad²).
        """
        variance1, variance_trans, variance2 = variances
        v = self._turned + variance1
        unit = complex(math.cos(direction), math.sin(direction))
        step, square = trans * unit, trans * trans
        faded, lost = math.exp(-0.5 * v), math.expm1(-v)

        self._shared *= math.exp(-0.5 * (v - self._acted))
        self._spread += variance_trans - square * lost + 2.0 * (step * self._shared).real
        own = variance_trans * faded**4 + square * faded**2 * lost
        self._pseudo += unit * unit * own + 2.0 * step * faded * self._mirrored
        self._with_heading += 1j * v * faded * step
        self._mean += step * math.expm1(-0.5 * v)
        self._shared -= step.conjugate() * lost
        self._mirrored += step * faded * lost
        self._acted, self._turned = v, v + variance2

    def second_moments(self) -> ndarray:
        """Return E(e e') of the error e = noisy - perfect, (x, y, yaw), shape (3, 3), read-only.

        It is about the perfect pose, not about the mean of the noisy ones: covariance plus the
        square of the bias. Units are m and rad, the frame is that of the directions.
        """
        size = self._spread + abs(self._mean) ** 2
        pseudo = self._pseudo + self._mean * self._mean
        # Several times as fast as `_covariance`, for numbers.
        xx, yy, xy = 0.5 * (size + pseudo.real), 0.5 * (size - pseudo.real), 0.5 * pseudo.imag
        xt, yt = self._with_heading.real, self._with_heading.imag
        matrix = np.array(((xx, xy, xt), (xy, yy, yt), (xt, yt, self._turned)))
        matrix.setflags(write=False)
        return matrix


def exponential_moments(steps: NoisySteps, at) -> Moments:
    """Return mean and covariance of the error in exponential coordinates, at some poses.

    They are those of the `logarithm` of (x, y, heading), noisy minus perfect, in m and rad, along
    the axes of the odometry frame, at the poses of the indices `at`, in increasing order, (k,).

    >>> from bullet_lab.noise.noisy_paths import noisy_steps
    >>> from bullet_lab.noise.odometry_noise import RateInvariantRule
    >>> line = [(0.5 * k, 0.0, 0.0) for k in range(81)]
    >>> steps = noisy_steps(line, RateInvariantRule(0.1))
    >>> exponential_moments(steps, [80]).covariance[0].diagonal().round(2)
    array([  5.89, 210.  ,   0.4 ])
    >>> first_order_moments(steps).covariance[-1].diagonal().round(2)
    array([  0.4 , 213.35,   0.4 ])
    """
    at = np.asarray(at, dtype=int)
    first = first_order_moments(steps)
    mean, covariance = first.mean[at], first.covariance[at]
    variance = covariance[:, 2, 2]
    known = variance > _LEAST_VARIANCE
    if known.any():
        period = np.minimum(math.tau, _SPAN * np.sqrt(variance[known]))
        c = math.tau / period[:, None] * np.arange(-_HARMONICS, _HARMONICS + 1)
        harmonics = _harmonics(steps, at[known], c)
        mean[known], covariance[known] = _moments(period, c, variance[known], *harmonics)
    return Moments(mean, covariance)


def _harmonics(steps: NoisySteps, at: ndarray, c: ndarray):
    """Return M, S and G for each pose and its c, shape (k, 33); see the module docstring."""
    shifted = c + np.array([-1.0, 0.0, 1.0, 2.0])[:, None, None]
    rates = -0.5 * shifted * shifted
    phi = np.ones(shifted.shape)
    m, g = (np.zeros(shape, dtype=complex) for shape in (phi[:3].shape, c.shape))
    s = np.zeros(c.shape)
    found = np.empty((3, *c.shape), dtype=complex)
    turned = np.concatenate([[0.0], steps.variance2[:-1]]) + steps.variance1
    columns = (turned, steps.trans * steps.direction, steps.variance_trans, steps.direction**2)
    rows = zip(*(column.tolist() for column in columns))
    for pose, (turn, step, s2, twice) in enumerate(rows, start=1):
        if turn:
            decay = np.exp(turn * rates)
            phi *= decay
            m *= decay[:3]
            s *= decay[1]
            g *= decay[1]
        if step or s2:
            s += 2.0 * (step.conjugate() * (m[0] - m[1])).real
            s += abs(step) ** 2 * (2.0 * phi[1] - phi[0] - phi[2]) + s2 * phi[1]
            g += 2.0 * step * (m[2] - m[1]) + s2 * twice * phi[3]
            g += step * step * (phi[3] - 2.0 * phi[2] + phi[1])
            m += step * (phi[1:] - phi[:3])
        for row in np.flatnonzero(at == pose):
            found[:, row] = np.stack([m[1, row], s[row], g[row]])
    last = np.exp(steps.variance2[at - 1][:, None] * rates[1])
    return found * last


def _moments(period, c, variance, m, s, g):
    """Return mean and covariance of (v, h) from M, S and G, their c and its period."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    h = 0.5 * period[:, None] * nodes
    waves = np.exp(-1j * c[:, :, None] * h[:, None, :]) * (0.5 * weights)
    straight = straightening(h)

    def mean_of(function: ndarray, harmonics: ndarray) -> ndarray:
        return np.einsum("kcn,kn,kc->k", waves, function, harmonics, optimize=True)

    v = mean_of(straight, m)
    size = mean_of(np.abs(straight) ** 2, s).real - np.abs(v) ** 2
    pseudo = mean_of(straight**2, g) - v * v
    cross = mean_of(h * straight, m)
    turned = mean_of(h * h, np.exp(-0.5 * c * c * variance[:, None])).real
    mean = np.column_stack([v.real, v.imag, np.zeros(len(v))])
    return mean, _covariance(size, pseudo, cross, turned)


def _acting_variances(steps: NoisySteps) -> ndarray:
    """Return V_k, the variance (rad²) of the heading along which each translation is made."""
    return np.cumsum(steps.variance1 + steps.variance2) - steps.variance2


def _covariance(c, g, heading, turned) -> ndarray:
    """Return 3x3 covariances from C, G, the covariance of P and heading, and that of heading."""
    result = np.empty((*np.shape(c), 3, 3))
    result[..., 0, 0] = 0.5 * (c + g.real)
    result[..., 1, 1] = 0.5 * (c - g.real)
    result[..., 0, 1] = result[..., 1, 0] = 0.5 * g.imag
    result[..., 0, 2] = result[..., 2, 0] = heading.real
    result[..., 1, 2] = result[..., 2, 1] = heading.imag
    result[..., 2, 2] = turned
    return result


def _sums(terms: ndarray) -> ndarray:
    """Return the sums of the terms before each pose, 0 for the first, shape (n+1,)."""
    return np.concatenate([np.zeros(1, dtype=terms.dtype), np.cumsum(terms)])
