"""Poisson moment functionals as a chain of first-order stages, in two discretisations.

The chain is F(s) = (cutoff / (s + cutoff))^order (paper eq. 9 with unit gain). All signals of the kernel (mean
velocity, input and direction) are constant during a sampling interval, so that one chain serves all of them.

With s_T = (2/dt) (z-1)/(z+1), the mean velocity is s_T y times (z+1)/2. For a plant of relative degree 2, the matched
filter applies the factor 2/(z+1) to signals like the input. In both cases the coefficients of the first stage cancel
its zero.
"""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal, localcontext
from math import comb

import numpy as np

from pmfid.elementary import PRECISE, exp, power
from pmfid.filters.network import Network, Taps

#: Function of (network, source, cutoff, order, dt) that returns the taps of F(s) for the held signal at `source`.
HoldFilter = Callable[[Network, int, float, int, float], Taps]


def lag(network: Network, source: int, pole: float, dt: float) -> int:
    """Append the lag pole / (s + pole) by the trapezoidal rule, and return its node."""
    gain = pole / (2 / dt + pole)
    return network.stage(source, _tustin_pole(pole, dt), gain, gain, ("lasting", pole * dt / 2))


def differentiating_lag(network: Network, source: int, pole: float, dt: float) -> int:
    """Append the differentiating lag s pole / (s + pole) by the trapezoidal rule, and return its node."""
    gain = (2 / dt) * pole / (2 / dt + pole)
    return network.stage(source, _tustin_pole(pole, dt), gain, -gain, ("changing", pole * dt / 2))


def chain(network: Network, source: int, cutoff: float, order: int, dt: float, cancelled: int = 1) -> list[int]:
    """Append the stages 1 to `order` of the chain and return their nodes.

    In the first `cancelled` stages, the zero at z = -1 is cancelled.
    """
    nodes: list[int] = []
    for i in range(order):
        before = nodes[-1] if nodes else source
        if i < cancelled:
            gain = 2 * cutoff / (2 / dt + cutoff)
            nodes.append(network.stage(before, _tustin_pole(cutoff, dt), gain, 0.0, ("lasting", cutoff * dt / 2)))
        else:
            nodes.append(lag(network, before, cutoff, dt))
    return nodes


def matched_input(
    network: Network, source: int, cutoff: float, order: int, dt: float, relative_degree: int
) -> list[int]:
    """Append M_r(z) = 2^r B_r(z) / (r! (z+1)^r) and the chain, and return the chain's nodes. The source is a held
    input of a plant of relative degree r.

    B_r are the Euler-Frobenius polynomials (Astrom, Hagander and Sternby 1984). Their roots are the zeros of a sampled
    chain of integrators after a hold. The trapezoidal rule has (z+1)^r instead. Zeros at -1 cancel in the coefficients,
    and the other factors of B_r are first-order stages. The order must be at least derivative + relative_degree.
    """
    roots = [root for root in sampling_zeros(relative_degree) if root != -1]
    for root in roots:
        source = network.stage(source, 0.0, 1 / (1 - root), -root / (1 - root))
    return chain(network, source, cutoff, order, dt, cancelled=len(roots) + 1)


def euler_frobenius(degree: int) -> list[int]:
    """Return the palindromic coefficients (degree,) of B_r(z). The k-th is sum_l (-1)^l C(r+1, l) (k+1-l)^r."""
    return [sum((-1) ** i * comb(degree + 1, i) * (k + 1 - i) ** degree for i in range(k + 1)) for k in range(degree)]


def sampling_zeros(degree: int) -> list[float]:
    """Return the real roots of B_r(z) in rising order, each rounded once.

    LAPACK rounds by the kind of processor, so Newton's method with more digits continues from its roots.
    """
    coefficients = euler_frobenius(degree)
    with localcontext(PRECISE):
        return sorted(float(_refine_root(coefficients, Decimal(root))) for root in np.roots(coefficients).real.tolist())


def _refine_root(coefficients: list[int], root: Decimal) -> Decimal:
    for _ in range(4):  # from 12 digits to more than 60
        value = slope = Decimal(0)
        for coefficient in coefficients:
            slope, value = slope * root + value, value * root + coefficient
        root -= value / slope
    return root


def derivative(nodes: list[int], j: int, cutoff: float) -> Taps:
    """Return the taps of s^j F w on the stages of w, for j < order.

    With L for one stage, s^j L^N = cutoff^j sum_k C(j, k) (-1)^k L^(N-j+k).
    """
    first = len(nodes) - 1 - j
    gain = power(cutoff, j)
    return [(nodes[first + k], gain * comb(j, k) * (-1) ** k) for k in range(j + 1)]


def hold_matched(network: Network, source: int, cutoff: float, order: int, dt: float) -> Taps:
    """Return the taps of Tustin's rule with the factor 2/(z+1). A plant of relative degree 1 or 2 then has no bias
    of first order.
    """
    return [(chain(network, source, cutoff, order, dt)[-1], 1.0)]


def hold_exact(network: Network, source: int, cutoff: float, order: int, dt: float, j: int = 0) -> Taps:
    """Return the taps of s^j F(s) after a zero-order hold, without approximation (paper section III-A). The stages
    have the pole exp(-cutoff dt).
    """
    pole = exp(-cutoff * dt)
    nodes = [network.stage(source, pole, 1 - pole, 0.0)]
    for _ in range(order - 1):
        nodes.append(network.stage(nodes[-1], pole, 0.0, 1 - pole))
    with localcontext(PRECISE):
        weights = _match_response(Decimal(pole), _hold_response(Decimal(cutoff), order, Decimal(dt), j))
    return [(node, float(weight)) for node, weight in zip(nodes, weights, strict=True)]


HOLD_FILTERS: dict[str, HoldFilter] = {"matched": hold_matched, "paper": hold_exact}


def mean_velocity_correction(network: Network, node: int) -> Taps:
    """Return the taps of (-w[k] + 14 w[k-1] - w[k-2]) / 12: a correction of two samples' look-ahead with a delay of
    one sample.

    For a plant of relative degree r, the factor M_(r+1)/M_r = 1 - dt^2 s_T^2 / 12 (r = 2) matches the term of order
    n-1. The factor is the next member of the expansion that leads to M_r. The factor removes a viscous error of d dt^2
    <a^2> / (12 <v^2>).
    """
    one = network.delay(node)
    return [(node, -1 / 12), (one, 14 / 12), (network.delay(one), -1 / 12)]


def correct_uneven_velocity(network: Network, nodes: list[int], cutoff: float, dt: float) -> Taps:
    """Return the taps of the mean velocity correction for a step h that varies, with a delay of one sample. `nodes`
    are those of the chain.

    The correction in each interval is h^2 times the derivative of the acceleration. Far below the frequency 1/h, the
    filters see the mean of h^2 over time. The derivative has the lag of one period, as the other terms have.
    """
    taps = [(network.delay(nodes[-1]), 1.0)]
    for node, weight in derivative(nodes, 1, cutoff):
        taps.append((_mean_jerk(network, node, dt), -weight * dt * dt / 12))
    return taps


def correct_turns(network: Network, turns: int, cutoff: float, order: int, dt: float) -> Taps:
    """Return the taps by which reversals inside an interval change the direction signal.

    Friction and acceleration jump at a reversal. The mean velocity shows this jump in the same way as a jerk.
    """
    nodes = chain(network, turns, cutoff, order, dt)
    return [(node, -weight * dt / 12) for node, weight in derivative(nodes, 1, cutoff)]


def _mean_jerk(network: Network, source: int, dt: float) -> int:
    """Return the node of an acceleration's derivative, times the mean square of the step over the squared period."""
    pole = 1 / dt
    gain = (2 / dt) * pole / (2 / dt + pole)
    return network.stage(source, _tustin_pole(pole, dt), gain, -gain, ("bending", pole * dt / 2))


def _tustin_pole(pole: float, dt: float) -> float:
    return (2 / dt - pole) / (2 / dt + pole)


def _match_response(pole: Decimal, response: list[Decimal]) -> list[Decimal]:
    """Return the weights (order,) of the stages of `hold_exact`, whose sum has the given first samples (order,).

    Stage i has i samples of delay, so each sample of the response determines one more weight.
    """
    gain, weights = 1 - pole, list[Decimal]()
    for k, value in enumerate(response):
        for i, weight in enumerate(weights):
            value -= weight * comb(k, i) * gain ** (i + 1) * pole ** (k - i)
        weights.append(value / gain ** (k + 1))
    return weights


def _hold_response(cutoff: Decimal, order: int, dt: Decimal, j: int) -> list[Decimal]:
    """Return the first `order` samples of the response of s^j F(s) to an input held for one interval.

    Stage m of the chain after a unit step has the response 1 - sum_(i<=m) x^i exp(-x) / i!, with x = cutoff t.
    """
    taps = derivative(list(range(order)), j, 1.0)
    steps = [_step_response(k * cutoff * dt, order) for k in range(order + 1)]
    held = [[now - before for now, before in zip(*pair, strict=True)] for pair in zip(steps[1:], steps, strict=False)]
    return [sum((cutoff**j * Decimal(weight) * row[node] for node, weight in taps), Decimal(0)) for row in held]


def _step_response(x: Decimal, order: int) -> list[Decimal]:
    """Return the responses (order,) of the stages to a unit step, after the time x / cutoff."""
    term, rest, responses = (-x).exp(), Decimal(0), list[Decimal]()
    for m in range(order):
        rest += term
        responses.append(1 - rest)
        term *= x / (m + 1)
    return responses
