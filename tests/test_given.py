"""An unknown gain of the input, found by a known force; given values, and priors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from scipy.optimize import least_squares

import pmfid
from pmfid.estimators.known import Facts, Known, Posterior, combine
from pmfid.monitor.calibration import Calibration, calibrate
from pmfid.monitor.events import Alarm, Settled, Watch
from pmfid.monitor.monitor import Monitor
from pmfid.pipeline.result import DriveResult
from pmfid.simulation import CART, DriveParameters, Schedule, prbs, quantize, simulate_drive
from pmfid.simulation.scenarios import change_parameters
from pmfid.types import Floats
from studies.friction_axes import BENCHES
from studies.machines import Axis, machine_record
from studies.monitoring.axis import changing, make_riv, normal_work
from studies.paper.truth import CartRecord
from tests.conftest import long_unless
from tests.refusals import refused

NAMES = ("mass", "viscous_friction", "coulomb_friction")


def identified(axis: Axis, record: CartRecord, gain: float | str = "estimate", **settings: object) -> DriveResult:
    encoder, cutoff = pmfid.Encoder(record.resolution), 1 / (3 * axis.dt)
    model = pmfid.Drive(gain)  # type: ignore[arg-type]
    result = pmfid.identify(
        record.u, record.counts, model=model, encoder=encoder, dt=axis.dt, cutoff=cutoff, **settings
    )
    assert isinstance(result, DriveResult)
    return result


# --- the map ----------------------------------------------------------------------------------------------------------


def some_estimate(seed: int = 4) -> tuple[Floats, Floats]:
    """Return an estimate of four parameters with a random covariance; the last parameter is no force."""
    rng = np.random.default_rng(seed)
    size = np.array([0.03, 0.4, 0.05, 0.002])
    root = rng.normal(size=(4, 4)) * 0.02
    return size, root @ root.T * np.outer(size, size)


FORCES = np.array([True, True, True, False])


@pytest.mark.parametrize(
    ("index", "value", "std", "free"),
    [
        ([0, 2, 4], [0.9, 1.6, 31.0], [1e-9, 0.05, 0.4], True),
        ([0, 1, 3], [0.93, 11.0, 0.00205], [0.02, 0.5, 1e-5], True),
        ([0, 3], [0.0303, 0.00199], [0.0004, 2e-5], False),
    ],
)
def test_the_map_is_the_maximum_a_posteriori(
    index: list[int], value: list[float], std: list[float], free: bool
) -> None:
    """A search gives the same maximum, and its curvature gives the covariance."""
    theta, covariance = some_estimate()
    whiten = np.linalg.cholesky(np.linalg.inv(covariance)).T

    def rest(x: Floats) -> Floats:
        gain = x[4] if free else 1.0
        own = np.where(FORCES, x[:4] / gain, x[:4])
        facts = [(x[i] - m) / s for i, m, s in zip(index, value, std, strict=True)]
        return np.r_[whiten @ (own - theta), facts, [] if free else [x[4] - 1.0]]

    facts = Facts(np.array(index), np.array(value), np.array(std), FORCES, free)
    found = combine(theta[None], covariance[None], np.zeros((1, 4)), facts)
    first = np.where(FORCES, 30.0 if free else 1.0, 1.0) * theta
    best = least_squares(
        rest, np.r_[first, 30.0 if free else 1.0], x_scale=np.r_[first, 1.0], xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    assert found.theta[0] == pytest.approx(best.x, rel=1e-6)
    deviation = np.sqrt(np.diagonal(np.linalg.inv(best.jac.T @ best.jac)))
    kept = 5 if free else 4
    # neither side has second derivatives, and the search has differences of derivatives
    assert np.sqrt(np.diagonal(found.noise[0]))[:kept] == pytest.approx(deviation[:kept], rel=0.02, abs=2e-9)


def posterior(theta: Floats, covariance: Floats) -> Posterior:
    return Posterior(NAMES, ("kg", "N s/m", "N"), theta, covariance)


def known(find_gain: bool = False, gain: float = 1.0, **facts: Mapping[str, object]) -> Known:
    front = pmfid.IV(pmfid.Drive(gain), pmfid.Encoder(1e-5), 0.001, 100.0)
    return Known(front, find_gain=find_gain, **facts)  # type: ignore[arg-type]


def test_model_spread_weighs_and_is_in_no_error_bar_for_noise() -> None:
    alone = posterior(np.array([1.0, 5.0, 2.0]), np.diag([1e-6, 0.01, 0.01]))
    found = known(prior={"mass": (1.3, 0.1)}).combine(alone, np.array([0.2, 0.0, np.nan]))
    assert found["mass"] == pytest.approx(1.0 + 0.3 * (0.04 + 1e-6) / (0.05 + 1e-6))
    assert found.model_spread is not None
    assert found.model_spread[0] == pytest.approx(0.2 * 0.2, rel=1e-3)
    assert found.theta_std[0] == pytest.approx(0.8 * 0.1, rel=1e-3)
    assert np.isnan(found.model_spread[2])


@pytest.mark.parametrize(
    ("facts", "said"),
    [
        ({"given": {"maas": 1.0}}, "did you mean 'mass'"),
        ({"given": {"mass": 1.0}, "prior": {"mass": (1.0, 0.1)}}, "remove one of them"),
        ({"prior": {"mass": (1.0,)}}, "a mean and a standard deviation"),
        ({"prior": {"mass": (1.0, -0.1)}}, "a mean and a standard deviation"),
        ({"given": {"mass": float("nan")}}, "must be a number"),
        ({"given": {"mass": -1.0}}, "never negative"),
        ({"given": {"input_gain": 1.0}}, "not a parameter"),
        ({"find_gain": True}, "give one of mass"),
        ({"find_gain": True, "given": {"coulomb_friction": 0.0}}, "a value other than 0"),
        ({"find_gain": True, "prior": {"input_gain": (2.0, 0.0)}}, "nothing remains to be estimated"),
    ],
)
def test_what_cannot_be_known_is_refused(facts: dict[str, object], said: str) -> None:
    refused((said, lambda: known(**facts)))  # type: ignore[arg-type]


# --- machines ---------------------------------------------------------------------------------------------------------

CASES = [("motor", "prbs", 4096), ("spindle", "stop-and-go", 1024), ("gantry", "prbs", 256), ("slide", "prbs", 512),
         ("heavy", "stop-and-go", 2048)]  # fmt: skip


@pytest.fixture(scope="module")
def records() -> dict[str, CartRecord]:
    return {name: machine_record(BENCHES[name], "nothing", motion, n, 21) for name, motion, n in CASES}


@pytest.mark.parametrize("method", ["iv", "auto"])
@pytest.mark.parametrize("name", [name for name, *_ in CASES])
@pytest.mark.long
def test_the_gain_is_found_within_its_bar(records: dict[str, CartRecord], name: str, method: str) -> None:
    axis = BENCHES[name]
    result = identified(axis, records[name], method=method, given={"mass": axis.drive.mass})
    gain = axis.drive.input_gain
    assert result["input_gain"] == pytest.approx(gain, rel=0.01)
    assert result["mass"] == axis.drive.mass
    bar = result.theta_std[-1]
    spread = result.model_spread[-1] if result.model_spread is not None else 0.0
    assert abs(result["input_gain"] - gain) < 4 * np.hypot(bar, spread)
    assert result.estimator.equation.input_gain == result["input_gain"]


@pytest.mark.parametrize(
    "method",
    long_unless(("bcls", "riv").__contains__, ["ls", "bcls", "iv", "fit", "rls", "riv"]),
)
def test_it_is_the_estimate_with_any_other_gain_in_proportion(records: dict[str, CartRecord], method: str) -> None:
    axis, record = BENCHES["slide"], records["slide"]
    wrong = identified(axis, record, 1.3 * axis.drive.input_gain, method=method)
    found = identified(axis, record, method=method, given={"mass": axis.drive.mass})
    factor = axis.drive.mass / wrong["mass"]
    assert found["input_gain"] == pytest.approx(1.3 * axis.drive.input_gain * factor, rel=1e-5)
    assert found["coulomb_friction"] == pytest.approx(wrong["coulomb_friction"] * factor, rel=1e-5)
    assert found.theta_std[-1] / found["input_gain"] == pytest.approx(wrong.theta_std[0] / wrong["mass"], rel=1e-3)
    assert set(found.status) == set(wrong.status)


# --- on-line ----------------------------------------------------------------------------------------------------------


def slipping(axis: Axis, part: float, at: float, ramp: float = 0.0, seed: int = 3) -> CartRecord:
    rng = np.random.default_rng(seed)
    n = 3 * axis.samples
    u = prbs(n, clock=axis.clock, amplitude=axis.volt, rng=rng)
    steps = change_parameters(axis.drive, at, input_gain=part * axis.drive.input_gain).changes
    x = simulate_drive(Schedule(steps, (0.0, ramp)), u, axis.dt).x
    return CartRecord(u, quantize(x, axis.resolution * 4, axis.resolution * rng.random()), axis.resolution * 4)


@pytest.mark.parametrize(
    ("name", "near", "ramp"),
    long_unless(
        lambda name, near, ramp: (name, ramp) in (("slide", 4.0), ("motor", 0.0)),
        [
            (*axis, ramp)
            for axis in (("slide", 0.01), ("gantry", 0.01), ("spindle", 0.04), ("motor", 0.08))
            for ramp in (0.0, 4.0)
        ],
    ),
)
def test_a_slipping_belt_is_followed(name: str, near: float, ramp: float) -> None:
    """The estimate is within 1 % if the memory suffices. A memory of half a second of a small motor only allows the
    error bar.
    """
    axis = BENCHES[name]
    n, memory = 3 * axis.samples, 0.06 * 3 * axis.samples * axis.dt
    at = n * axis.dt / 3
    record = slipping(axis, 0.7, at, min(ramp, at))
    settings = {"method": "riv", "forgetting": 1 - axis.dt / memory, "given": {"mass": axis.drive.mass}}
    result = identified(axis, record, **settings)
    assert result.track is not None
    gain, std = result.track["input_gain"], result.track.theta_std[:, -1]
    before = int(at / axis.dt) - 1
    for sample, true in ((before, axis.drive.input_gain), (n - 1, 0.7 * axis.drive.input_gain)):
        assert gain[sample] == pytest.approx(true, rel=near)
        assert abs(gain[sample] - true) < 3.5 * std[sample]
    assert np.all(result.track["mass"][before:] == axis.drive.mass)
    assert result["input_gain"] == gain[-1]
    assert result.theta_std == pytest.approx(result.track.theta_std[-1], rel=1e-9)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    theta = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])
    return calibrate(make_riv(1024), theta, normal_work(7, 1024, 0.05)[0], None)


def test_the_monitor_names_the_gain_and_keeps_the_mass(calibration: Calibration) -> None:
    """A given mass is never the cause of an alarm."""
    theta = calibration.theta
    schedule = Schedule(((0.0, CART), (8.0, DriveParameters(1.07, 12.8, 0.8, 1.7))))
    u, counts = changing(schedule, 5, 1024, 30.0)
    riv = make_riv(1024, theta)
    monitor = Monitor(riv, calibration, Watch(), Known(riv, given={"mass": CART.mass}, find_gain=True))
    events = [event for a, b in zip(u.tolist(), counts.tolist(), strict=True) for event in monitor.step(a, b)[1]]
    alarm = next(event for event in events if isinstance(event, Alarm))
    settled = next(event for event in events if isinstance(event, Settled))
    assert alarm.parameter == "input_gain"
    assert alarm.change == pytest.approx(-0.3, abs=0.05)
    assert settled.theta == pytest.approx([1.07, 12.8, 0.8, 1.7], rel=0.03)
    assert settled.theta[0] == settled.before[0] == CART.mass
    assert monitor.names[-1] == "input_gain"
