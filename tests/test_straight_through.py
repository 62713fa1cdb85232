"""Fixed filters and an output that jumps with its input (m = n): the error is of order dt^2, as otherwise."""

from __future__ import annotations

import numpy as np
import pytest

import pmfid
from pmfid.simulation.process import simulate_process
from pmfid.simulation.signals import prbs
from pmfid.testing import check_estimator

#: numerator, denominator, cutoff [rad/s], whole samples of dead time, integrators
PROCESSES = {
    "lead": ((-1.5, 2.0), (1.0, 2.0), 3.0, 0, 0),
    "two": ((0.7, 1.0, 2.0), (1.0, 1.2, 4.0), 3.0, 0, 0),
    "two, late": ((0.7, 1.0, 2.0), (1.0, 1.2, 4.0), 4.0, 2, 0),
    "controller": ((1.3, 2.0), (1.0, 0.0), 2.0, 0, 1),
}


def deviation(name: str, dt: float) -> float:
    """Return the largest relative error of `IV` without noise."""
    b, a, cutoff, delay, integrators = PROCESSES[name]
    u = prbs(int(150 / dt), clock=int(0.4 / dt), amplitude=1.0, rng=np.random.default_rng(5))
    late = np.r_[np.zeros(delay), u][: u.size]
    rest = (np.array(b) - b[0] * np.array(a))[1:]
    y = simulate_process(tuple(rest), a, late, dt) + b[0] * late
    model = pmfid.TransferFunction(len(a) - 1, len(b) - 1, delay=delay, integrators=integrators)
    fit = pmfid.IV(model, pmfid.Encoder(1e-6), dt, cutoff).fit(u, pmfid.quantize(y, 1e-6))
    return float(np.max(np.abs(fit.theta / np.r_[a[:0:-1][integrators:], b[::-1]] - 1)))


@pytest.mark.parametrize("name", PROCESSES)
def test_the_error_falls_with_the_square_of_the_sample_period(name: str) -> None:
    coarse, fine = (deviation(name, dt) for dt in (0.05, 0.025))
    assert coarse < 0.01
    assert fine < 0.35 * coarse + 1e-6


def test_the_contract_of_an_estimator_holds() -> None:
    check_estimator(pmfid.IV(pmfid.TransferFunction(2, 2), pmfid.Encoder(1e-3), 0.05, 3.0))
