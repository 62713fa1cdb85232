"""Doubts on the sample period, and remedies that a reader can follow."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

import pmfid
from pmfid import Drive, Encoder, Finding, quantize
from pmfid.actuators.fit import MORE_TERMS, advise_log
from pmfid.design import Limits, Problem, appraise, solve
from pmfid.design.appraisal import Appraisal
from pmfid.findings import codes
from pmfid.pipeline.arrays import axis_of
from pmfid.pipeline.checks.timing import odd_period
from pmfid.pipeline.checks.view import CheckedLog
from pmfid.records.record import record_of
from pmfid.report.design import criteria_table, recommendation, std_table
from pmfid.simulation import CART, CART_DT, simulate_drive
from pmfid.types import Counts, Floats
from tests.conftest import cart_run
from tests.refusals import refused

STEP = 22.75e-6
RUN = cart_run(1, samples=1000)


def log_of(u: Floats, counts: Counts, dt: float, encoder: Encoder) -> CheckedLog:
    axis = axis_of(Drive(2.0), encoder, dt, {})
    return CheckedLog(record_of({"u": u, "y": counts.astype(float)}, axis), axis)


@pytest.mark.parametrize(("dt", "meant"), [(2.0, "0.002"), (10.0, "0.01"), (1.0, "0.001"), (0.25, "0.00025")])
def test_milliseconds_read_as_seconds_are_doubted(dt: float, meant: str) -> None:
    """A period of 2 ms, written as 2, gave 4101 kg m2 without a doubt."""
    settings = {"model": Drive(2.0), "encoder": RUN.encoder, "method": "iv", "cutoff": 0.2 / dt}
    found = pmfid.identify(RUN.u, RUN.counts, dt=dt, **settings)  # type: ignore[call-overload]
    assert found.status == ("odd_period",)
    assert f"dt is in s: give {meant} if {dt:g} ms was meant" in found.findings[0].text
    assert f"with a sample period of {dt:g} s and 102 counts per row, the velocity takes" in found.findings[0].text


def test_a_period_is_doubted_by_what_the_record_shows() -> None:
    def doubts(dt: float, keep: int = 1) -> list[Finding]:
        return list(odd_period(log_of(RUN.u[::keep], RUN.counts[::keep], dt, RUN.encoder)))

    assert "unusually short for a machine" in doubts(1e-6)[0].text
    assert doubts(1e-4) == doubts(CART_DT) == doubts(20 * CART_DT, keep=20) == []


def test_a_time_column_with_a_unit_is_believed(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    pl.DataFrame({"t": 2.0 * np.arange(1000), "u": RUN.u, "n": RUN.counts}).write_csv(path)
    record = {"input": "u", "output": "n", "output_kind": "counts", "time": "t", "time_unit": "s"}
    sections = {"record": record, "encoder": {"resolution": STEP}, "model": {"input_gain": 2.0}}
    assert "odd_period" not in codes(pmfid.check(path, axis=sections))  # type: ignore[arg-type]


def logged(true: Floats, log: Floats) -> tuple[str, ...]:
    """Return the words on the input `log` of a drive that had the input `true`."""
    counts = quantize(simulate_drive(CART, true, CART_DT).x, STEP)
    return pmfid.identify(log, counts, model=Drive(CART.input_gain), dt=CART_DT, encoder=Encoder(STEP)).status


def hold(u: Floats, rows: int) -> Floats:
    return np.repeat(u[::rows], rows)[: u.size]


TIMES = np.arange(1000) * CART_DT
SMOOTH = 3.0 * np.sin(2 * TIMES) + 2.0 * np.sin(5.3 * TIMES)
RANDOM = 3.0 * np.random.default_rng(4).standard_normal(1000)


@pytest.mark.parametrize("u", [hold(RANDOM, 10), hold(SMOOTH, 20), hold(SMOOTH, 5)])
def test_a_drive_that_holds_its_input_has_no_remedy(u: Floats) -> None:
    """The advice to log the input more often cannot be followed for a profile of steps."""
    assert logged(u, u) == ()


def test_an_input_between_the_logged_values_is_found() -> None:
    assert "held_input" in logged(SMOOTH, hold(SMOOTH, 10))
    sentence = "log the input at the drive's rate"
    refused((sentence, lambda: logged(RANDOM, hold(RANDOM, 5))), kind=pmfid.NotIdentifiableError)


T = np.arange(500) * 0.02
JITTER = T + 0.002 * np.random.default_rng(5).uniform(size=500)
SINE, STEPS = np.sin(3 * T), np.repeat(np.random.default_rng(6).uniform(-1, 1, 10), 50)


@pytest.mark.parametrize(
    ("t", "goal", "advice"),
    [
        (T, SINE, "stamp each sample when the position is read, and command steps as well"),
        (T, STEPS, "stamp each sample when the position is read"),
        (JITTER, SINE, "command steps as well"),
        (JITTER, STEPS, MORE_TERMS),
    ],
)
def test_advice_on_a_servo_leaves_out_what_is_done(t: Floats, goal: Floats, advice: str) -> None:
    assert advise_log(t, goal) == advice


@pytest.fixture(scope="module")
def appraisal() -> Appraisal:
    nominal = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
    limits = Limits(input=3.0, position=(0.0, 0.4), min_speed=0.01)
    problem = Problem(Drive(2.0), nominal, tuple(nominal), 2.0, 40, limits, resolution=STEP, end=(0.4, 0.0))
    return appraise(solve(problem, "D", starts=3))


def test_the_recommended_input_is_the_first_of_the_ranking(appraisal: Appraisal) -> None:
    """The design was first, and an s curve was recommended without a reason."""
    assert appraisal.recommended == "s_curve"
    for header, rows in (criteria_table(appraisal), std_table(appraisal), std_table(appraisal, through_encoder=True)):
        assert (header[0], rows[0][0]) == ("input", "s curve")
    assert appraisal.summary().rows[0][0] == "s_curve"
    own, design = (100 * appraisal.expect_std(name)["coulomb_friction"] / 0.6 for name in ("s_curve", "design"))
    assert own < design
    assert f"Coulomb friction is {own:.3g} % after this input, and {design:.3g} %" in recommendation(appraisal)
