"""The chain and its discretisations against the matrix exponential, SciPy's filters and the order in dt."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

import pmfid
from pmfid._stage import first_order
from pmfid.filters.chain import chain, derivative, hold_exact
from pmfid.filters.columns import tustin_image
from pmfid.filters.network import SIGNALS, Network
from tests.conftest import cart_run
from tests.oracles import paper

DT = 0.01
CUTOFF = 37.0


def run_network(network: Network, taps: list, w: np.ndarray) -> np.ndarray:
    """Run the network in plain Python on signal 0; w[k] holds for the interval that ends at k."""
    nodes = np.zeros((len(w), SIGNALS + len(network.stages)))
    memory = np.zeros(len(network.stages))
    nodes[:, 0] = w
    for k in range(len(w)):
        for i, (source, a, b0, b1) in enumerate(network.stages):
            nodes[k, SIGNALS + i] = b0 * nodes[k, source] + memory[i]
            memory[i] = b1 * nodes[k, source] + a * nodes[k, SIGNALS + i]
    return sum(weight * nodes[:, node] for node, weight in taps)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_hold_exact_is_the_matrix_exponential(order):
    w = np.random.default_rng(1).normal(size=60)
    network = Network()
    taps = hold_exact(network, 0, CUTOFF, order, DT)
    numerator, denominator, _ = cont2discrete(([CUTOFF**order], np.poly([-CUTOFF] * order)), DT, "zoh")
    expected = lfilter(np.ravel(numerator), denominator, np.r_[w, 0.0])[1:]
    np.testing.assert_allclose(run_network(network, taps, w), expected, atol=1e-12)


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("j", [0, 1])
def test_derivatives_of_the_chain_are_the_trapezoidal_filters(order, j):
    w = np.random.default_rng(2).normal(size=80)
    network = Network()
    nodes = chain(network, 0, CUTOFF, order, DT)
    got = run_network(network, derivative(nodes, j, CUTOFF), w)
    held = paper.matched(np.r_[w, 0.0], CUTOFF, 1, DT)[1:]
    parts = [(CUTOFF, 1)] * j + [(CUTOFF, 0)] * (order - 1 - j)
    np.testing.assert_allclose(got, paper.tustin(parts, held, DT), atol=1e-10)


def test_tustin_image_is_the_exact_pole():
    image = tustin_image(8.0, DT)
    assert (2 / DT - image) / (2 / DT + image) == pytest.approx(np.exp(-8.0 * DT), rel=1e-14)


def test_kernel_columns_equal_the_oracle(drive):
    """Encoder, chain and columns of the drive equal SciPy filters on the same interval signals."""
    run = cart_run(3, samples=400)
    estimator = pmfid.LS(drive, run.encoder, DT, CUTOFF)
    columns, status = estimator.make_kernel().filter(run.u, run.counts)
    velocity = np.diff(run.counts, prepend=run.counts[0]) * run.encoder.resolution / DT
    filtered = paper.matched(np.r_[velocity, 0.0], CUTOFF, 2, DT)[1:]
    held = paper.matched(np.r_[velocity, 0.0], CUTOFF, 1, DT)[1:]
    acceleration = paper.tustin([(CUTOFF, 1)], held, DT)
    late = np.r_[0.0, acceleration[:-1]]
    np.testing.assert_allclose(columns[:, 0], late, atol=1e-9)
    w = np.r_[0.0, 0.0, filtered]
    np.testing.assert_allclose(columns[:, 1], (-w[2:] + 14 * w[1:-1] - w[:-2]) / 12, atol=1e-12)
    moved = np.cumsum(np.abs(velocity)) > 0
    moving = np.r_[0.0, moved[:-1]]
    u_late = np.r_[0.0, 0.0, run.u[:-2]] * moving
    np.testing.assert_allclose(columns[:, 3], 2.0 * paper.matched(np.r_[u_late, 0.0], CUTOFF, 2, DT)[1:], atol=1e-12)
    assert not np.any(status & pmfid.Status.COUNT_JUMP)


@pytest.mark.parametrize("discretization", ["matched", "paper"])
def test_order_of_convergence_in_dt(discretization, drive):
    """Without reversals, and thus without direction errors, the parameter error falls with about dt^2."""
    from pmfid.simulation.drive import DriveParameters, quantize, simulate_drive

    parameters = DriveParameters(1.07, 12.8, 0.8, 2.0)
    errors, periods = [], (0.02, 0.01, 0.005)
    for dt in periods:
        t = np.arange(round(20 / dt)) * dt
        blocks = np.floor(t / 0.1).astype(int)
        u = 2.5 + np.random.default_rng(5).uniform(-1.0, 1.0, blocks.max() + 1)[blocks]
        counts = quantize(simulate_drive(parameters, u, dt).x, 1e-9)
        fit = pmfid.LS(drive, pmfid.Encoder(1e-9), dt, 20.0, discretization=discretization).fit(u, counts)
        errors.append(abs(fit["mass"] / 1.07 - 1))
    slope = np.polyfit(np.log(periods), np.log(errors), 1)[0]
    assert slope > 1.7


def test_a_stage_over_a_whole_signal_has_the_bits_of_scipy() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        a, b0, b1, memory = rng.uniform(-1, 1), *rng.standard_normal(3)
        x = rng.standard_normal(200)
        expected, left = lfilter([b0, b1], [1, -a], x, zi=[memory])
        found, kept = first_order(x, a, b0, b1, memory)
        assert np.array_equal(found, expected)
        assert kept == left[0]
        assert np.array_equal(first_order(x[::2], a, b0)[0], lfilter([b0], [1, -a], x[::2]))
