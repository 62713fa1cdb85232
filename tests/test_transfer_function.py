"""Linear processes in the kernel: the filtered equation, least squares, compensation, and related functions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

import pmfid
from pmfid import BCLS, BCRLS, LS, RLS, TransferFunction
from pmfid.filters.chain import derivative
from pmfid.models.equation import Equation, Term
from tests.oracles import paper
from tests.oracles.paper import coefficient_matrix
from tests.refusals import refused

FINE = 2.0**30


@dataclass(frozen=True)
class Plant:
    """A process G = num / den (descending powers), with the settings of its record. The settings are dt, cutoff,
    samples per clock, samples and pre-filter zeros."""

    num: tuple[float, ...]
    den: tuple[float, ...]
    dt: float
    cutoff: float
    clock: int
    samples: int
    zeros: tuple[float, ...]

    @property
    def model(self) -> TransferFunction:
        return TransferFunction(len(self.den) - 1, len(self.num) - 1)

    @property
    def truth(self) -> np.ndarray:
        return np.r_[self.den[:0:-1], self.num[::-1]]


LAG = Plant((3.0,), (1.0, 4.0, 3.0), 0.05, 5.0, 3, 3069, (-1.0, -3.0))
UNDERSHOOT = Plant((1.0, -1.0), (1.0, 2.0, 1.0), 0.1, 2.0, 4, 5000, (-0.5, -1.5))
RAO_GARNIER = Plant((-6400.0, 1600.0), (1.0, 5.0, 408.0, 416.0, 1600.0), 0.01, 20.0, 7, 7161, (-1.0, -2.0, -4.0, -8.0))
PLANTS = {"lag": LAG, "undershoot": UNDERSHOOT, "rao_garnier": RAO_GARNIER}


@dataclass(frozen=True)
class Record:
    u: np.ndarray
    y: np.ndarray
    counts: np.ndarray
    encoder: pmfid.Encoder
    noise_std: float


def respond(plant: Plant, u: np.ndarray) -> np.ndarray:
    num, den, _ = cont2discrete((plant.num, plant.den), plant.dt)
    return lfilter(num.ravel(), den, u)


def make_record(plant: Plant, seed: int, *, snr: float | None = None, load: float = 0.0, delay: int = 0) -> Record:
    """Return the response to a random binary input with white noise at `snr` dB (None: no noise) and a constant
    `load`.
    """
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], plant.samples // plant.clock + 1).repeat(plant.clock)[: plant.samples]
    y = respond(plant, np.r_[np.zeros(delay), u][: u.size]) + load
    std = 0.0 if snr is None else float(np.std(y)) * 10 ** (-snr / 20)
    return recorded(u, y, y + std * rng.standard_normal(y.size), std)


def recorded(u: np.ndarray, y: np.ndarray, measured: np.ndarray, std: float) -> Record:
    encoder = pmfid.Encoder(float(np.max(np.abs(measured))) / FINE)
    return Record(u, y, pmfid.quantize(measured, encoder.resolution), encoder, std)


def build(cls, plant: Plant, run: Record, model: TransferFunction | None = None, **options):
    return cls(model or plant.model, run.encoder, plant.dt, plant.cutoff, **options)


def estimate(cls, plant: Plant, run: Record, model: TransferFunction | None = None, **options) -> np.ndarray:
    estimator = build(cls, plant, run, model, **options)
    if hasattr(estimator, "fit"):
        return estimator.fit(run.u, run.counts).theta
    return estimator.run(run.u, run.counts).theta[-1]


# --- the filtered equation --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gain", [1.0, 2.5])
def test_the_coefficient_matrix_of_the_paper_filters_derivatives(gain):
    """Rows of A_n times the moments of y are the moments M_n of the derivatives of y (paper eq. 10 to 16)."""
    n, cutoff, t = 3, 2.5, 0.8
    y = np.poly1d([1.0, -3.0, 0.0, 0.0, 0.0])  # all derivatives below the third vanish at t = 0
    own = [paper.moment(y, k, cutoff, gain, t) for k in range(n + 1)]
    derivatives = [paper.moment(y.deriv(n - i) if i < n else y, n, cutoff, gain, t) for i in range(n + 1)]
    np.testing.assert_allclose(coefficient_matrix(n, cutoff, gain) @ own, derivatives, rtol=1e-9)


def test_the_chain_of_the_kernel_is_the_coefficient_matrix_with_unit_gain():
    n, cutoff = 3, 5.0
    matrix = coefficient_matrix(n, cutoff, cutoff)
    for j in range(n + 1):
        row = np.zeros(n + 1)
        for node, weight in derivative(list(range(n + 1)), j, cutoff):
            row[node] = weight
        np.testing.assert_allclose(row, matrix[n - j])


@pytest.mark.parametrize(("n", "m", "delay"), [(1, 0, 0), (2, 0, 2), (2, 1, 0), (3, 0, 1), (4, 0, 0), (4, 1, 3)])
@pytest.mark.parametrize("extra", [0, 1])
def test_columns_are_those_of_the_oracle(n, m, delay, extra):
    rng = np.random.default_rng(n + m)
    u, dt, cutoff, order = rng.standard_normal(400), 0.02, 8.0, max(2, n + extra)
    y = np.r_[0.0, 0.0, rng.standard_normal(398)]
    run = recorded(u, y, y, 0.0)
    columns = LS(TransferFunction(n, m, delay), run.encoder, dt, cutoff, order=order).columns(u, run.counts)
    corrected = n - m > 1
    for i in range(n + 1):
        filtered = paper.tustin([(cutoff, 1)] * i + [(cutoff, 0)] * (order - i), y, dt)
        c = (n - i) / 12 if corrected else 0.0
        late = np.convolve(filtered, [-c, 1 + 2 * c, -c])[: y.size]  # centred on the previous sample
        column = -columns.z if i == n else columns.phi[:, i]
        np.testing.assert_allclose(column, late[columns.used], atol=1e-6 * cutoff**i)
    held = np.r_[np.zeros(delay), u][: u.size]
    for j in range(m + 1):
        expected = paper.matched_input(held, cutoff, order, dt, j, n - j if corrected else n - m)
        np.testing.assert_allclose(
            -columns.phi[:, n + j], np.r_[0.0, expected[:-1]][columns.used], atol=1e-9 * cutoff**j
        )


@pytest.mark.parametrize(("name", "worst"), [("lag", 1.5e-4), ("undershoot", 0.0043), ("rao_garnier", 3e-4)])
def test_without_noise_little_but_the_bias_of_the_matched_filter_is_left(name, worst):
    plant = PLANTS[name]
    error = np.abs(estimate(LS, plant, make_record(plant, 1)) / plant.truth - 1)
    assert np.max(error) < worst


# --- estimates --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "least"), [("lag", 3.8), ("undershoot", 1.9)])
def test_order_of_convergence_of_the_matched_filter(name, least):
    """The order in dt is four from relative degree 2 on, and two for relative degree 1."""
    plant = PLANTS[name]
    worst = []
    dts = plant.dt * np.array([2.0, 1.0, 0.5])
    for dt in dts:
        finer = replace(plant, dt=dt, clock=round(plant.clock * plant.dt / dt * 2), samples=round(400 / dt))
        worst.append(np.max(np.abs(estimate(LS, finer, make_record(finer, 1)) / plant.truth - 1)))
    order = np.polyfit(np.log(dts), np.log(worst), 1)[0]
    assert order > least


@pytest.mark.parametrize("name", PLANTS)
def test_recursive_estimates_without_forgetting_are_the_batch_ones(name):
    plant = PLANTS[name]
    run = make_record(plant, 2, snr=10.0)
    for batch, recursive in ((LS, RLS), (BCLS, BCRLS)):
        off_line, on_line = (estimate(cls, plant, run) for cls in (batch, recursive))
        np.testing.assert_allclose(on_line, off_line, rtol=1e-4)


@pytest.mark.parametrize("name", ["lag", "undershoot"])
def test_compensation_is_that_of_the_paper(name):
    """Equations 17 to 32 apply to the extended model with 2n + m + 1 unknowns, with b^e = b f divided by f afterwards.

    For a plant with m > 0 and a relative degree above 1, each power of s has a separate numerator. The extended columns
    then span the instruments only up to the discretisation.
    """
    plant = PLANTS[name]
    run, n, m = make_record(plant, 3, snr=15.0), plant.model.n, plant.model.m
    estimator = build(BCLS, plant, run, prefilter_zeros=plant.zeros)
    columns = estimator.columns(run.u, run.counts)
    poles = [(2 / plant.dt) * np.tanh(-zero * plant.dt / 2) for zero in plant.zeros]
    powers = [extended_input(run.u, plant, poles, j) for j in range(n + m + 1)]
    late = np.array([np.r_[0.0, column[:-1]] for column in powers]).T[columns.used]
    phi = np.c_[columns.phi[:, :n], -late]
    scale = np.linalg.norm(phi, axis=0)
    H = paper.process_facts(plant.zeros, plant.dt, n, m)
    theta = paper.bcls(phi / scale, columns.z, H / scale[:, None], np.zeros(n), np.eye(2 * n + m + 1)[:, :n]) / scale
    numerator, rest = np.polydiv(theta[n:][::-1], np.poly([-pole for pole in poles]) / np.prod(poles))
    expected = np.r_[theta[:n], numerator[::-1]]
    ours = estimator.fit(run.u, run.counts).theta
    np.testing.assert_allclose(ours, expected, rtol=1e-5)
    assert np.max(np.abs(rest)) < 1e-4 * np.max(np.abs(theta[n:]))


def extended_input(u: np.ndarray, plant: Plant, poles: list[float], j: int) -> np.ndarray:
    """Return s^j F of the pre-filtered input u^e = u / f; 1 / f takes up to n of the differentiations."""
    n, m = plant.model.n, plant.model.m
    inner = min(j, n)
    chain = [(pole, int(i < inner)) for i, pole in enumerate(poles)]
    return paper.matched_input(paper.tustin(chain, u, plant.dt), plant.cutoff, max(2, n), plant.dt, j - inner, n - m)


@pytest.mark.parametrize(("name", "least"), [("lag", 0.15), ("undershoot", 0.04), ("rao_garnier", 0.1)])
def test_compensation_takes_out_the_bias_of_white_noise(name, least):
    plant = PLANTS[name]
    mean = {}
    for cls in (LS, BCLS):
        runs = [make_record(plant, seed, snr=10.0) for seed in range(8)]
        theta = [estimate(cls, plant, run) for run in runs]
        mean[cls] = np.abs(np.mean(theta, axis=0) / plant.truth - 1)[: plant.model.n]
    assert np.max(mean[LS]) > least
    assert np.max(mean[BCLS]) < least / 4


# --- delay, offset, initial conditions --------------------------------------------------------------------------------


@pytest.mark.parametrize("cls", [LS, BCLS, RLS])
@pytest.mark.parametrize("plant", [UNDERSHOOT, RAO_GARNIER], ids=["undershoot", "rao_garnier"])
def test_initial_conditions_are_unknowns(cls, plant):
    """The record is a short part of a long one. A model without initial conditions would take the start for an effect
    of u.
    """
    if cls is RLS and plant is RAO_GARNIER:
        pytest.skip("ten parameters are more than the kernel estimates on-line")
    whole = make_record(plant, 6)
    part = slice(1000, 1400)
    run = recorded(whole.u[part], whole.y[part], whole.y[part], 0.0)
    n, m = plant.model.n, plant.model.m
    model = TransferFunction(n, m, initial_conditions=True)
    theta = estimate(cls, plant, run, model)[: n + m + 1]
    np.testing.assert_allclose(theta, plant.truth, rtol=0.05)  # this includes the matched filter's own error of 2 %
    assert build(LS, plant, run, model).columns(run.u, run.counts).z.size == 399


# --- errors -----------------------------------------------------------------------------------------------------------


def equation(*inputs: Term) -> Equation:
    return Equation((Term("process_output", 0, "a"), *inputs), (Term("process_output", 1),))


def test_what_cannot_be_is_refused_with_what_can():
    plain, encoder, drive = TransferFunction(2, 0), pmfid.Encoder(1e-6), pmfid.Drive(2.0)
    refused(
        ("n must be a whole number from 1 to 6, got 0", lambda: TransferFunction(0, 0)),
        ("from 1 to 6, got 7", lambda: TransferFunction(7, 0)),
        ("n must be a whole number from", lambda: TransferFunction("2", 1)),
        ("n must be a whole number from", lambda: TransferFunction(2.0, 1)),
        ("n must be a whole number from", lambda: TransferFunction(True, 0)),
        ("m must be a whole number from 0 to 2, got 3", lambda: TransferFunction(2, 3)),
        ("delay must be a whole number from 0", lambda: TransferFunction(2, 0, -1)),
        ("delay must be a whole number", lambda: TransferFunction(2, 0, 0.5)),
        ("must have only terms", lambda: equation(Term("input", 0, "b"))),
        ("must be the process_input", lambda: equation()),
        ("higher than the input's", lambda: equation(Term("process_input", 1, "b"))),
        ("3 different", lambda: BCLS(TransferFunction(3, 0), encoder, 0.01, 10.0, prefilter_zeros=(-1, -2))),
        ("for a linear process", lambda: RLS(plain, encoder, 0.01, 10.0, prefilter_zeros=(-1, -2))),
        ("order must be at least 4", lambda: LS(TransferFunction(4, 0), encoder, 0.01, 10.0, order=3)),
        ("riv", lambda: pmfid.RIV(plain, encoder, 0.01, 10.0)),
        ("encoder must be an Encoder, got 1.0", lambda: pmfid.SRIVC(plain, 1.0, 0.1, 5.0)),
        ("model must be a Drive", lambda: pmfid.SRIVC("drive", encoder, 0.1, 5.0)),
        ("dt must be positive and finite, got 'a'", lambda: pmfid.SRIVC(plain, encoder, "a", 5.0)),
        ("cutoff must be positive and finite", lambda: pmfid.SRIVC(plain, encoder, 0.1, None)),
        ("input_gain must be finite", lambda: pmfid.Drive("a")),
        ("not a length or angle", lambda: pmfid.Encoder("a")),
        ("bits must be a whole number", lambda: pmfid.Encoder(1.0, bits="a")),
        ("bits must be a whole number", lambda: pmfid.Encoder(1.0, bits=2.5)),
        ("forgetting must be in", lambda: RLS(drive, encoder, 0.01, 50.0, forgetting="a")),
        ("keep must be in", lambda: RLS(drive, encoder, 0.01, 50.0).open_memory("a")),
    )
    assert TransferFunction(np.int64(2), np.int32(1)).n == 2
