"""Transfer functions from the counts of an encoder, their intervals, and inputs of one level."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

import pmfid
from pmfid import SRIVC, Drive, Encoder, TransferFunction, quantize
from pmfid.config.axis import Axis
from pmfid.pipeline.export import drive_estimator
from pmfid.records.record import Record
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
from pmfid.simulation.process import simulate_process
from pmfid.types import Floats
from tests.conftest import long_unless

DT, A0, B0 = 0.01, 2.0, 3.0
LEVELS = np.array([-1.0, 0.3, 1.0, -0.4])


def run(seed: int, samples: int = 1000) -> tuple[Floats, Floats]:
    """Return input and output (n,) of y' + A0 y = B0 u."""
    u = np.repeat(np.random.default_rng(seed).choice(LEVELS, samples // 10), 10)
    pole = np.exp(-A0 * DT)
    return u, np.asarray(lfilter([0.0, B0 / A0 * (1 - pole)], [1.0, -pole], u))


def identified(u: object, y: object = None, encoder: Encoder | None = None) -> pmfid.Result:
    dt = None if y is None else DT
    return pmfid.identify(u, y, model=TransferFunction(1, 0), dt=dt, encoder=encoder, cutoff=5.0)  # type: ignore[call-overload, no-any-return]


@pytest.mark.parametrize("resolution", [0.05, 0.01, 0.001])
def test_counts_are_scaled_by_the_encoder(resolution: float) -> None:
    """The counts were taken for the output, with b0 = 60.3 for each resolution."""
    u, y = run(1)
    found = identified(u, quantize(y, resolution), Encoder(resolution))
    assert found["b0"] == pytest.approx(B0, rel=0.005)
    assert found["a0"] == pytest.approx(A0, rel=0.005)
    assert found.status == ()


RESONANT = ([8.0], [1.0, 1.6, 16.0])


def second_order(place: float, noise: Floats | float = 0.0) -> pmfid.Result:
    """Identify 8 / (s^2 + 1.6 s + 16) from 20 levels, with the zero at a place within a count and noise in counts."""
    u = prbs(2000, clock=25, amplitude=1.0, rng=np.random.default_rng(7))
    y = simulate_process(*RESONANT, u, DT)
    resolution = float(np.ptp(y)) / 20
    counts = np.rint(y / resolution + noise + place).astype(int)
    return pmfid.identify(u, counts, model=TransferFunction(2, 0), dt=DT, encoder=Encoder(resolution), cutoff=5.0)


@pytest.mark.parametrize("place", [0.0, 0.3, -0.45])
def test_rounding_is_no_noise(place: float) -> None:
    """Twenty levels gave 1 to 3 % and "unmodelled", because the rounding repeats with the input."""
    found = second_order(place)
    assert found.status == ()
    error = found.theta - [16.0, 1.6, 8.0]
    assert np.all(np.abs(error) < 3 * found.theta_std)
    assert np.all(found.theta_std < 2e-3 * found.theta)


@pytest.mark.parametrize("size", long_unless((0.004).__eq__, [0.001, 0.004, 0.02]))
def test_noise_far_below_a_count_is_in_the_error_bars(size: float) -> None:
    """Noise makes the region of the counts too small, and errors were up to 300 error bars."""
    for seed in range(4):
        found = second_order(0.0, size * np.random.default_rng(seed).standard_normal(2000))
        assert np.all(np.abs(found.theta - [16.0, 1.6, 8.0]) < 3.5 * found.theta_std)


def test_a_log_that_rounds_its_output_needs_no_resolution() -> None:
    u, y = run(3)
    found = identified(u, np.round(y, 1))
    assert found.status == ()
    assert np.all(np.abs(found.theta - [A0, B0]) < 3 * found.theta_std)
    assert np.all(found.theta_std < 1e-3 * found.theta)


def test_a_model_of_too_low_order_explains_no_count() -> None:
    u = prbs(2000, clock=25, amplitude=1.0, rng=np.random.default_rng(7))
    y = np.round(simulate_process([6.0], [1.0, 5.0, 6.0], u, DT), 1)
    fit = SRIVC(TransferFunction(1, 0), Encoder(0.1), DT, 5.0).fit(u, quantize(y, 0.1))
    assert not fit.explained


@pytest.mark.long
def test_an_interval_of_a_transfer_function_holds_the_truth() -> None:
    inside = np.zeros(2)
    for seed in range(20):
        u, y = run(seed)
        found = identified(u, y + 0.02 * np.random.default_rng(seed).standard_normal(y.size))
        low, high = found.interval_95.T
        inside += (low <= [A0, B0]) & (high >= [A0, B0])
    assert inside.min() >= 16  # 95 % less three standard deviations


def test_a_record_chooses_the_cutoff_of_an_export() -> None:
    """The command ended in a traceback."""
    u, y = run(1)
    record = {"input": "u", "output": "y", "output_kind": "counts", "dt": DT}
    model = {"kind": "transfer_function", "n": 1, "m": 0}
    axis = Axis.model_validate({"record": record, "encoder": {"resolution": 0.01}, "model": model})
    assert 0.1 < drive_estimator(axis, Record(u, quantize(y, 0.01), DT, 0.01, (), "")).cutoff < 50


def cart(u: Floats, **settings: object) -> pmfid.Result:
    counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    encoder = Encoder(CART_RESOLUTION)
    model = Drive(CART.input_gain)
    return pmfid.identify(u, counts, model=model, dt=CART_DT, encoder=encoder, cutoff=20.0, **settings)  # type: ignore[arg-type]


BINARY = prbs(1000, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
NOISE = 0.1 * np.random.default_rng(2).standard_normal(1000)


@pytest.mark.parametrize(
    ("u", "level"),
    [
        (BINARY, "±4"),
        (np.where(BINARY > 0, 3.0, -5.0), "-5 and 3"),
        (np.where(np.arange(1000) < 150, 0.0, BINARY), "±4"),
        (BINARY + NOISE, "±4."),
    ],
)
def test_an_input_of_one_level_does_not_show_the_amplifier(u: Floats, level: str) -> None:
    """An amplifier that clips at 80 % gave 25 % more mass, and nothing was said about the gain."""
    found = cart(u)
    notes = [finding for finding in found.findings if finding.code == "gain_level"]
    sentence = f"all parameters scale with the gain at the input {level.rstrip('.')}"
    assert sentence[:-2] in notes[0].sentence
    assert found.status == ()
    for text in (str(found), str(found.to_dict()["notes"])):
        assert notes[0].sentence in text
