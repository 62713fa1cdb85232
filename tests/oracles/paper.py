"""Short NumPy versions of the formulas, to be read next to the paper; they are slow and made only for reading."""

from __future__ import annotations

import math
from math import comb

import numpy as np
from scipy.integrate import quad
from scipy.signal import lfilter


def tustin(poles_and_orders, w, dt):
    """Filter w by prod of s^j pole/(s + pole), j in (0, 1), each by the trapezoidal rule."""
    for pole, j in poles_and_orders:
        gain = pole / (2 / dt + pole)
        numerator = [gain, gain] if j == 0 else [gain * 2 / dt, -gain * 2 / dt]
        w = lfilter(numerator, [1, -(2 / dt - pole) / (2 / dt + pole)], w)
    return w


def matched(w, cutoff, order, dt):
    """Filter a held signal by F(s), with w[k] valid over [k dt, (k+1) dt): Tustin times M(z) = 2 / (z + 1)."""
    first = lfilter([0, 2 * cutoff / (2 / dt + cutoff)], [1, -(2 / dt - cutoff) / (2 / dt + cutoff)], w)
    return tustin([(cutoff, 0)] * (order - 1), first, dt)


def J(i, gamma, dt, degree):
    """Return J of paper eq. 35 over the common ((1 + gamma) dt / 2)^degree: powers of the zero's Tustin image."""
    return ((gamma - 1) / (dt / 2 * (1 + gamma))) ** i


def facts(zeros, dt, p, first):
    """Return H (p, n) and h (n,) of the drive: 1 + f_1 s + f_2 s^2 = 0 at the Tustin images (paper eq. 34 to 36, h
    affine).
    """
    n = len(zeros)
    H = np.zeros((p, n))
    for column, zero in enumerate(zeros):
        for i in range(1, n + 1):
            H[first + i - 1, column] = J(i, np.exp(zero * dt), dt, n)
    return H, -np.ones(n)


def compensate(P, theta_biased, H, h, G):
    """Return theta_B - P G (H^T P G)^-1 (H^T theta_B - h): paper eq. 26 to 32 with the affine right-hand side."""
    r = np.linalg.solve(H.T @ P @ G, H.T @ theta_biased - h)
    return theta_biased - P @ G @ r


def bcls(phi, z, H, h, G):
    """Return the batch bias-compensated least-squares estimate for the extended regressor phi (n, p)."""
    information = phi.T @ phi
    return compensate(np.linalg.inv(information), np.linalg.solve(information, phi.T @ z), H, h, G)


def bcrls(phi, z, forgetting, start, H, h, G):
    """Return theta_BC (n, p) of paper eq. 33 from sample `start`, begun with the discounted batch solution."""
    weights = forgetting ** np.arange(start)[::-1]
    P = np.linalg.inv((phi[:start] * weights[:, None]).T @ phi[:start])
    theta = P @ ((phi[:start] * weights[:, None]).T @ z[:start])
    track = np.full(phi.shape, np.nan)
    for k in range(start, len(z)):
        gain = P @ phi[k] / (forgetting + phi[k] @ P @ phi[k])
        P = (P - np.outer(gain, phi[k] @ P)) / forgetting
        P = (P + P.T) / 2
        theta = theta + P @ phi[k] * (z[k] - phi[k] @ theta)
        track[k] = compensate(P, theta, H, h, G)
    return track


def moment(w, k, cutoff, gain, t):
    """Return M_k of w at time t by the definition (paper eq. 8), with a gain for each of the k + 1 stages."""

    def weighted(tau):
        return gain ** (k + 1) * (t - tau) ** k / math.factorial(k) * math.exp(-cutoff * (t - tau)) * w(tau)

    return quad(weighted, 0.0, t)[0]


def matched_input(w, cutoff, order, dt, j, r):
    """Filter the input of a plant of relative degree r by s^j F(s), with w[k] valid over [k dt, (k+1) dt): Tustin
    times M_r(z).
    """
    B = {1: [1], 2: [1, 1], 3: [1, 4, 1], 4: [1, 11, 11, 1]}[r]
    gain, pole = cutoff / (2 / dt + cutoff), (2 / dt - cutoff) / (2 / dt + cutoff)
    numerator = np.r_[0.0, B] * (2 * gain) ** r / math.factorial(r) * gain ** (order - r)
    for factor in [[2 / dt, -2 / dt]] * j + [[1, 1]] * (order - r - j):
        numerator = np.convolve(numerator, factor)
    return lfilter(numerator, np.poly([pole] * order), w)


def process_facts(zeros, dt, n, m):
    """Return H (2n + m + 1, n) of a transfer function, b^e in ascending powers: b^e(z_i) = 0 (paper eq. 34 to 36)."""
    H = np.zeros((2 * n + m + 1, n))
    for column, zero in enumerate(zeros):
        H[n:, column] = [J(i, np.exp(zero * dt), dt, n) for i in range(n + m + 1)]
    return H


def coefficient_matrix(n: int, cutoff: float, gain: float) -> np.ndarray:
    """Return the matrix A_n (n+1, n+1) of paper eq. 13 to 16, with the exponent of the gain corrected.

    M_n{d^(n+1-i) y / dt^(n+1-i)} = sum_j A_n(i, j) M_{j-1}{y}, i, j = 1 .. n+1, for the moments
    M_k = (gain / (s + cutoff))^(k+1):

        A_n(i, j) = (-1)^(j-i) C(n+1-i, j-i) cutoff^(j-i) gain^(n+1-j) for i <= j, else 0.

    The first row gives the target y_PMF^(n) (eq. 14), the other rows give the regressors (eq. 13). The paper prints the
    exponent of the gain as n+i-j, which is right only for gain = 1.
    `pmfid.filters.chain.derivative` is this matrix for gain = cutoff.
    """
    matrix = np.zeros((n + 1, n + 1))
    for i in range(1, n + 2):
        for j in range(i, n + 2):
            matrix[i - 1, j - 1] = comb(n + 1 - i, j - i) * (-cutoff) ** (j - i) * gain ** (n + 1 - j)
    return matrix
