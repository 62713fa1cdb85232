"""Filters without an error of discretisation for held inputs, around a denominator that is refined from pass to pass.

The output goes through F_T(z) s_T^k, F = (cutoff / (s + cutoff))^order by trapezoids, s_T = (2/dt) (z-1)/(z+1),
an input-like term b s^j w through F_T(z) A(s_T) ZOH{s^j / A(s)}(z). If A is the plant's, ZOH{sum b s^j / A} w is its
output at the samples exactly: so the discrete equation holds, too. With A from the pass before it holds up to the
difference, and a pass that knows by how much (`slopes`) squares the error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmfid._stage import first_order
from pmfid.transfer.experiment import RecordStretch
from pmfid.transfer.propagate import Grid
from pmfid.transfer.sensitivity import Structure, channels
from pmfid.types import Floats


@dataclass(frozen=True)
class Filter:
    """F = (cutoff / (s + cutoff))^order by the trapezoidal rule with the period dt [s]."""

    cutoff: float
    order: int
    dt: float

    def output(self, signal: Floats, k: int) -> Floats:
        """F_T s_T^k of a sampled signal (N,), from rest; k <= order."""
        for stage in range(self.order):
            signal = self.stage(signal, self.cutoff, differentiating=stage < k)
        return signal

    def stage(self, signal: Floats, cutoff: float, *, differentiating: bool) -> Floats:
        """cutoff / (s + cutoff), or s times it."""
        high = 2 / self.dt
        gain, pole = cutoff / (high + cutoff), (high - cutoff) / (high + cutoff)
        top = (gain * high, -gain * high) if differentiating else (gain, gain)
        return first_order(signal, pole, *top)[0]

    def equation(self, signal: Floats, A: Floats) -> Floats:
        """F_T A(s_T) of a sampled signal (N,); A: (n+1,) from the constant on."""
        return np.asarray(sum(A[k] * self.output(signal, k) for k in range(A.size)))


@dataclass(frozen=True)
class ExactTerm:
    """coefficient of s^power times held signal `source`; column: of the unknown, None for a known one."""

    source: int
    power: int
    coefficient: float
    column: int | None


@dataclass(frozen=True)
class Responses:
    """responses (terms, N): s^j / A of each held term's signal, without its coefficient; simulated (N,) output;
    slopes (n+1, N): s^k / A of the simulated output."""

    responses: Floats
    simulated: Floats
    slopes: Floats


def respond_exactly(A: Floats, terms: list[ExactTerm], signals: Floats, dt: float) -> Responses:
    """From rest; A: (n+1,) from the constant on, signals (s, N) held. Powers are less than n."""
    n, size = A.size - 1, signals.shape[1]
    poles = np.roots(A[::-1])
    rate = max(float(np.max(np.abs(poles))), 1e-3 / dt)
    a = A[:-1] / A[-1] / rate ** (n - np.arange(n))
    rows = np.arange(size)
    stretch = RecordStretch(Grid(rate * dt, size), signals, np.zeros(size), rows, rows, held=True)
    found = channels(Structure(n, 0), np.r_[a, 0.0], stretch, twice=True)
    single, double = found.single, found.double

    def size_of(power: int, divisions: int) -> float:
        return float(rate ** (power - divisions * n) / A[-1] ** divisions)

    responses = np.array([single[term.power, term.source] * size_of(term.power, 1) for term in terms])
    weights = np.array([term.coefficient for term in terms])
    slopes = [
        sum(term.coefficient * double[term.power + k, term.source] * size_of(term.power + k, 2) for term in terms)
        for k in range(n + 1)
    ]
    return Responses(responses, weights @ responses, np.array(slopes))
