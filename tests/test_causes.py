"""Sets of changes are compared by their marginal likelihood: several at once, the gain, the scale of the encoder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmfid import Drive
from pmfid.models.equation import Equation
from pmfid.monitor.calibration import Calibration, calibrate
from pmfid.monitor.cause import Cause, ChangeEvidence, candidates_of, compare, explain
from pmfid.monitor.events import Alarm, Settled, Watch
from pmfid.monitor.monitor import Monitor
from pmfid.simulation import CART, CART_DT, Schedule, position_control, quantize, resolution_of
from pmfid.simulation.scenarios import CART_CONTROL
from studies.alarms import NAMES, bench
from studies.monitoring.axis import make_riv, normal_work, random_stop_and_go
from tests.conftest import TRUTH

PLAIN = Drive(2.0).equation
INCREMENTS, WHEN = 1024, 12.0


def found(factors: list[float], percent: float = 1.0, equation: Equation = PLAIN) -> Cause:
    """Explain an estimate whose parameters are known to a standard deviation."""
    theta = np.ones(len(factors)) if equation is not PLAIN else TRUTH
    covariance = np.diag((percent / 100 * theta) ** 2)
    return explain(ChangeEvidence(theta * factors, covariance), theta, equation, 0.02)


@pytest.mark.parametrize(
    ("factors", "changes"),
    [
        ([1.1, 1, 1], {"mass": 0.1}),
        ([1, 1.15, 1.15], {"friction": 0.15}),
        ([1.1, 1, 1.1], {"mass": 0.1, "coulomb_friction": 0.1}),
        ([1.3, 1, 1.2], {"mass": 0.3, "coulomb_friction": 0.2}),
        ([1.1, 1.2, 1.5], {"mass": 0.1, "viscous_friction": 0.2, "coulomb_friction": 0.5}),
        ([1 / 0.9] * 3, {"input_gain": -0.1}),
        ([4, 4, 1], {"encoder_scale": -0.75}),
        ([1 / 1.1, 1 / 1.1, 1], {"encoder_scale": 0.1}),
    ],
)
def test_each_set_of_changes_is_named_with_its_sizes(factors: list[float], changes: dict[str, float]) -> None:
    cause = found(factors)
    assert {one.parameter: one.relative for one in cause.changes} == pytest.approx(changes, abs=0.01)
    assert all(one.relative_std < 0.02 for one in cause.changes)


def test_causes_with_the_same_effect_are_all_named() -> None:
    assert found([1.1, 1, 1.1]).others == ("input_gain and viscous_friction",)
    assert found([1.1, 1.3, 1]).others == ("encoder_scale and mass", "encoder_scale and viscous_friction")
    viscous = replace(PLAIN, unknown=PLAIN.unknown[:2])
    alike = found([1.25, 1.25], equation=viscous)
    assert (alike.names, alike.others[0]) == (("input_gain",), "encoder_scale")
    assert found([1.1, 1.1, 1]).others == ("mass and viscous_friction",)
    assert found([1.2, 1, 1], percent=8).others, "a vague estimate excludes little"


def test_the_likelihood_is_that_of_a_gaussian_prior() -> None:
    """The odds of two sets agree with the density of the deviation under both priors."""
    from scipy.stats import multivariate_normal

    from pmfid.monitor.tuning import TUNING

    covariance, deviation = np.diag([1e-3, 2e-3, 3e-3]) + 5e-4, np.array([0.1, 0.02, 0.15])
    information = np.linalg.inv(covariance)
    candidates = candidates_of(PLAIN, TRUTH, information)
    odds = {one.sets[0]: one.log_odds for one in compare(information, information @ deviation, candidates, 0.02)}

    def log_density(columns: list[int]) -> float:
        chosen = np.diag(np.isin(np.arange(3), columns).astype(float))
        parts = [covariance + 1e-4 * np.eye(3) + spread**2 * chosen for spread in TUNING.cause_spreads]
        return float(np.log(sum(multivariate_normal.pdf(deviation, cov=part) for part in parts)))

    apart = odds["mass", "coulomb_friction"] - odds["mass",]
    assert apart == pytest.approx(log_density([0, 2]) - log_density([0]) + np.log(TUNING.cause_further))


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    u, counts = normal_work(7, INCREMENTS, 0.1)
    return calibrate(make_riv(INCREMENTS), TRUTH, u, counts)


def alarm_after(calibration: Calibration, seed: int, scale: float = 1.0, **factors: float) -> Alarm:
    """Return the first alarm of a cart whose parameters, or whose encoder, change after twelve seconds."""
    rng, resolution = np.random.default_rng(seed), resolution_of(INCREMENTS)
    after = replace(CART, **{name: factor * getattr(CART, name) for name, factor in factors.items()})
    reference = random_stop_and_go(2200, rng)
    plant = Schedule(((0.0, CART), (WHEN, after)))
    motion, _ = position_control(plant, reference, CART_DT, **CART_CONTROL, resolution=resolution, phase=0.0)
    x, k = np.array(motion.x), round(WHEN / CART_DT)
    x[k:] = x[k] + scale * (x[k:] - x[k])
    rows = Monitor(make_riv(INCREMENTS, TRUTH), calibration, Watch()).run(
        motion.u, quantize(x, resolution, 0.3 * resolution)
    )
    return next(event for _, _, event in rows.events if isinstance(event, Alarm))


@pytest.mark.parametrize("seed", [1, 2])
def test_two_changes_at_once_are_one_alarm_with_both(calibration: Calibration, seed: int) -> None:
    """Only one was once named, with a size up to 2.7 times too large."""
    alarm = alarm_after(calibration, seed, mass=1.2, viscous_friction=1.4)
    assert {one.parameter for one in alarm.changes} == {"mass", "viscous_friction"}
    truth = {"mass": 0.2, "viscous_friction": 0.4}
    assert all(abs(one.relative - truth[one.parameter]) < 3 * one.relative_std for one in alarm.changes)
    alarm = alarm_after(calibration, seed, viscous_friction=1.15, coulomb_friction=1.15)
    assert alarm.parameter == "friction"
    assert abs(alarm.relative - 0.15) < 3 * alarm.changes[0].relative_std


def test_an_encoder_of_four_times_the_step_is_no_mass(calibration: Calibration) -> None:
    """The alarm was once "mass +340 %"."""
    alarm = alarm_after(calibration, 1, scale=0.25)
    assert (alarm.parameter, alarm.unit, alarm.others) == ("encoder_scale", "", ("mass and viscous_friction",))
    assert alarm.relative == pytest.approx(-0.75, abs=0.02)
    assert alarm.advice.startswith("Check the resolution of the encoder")


@pytest.mark.parametrize(("name", "factor"), [("coulomb_friction", 1.1), ("mass", 0.8)])
def test_the_new_reference_and_its_cause_are_right(name: str, factor: float) -> None:
    """The model once kept its first, wrong friction, so that the new reference was wrong and a false alarm followed."""
    machine, when = bench("stage"), 40 * bench("stage").move
    changed = replace(machine.drive, **{name: factor * getattr(machine.drive, name)})
    record = machine.record(Schedule(((0.0, machine.drive), (when, changed))), 90, np.random.default_rng(7))
    events = [event for *_, event in Monitor(machine.estimator(), machine.calibration(), Watch()).run(*record).events]
    settled = next(event for event in events if isinstance(event, Settled))
    assert np.all(np.abs(settled.theta - [getattr(changed, one) for one in NAMES]) < 4 * settled.std)
    assert [one.parameter for one in settled.changes] == [name]
    assert sum(isinstance(event, Alarm) for event in events) == 1
