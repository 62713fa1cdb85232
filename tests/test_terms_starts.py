"""Starts of the search over terms: pitches, lags, and motions that begin wrongly; and its refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pmfid
from pmfid.diagnostics.term_fits import Bench
from pmfid.diagnostics.term_trials import free_pitch, scan_balance
from pmfid.diagnostics.terms import Candidate, FittedCandidate, find_objection
from pmfid.estimators.configuration import like
from pmfid.estimators.facts import check_known
from pmfid.estimators.friction_curve import friction_curve
from pmfid.estimators.iv import IV
from pmfid.estimators.ls import LS
from pmfid.estimators.motion import first_speed, rms
from pmfid.estimators.output_error import IntervalML
from pmfid.estimators.search import find_least_from_start
from pmfid.simulation import Machine
from studies.friction_axes import BENCHES
from studies.machines import record_of
from tests.test_terms import CUTOFF, DT, GAIN, STEP, made, searched

METHOD = IntervalML(pmfid.Drive(GAIN), pmfid.Encoder(STEP), DT, CUTOFF)


def test_a_motion_that_begins_at_rest_is_not_begun_with_a_speed() -> None:
    """The first counts, within stiction, show no speed.

    Least squares with cogging of a known pitch once stayed near the minimum without reaching it.
    """
    axis = BENCHES["gantry"]
    pitch = axis.stroke / 12
    machine = Machine(axis.drive, cogging=0.3 * axis.drive.coulomb_friction, cogging_pitch=pitch, cogging_phase=1.0)
    record = record_of(axis, machine, "multisine", 1024, 100)
    model, encoder = pmfid.Drive(axis.drive.input_gain, cogging=pitch), pmfid.Encoder(record.resolution)
    method = IntervalML(model, encoder, axis.dt, 1 / (3 * axis.dt))
    theta = like(IV, method).fit(record.u, record.counts).theta
    whole = method.make_difference(theta, record.u, method.position(record.counts))
    filtered = replace(whole, pole=method.cutoff, parts=2)
    speed = first_speed(filtered.y, axis.dt, method.cutoff, record.resolution)
    begin = np.r_[theta, filtered.y[0], speed] / filtered.scale
    found = find_least_from_start(filtered, begin, method.cutoff, [1e-4])
    assert rms(filtered(found)) < 0.35
    assert found[0] * filtered.scale[0] == pytest.approx(axis.drive.mass, rel=1e-3)


def test_a_balance_of_forces_sees_the_pitch_wherever_the_simulation_is() -> None:
    record = made(cogging=0.012, cogging_pitch=1.3, cogging_phase=1.0)
    travel = float(np.ptp(record.counts)) * STEP
    numbers = np.arange(4.0, 60.0, 0.25)
    found = scan_balance(LS(pmfid.Drive(GAIN), pmfid.Encoder(STEP), DT, CUTOFF), record.u, record.counts, numbers)
    assert numbers[int(np.argmax(found))] == pytest.approx(travel / 1.3, abs=0.3)
    assert 0 < float(np.max(found)) < 1


def test_a_difference_knows_its_pitch() -> None:
    record = made(samples=500)
    trial = Bench(METHOD, record.u, record.counts).first(METHOD.model)  # type: ignore[arg-type]
    model = pmfid.Drive(GAIN, cogging=1.3)
    difference = like(IntervalML, METHOD, model=model).make_difference(
        np.r_[trial.theta, 0.01, 0.0], record.u, trial.difference.y
    )
    free, q = free_pitch(difference, model), np.r_[np.ones(difference.scale.size), 0.0]
    q[-1] = free.number / 100
    assert free(q) == pytest.approx(difference(q[:-1]))
    assert free.model_at(q).cogging == pytest.approx(1.3)
    q[-1] *= 2
    assert free.model_at(q).cogging == pytest.approx(0.65)


def test_a_lag_is_tried_next_to_a_dead_time() -> None:
    found = searched(made("stop-and-go", samples=2400, lag=4e-3))
    tried = {step.candidate.key for step in found.terms.steps[0]}
    assert {"dead_time", "lag"} <= tried
    assert set(found.added) == {"lag"} or "ambiguous_term" in found.status
    late = dict(zip(names_of(found.model), found.chosen.trial.theta.tolist(), strict=True))
    assert sum(late.get(name, 0.0) for name in ("dead_time", "lag")) == pytest.approx(4e-3, rel=0.05)


def names_of(model: pmfid.Drive) -> list[str]:
    return [*model.equation.names, *dict(model.equation.further)]


def test_what_explains_every_count_needs_no_score_of_the_model_before() -> None:
    """Stribeck friction was once refused because of the scores of a model without it."""
    record = made(samples=1000)
    whole = Bench(METHOD, record.u, record.counts).first(METHOD.model)  # type: ignore[arg-type]
    assert whole.best.clean
    candidate = Candidate({"stribeck": "estimate"}, "", 6.9, 6.1, 892.0, -14586.0)
    step = FittedCandidate(candidate, whole, 440.0, 24.0, np.inf, "")
    assert find_objection(step, [step]) == ""
    partly = replace(step, trial=replace(whole, best=replace(whole.best, noise=0.3)))
    assert "not confirmed by other parts" in find_objection(partly, [partly])


def test_the_cutoff_that_a_short_record_asks_for_is_enough() -> None:
    record = made(samples=600)
    with pytest.raises(pmfid.NotIdentifiableError, match=r"a cutoff of at least ([\d.]+) rad/s") as error:
        searched(record)
    cutoff = float(str(error.value).partition("cutoff of at least ")[2].split()[0])
    assert searched(record, cutoff=cutoff).samples == 600


def test_a_mass_of_nothing_is_not_known() -> None:
    equation = pmfid.Drive(GAIN).equation
    with pytest.raises(pmfid.UsageError, match="mass is given as 0"):
        check_known(equation, {"mass": 0.0}, {}, equation.names, False)
    check_known(equation, {"mass": 1e-9, "coulomb_friction": 0.0}, {}, equation.names, False)


def test_friction_cannot_rise_from_a_speed_that_the_record_has_not() -> None:
    record = made(samples=1500)
    method = IV(pmfid.Drive(GAIN, friction="directional"), pmfid.Encoder(STEP), DT, CUTOFF)
    with pytest.raises(pmfid.UsageError, match="the fastest motion of the record"):
        friction_curve(method, record.u, record.counts, rising_from=1e4)
