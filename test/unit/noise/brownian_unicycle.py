"""Moments of the unicycle in Brownian motion, in closed form: a path with no steps.

The unicycle goes one metre after another, s = 0 … L, along an arc of the curvature w, with

    dtheta = w ds + sqrt(q) dW1,    dP = exp(i theta) (ds + k dW2),    P = x + iy.

A. Martinelli (arXiv 1501.03300) has its moments of any order; those up to the second are derived
here again, and not from sums over steps. With z = iw - q / 2 and E exp(i (theta_s - theta_r)) =
exp(z (s - r)) for r < s,

    E P      = int_0^L exp(zs) ds
    E |P|²   = k² L + 2 Re int_0^L int_0^s exp(z (s - r)) dr ds
    E P²     = k² int_0^L exp(ys) ds + 2 int_0^L int_0^s exp(zs + (y - z) r) dr ds,  y = 2iw - 2q
    E P h    = iq int_0^L s exp(zs) ds

with h = theta - wL. For y, theta_s + theta_r = 2 theta_r + (theta_s - theta_r) has the variance
4 q r + q (s - r), half of which is q s / 2 + 3 q r / 2.
"""

import numpy as np


def moments(length, curvature, q, k):
    """Return mean (3,) and covariance (3, 3) of the error of x, y and heading at the end."""
    z, y = 1j * curvature - 0.5 * q, 2j * curvature - 2.0 * q
    mean = grown(z, length)
    size = k**2 * length + 2.0 * ((grown(z, length) - length) / z).real
    pseudo = k**2 * grown(y, length) + 2.0 / (y - z) * (grown(y, length) - grown(z, length))
    cross = 1j * q * (length * np.exp(z * length) - grown(z, length)) / z
    perfect = grown(1j * curvature, length) if curvature else length
    c, g = size - abs(mean) ** 2, pseudo - mean**2
    bias = mean - perfect
    return np.array([bias.real, bias.imag, 0.0]), matrix(c, g, cross, q * length)


def matrix(c, g, cross, turned):
    """Return the covariance (3, 3) by E |P|², E P², E P h and E h² about the means."""
    return np.array(
        [
            [0.5 * (c + g.real), 0.5 * g.imag, cross.real],
            [0.5 * g.imag, 0.5 * (c - g.real), cross.imag],
            [cross.real, cross.imag, turned],
        ]
    )


def grown(z, length):
    """Return the integral of exp(zs) over 0 … length."""
    return (np.exp(z * length) - 1.0) / z


def exponential_moments(length, q, k, nodes=60):
    """Return mean and covariance in exponential coordinates of a straight drive's error at its end.

    Given the last heading error h, those before are a Brownian bridge: the one at s has the mean
    h s / L, and those at r < s have the covariance q r (L - s) / L. So mean and second moments of P
    given h are integrals over s, and over r and s; what is left is one over h. The rule of Gauss
    and Legendre does all of them, the inner one over r < s.
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    s, ws = 0.5 * length * (x + 1.0), 0.5 * length * w
    r = 0.5 * s[:, None] * (x + 1.0)
    wr = 0.5 * s[:, None] * w
    spread = np.sqrt(q * length)
    # Headings beyond half a turn are left out: keep their variance below some 0.4.
    h = min(np.pi, 9.0 * spread) * x
    wh = min(np.pi, 9.0 * spread) * w * np.exp(-0.5 * (h / spread) ** 2)
    wh /= wh.sum()
    half = 0.5 * h
    straight = half / np.tan(half) - 1j * half
    first, size, pseudo = (np.empty(nodes, dtype=complex) for _ in range(3))
    for i, last in enumerate(h):
        own, both = q * s * (length - s) / length, q * r * (length - s[:, None]) / length
        before = q * r * (length - r) / length
        turn, turn_before = last * s / length, last * r / length
        first[i] = np.sum(ws * np.exp(1j * turn - 0.5 * own)) - length
        apart = np.exp(1j * (turn[:, None] - turn_before) - 0.5 * (own[:, None] + before) + both)
        together = np.exp(1j * (turn[:, None] + turn_before) - 0.5 * (own[:, None] + before) - both)
        weights = ws[:, None] * wr
        whole = first[i] + length
        size[i] = k**2 * length + 2.0 * np.sum(weights * apart).real
        size[i] += length**2 - 2.0 * length * whole.real
        twice = k**2 * np.sum(ws * np.exp(2j * turn - 2.0 * own))
        pseudo[i] = twice + 2.0 * np.sum(weights * together)
        pseudo[i] += length**2 - 2.0 * length * whole
    v = np.sum(wh * straight * first)
    c = np.sum(wh * np.abs(straight) ** 2 * size).real - abs(v) ** 2
    g = np.sum(wh * straight**2 * pseudo) - v * v
    cross = np.sum(wh * h * straight * first)
    return np.array([v.real, v.imag, 0.0]), matrix(c, g, cross, np.sum(wh * h * h))
