r"""The Gaussian in exponential coordinates of SE(2) that a noisy path's error is closest to.

The cloud of a noisy path's ends is bent like a banana. In the coordinates of `se2.logarithm`, of
the noisy pose as seen from the perfect one, it is nearly straight again (A. W. Long, K. C. Wolfe,
M. J. Mashner, G. S. Chirikjian: The banana distribution is Gaussian, Robotics: Science and
Systems, 2012). To first order their covariance is that of (x, y, heading): both axes and levers
are the same. Far from the start that is not enough, so here mean and covariance are exact.

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

The series need not have the period of a turn: where H is small, a period of `_SPAN` of its
deviations will do, so that `_HARMONICS` are always enough, as M, S and G fall as exp(-c² V / 2).
"""

from __future__ import annotations

import math

import numpy as np

from bullet_lab.core.se2 import straightening
from bullet_lab.noise.exact_moments import Moments, first_order_moments
from bullet_lab.noise.noisy_paths import NoisySteps

_SPAN = 14.0  # standard deviations of the heading; 1e-12 of all headings are beyond
_HARMONICS = 16  # to either side; where the period is _SPAN, 7.2 standard deviations of c
_NODES = 128  # of the integral for a coefficient, for up to 16 waves
_LEAST_VARIANCE = 1e-12  # rad²; below, first order is right to rounding


def exponential_moments(steps: NoisySteps, at) -> Moments:
    """Return mean and covariance of the error in exponential coordinates, at some poses.

    Args:
        steps: of the perfect path.
        at: indices of the poses, in increasing order, shape (k,).

    Returns:
        Of the `logarithm` of (x, y, heading), noisy minus perfect, in m and rad, along the axes of
        the odometry frame: mean (k, 3), covariance (k, 3, 3).

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


def _harmonics(steps: NoisySteps, at: np.ndarray, c: np.ndarray):
    """Return M, S and G for each pose and its c, shape (k, 33); see the head of this module."""
    shifted = c + np.array([-1.0, 0.0, 1.0, 2.0])[:, None, None]
    rates = -0.5 * shifted * shifted
    phi = np.ones(shifted.shape)
    m, g = (np.zeros(shape, dtype=complex) for shape in (phi[:3].shape, c.shape))
    s = np.zeros(c.shape)
    found = np.empty((3, *c.shape), dtype=complex)
    turned = np.concatenate([[0.0], steps.variance2[:-1]]) + steps.variance1
    columns = (turned, steps.trans * steps.direction, steps.variance_trans, steps.direction**2)
    poses = np.arange(1, len(steps) + 1)
    for pose, turn, way, s2, twice in zip(poses, *(column.tolist() for column in columns)):
        if turn:
            decay = np.exp(turn * rates)
            phi *= decay
            m *= decay[:3]
            s *= decay[1]
            g *= decay[1]
        if way or s2:
            s += 2.0 * (way.conjugate() * (m[0] - m[1])).real
            s += abs(way) ** 2 * (2.0 * phi[1] - phi[0] - phi[2]) + s2 * phi[1]
            g += 2.0 * way * (m[2] - m[1]) + s2 * twice * phi[3]
            g += way * way * (phi[3] - 2.0 * phi[2] + phi[1])
            m += way * (phi[1:] - phi[:3])
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

    def mean_of(function: np.ndarray, harmonics: np.ndarray) -> np.ndarray:
        return np.einsum("kcn,kn,kc->k", waves, function, harmonics, optimize=True)

    v = mean_of(straight, m)
    size = mean_of(np.abs(straight) ** 2, s).real - np.abs(v) ** 2
    pseudo = mean_of(straight**2, g) - v * v
    cross = mean_of(h * straight, m)
    turned = mean_of(h * h, np.exp(-0.5 * c * c * variance[:, None])).real
    mean = np.column_stack([v.real, v.imag, np.zeros(len(v))])
    xx, yy, xy = 0.5 * (size + pseudo.real), 0.5 * (size - pseudo.real), 0.5 * pseudo.imag
    rows = [[xx, xy, cross.real], [xy, yy, cross.imag], [cross.real, cross.imag, turned]]
    return mean, np.moveaxis(np.array(rows), -1, 0)
