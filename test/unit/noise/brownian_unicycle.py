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
    covariance = np.array(
        [
            [0.5 * (c + g.real), 0.5 * g.imag, cross.real],
            [0.5 * g.imag, 0.5 * (c - g.real), cross.imag],
            [cross.real, cross.imag, q * length],
        ]
    )
    return np.array([bias.real, bias.imag, 0.0]), covariance


def grown(z, length):
    """Return the integral of exp(zs) over 0 … length."""
    return (np.exp(z * length) - 1.0) / z
