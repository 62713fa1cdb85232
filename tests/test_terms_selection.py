"""The terms that a search keeps: a lag besides a dead time, the simpler of two, no worse predictions, pairs."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np
import pytest

import pmfid
from pmfid.diagnostics import term_fits
from pmfid.diagnostics import terms as rules
from pmfid.diagnostics import verdict as said
from pmfid.diagnostics.matter import Matter
from pmfid.diagnostics.term_fits import Bench, shortest_part
from pmfid.diagnostics.term_trials import Trial, known_shapes
from pmfid.diagnostics.terms import is_worse, removable, search
from pmfid.estimators.configuration import like
from pmfid.estimators.output_error import IntervalML
from pmfid.findings import Finding
from pmfid.pipeline import terms as session
from pmfid.pipeline.arrays import axis_of
from pmfid.pipeline.drives import Drives
from pmfid.pipeline.terms import TermSearch
from pmfid.records.record import record_of
from pmfid.report.terms import term_rows
from pmfid.simulation import DriveParameters, Machine, drive_machine, prbs
from studies.term_machines import KINDS, TERMS, kind_of, machine_of, truths
from tests.test_terms import CUTOFF, DRIVE, DT, GAIN, STEP, Made, made, searched

METHOD = IntervalML(pmfid.Drive(GAIN), pmfid.Encoder(STEP), DT, CUTOFF)


#: Slow filters chosen from the record, and given filters.
SLOW, FIXED = (axis_of(pmfid.Drive(GAIN), pmfid.Encoder(STEP), DT, {"cutoff": cutoff}) for cutoff in (None, 1.0))


@pytest.fixture(scope="module")
def lagging() -> Made:
    return made("stop-and-go", samples=2400, lag=4e-3)


@pytest.fixture(scope="module")
def lag(lagging: Made) -> TermSearch:
    return searched(lagging)


@pytest.fixture(scope="module")
def loaded() -> TermSearch:
    machine = Machine(DriveParameters(DRIVE.mass, DRIVE.viscous_friction, DRIVE.coulomb_friction, GAIN, 0.01))
    rng = np.random.default_rng(4)
    run = drive_machine(machine, prbs(2400, clock=25, amplitude=0.7, rng=rng), DT, STEP)
    return searched(Made(machine, run.u, run.counts))


def size_of(found: TermSearch, name: str) -> tuple[float, float]:
    values = {own[0]: own[1:3] for one in found.weighed for own in one.values if one.kept}
    return values[name]


# --- late inputs ------------------------------------------------------------------------------------------------------


def test_a_lag_is_judged_as_it_was_found(lag: TermSearch) -> None:
    """The search once took the mass for the lag and asked for `lag = 0`."""
    best = lag.chosen.trial.best
    known = known_shapes(best)
    assert known.difference.equation.lag == pytest.approx(4e-3, rel=0.02)
    assert known.difference(known.q) == pytest.approx(best.difference(best.q))
    assert set(lag.added) == {"lag"}
    assert not {"unmodelled", "dead_time", "not_followed"} & set(lag.status)


def test_a_search_goes_on_from_the_lines_that_it_has_printed(lag: TermSearch, lagging: Made) -> None:
    """A model with an estimated lag was once refused."""
    assert 'lag = "estimate"' in lag.lines
    again = searched(lagging, model=lag.model)
    assert again.added == {}
    assert again.chosen.trial.theta == pytest.approx(lag.chosen.trial.theta, rel=1e-3)


@pytest.mark.parametrize(("there", "other"), [("dead_time", "lag"), ("lag", "dead_time")])
def test_each_way_of_being_late_is_tried_next_to_the_other(there: str, other: str, lag: TermSearch) -> None:
    trial = dataclasses.replace(lag.chosen.trial, model=pmfid.Drive(GAIN, **{there: "estimate"}))  # type: ignore[arg-type]
    assert [one.change for one in rules._otherwise_late(trial)] == [{other: "estimate"}]
    both = dataclasses.replace(trial, model=pmfid.Drive(GAIN, dead_time="estimate", lag="estimate"))
    assert not rules._otherwise_late(both)


def test_a_lag_that_no_drive_has_is_no_fit(lag: TermSearch, lagging: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    """A search once ended with an error if a fit passed through such a lag."""
    bench, model = Bench(METHOD, lagging.u, lagging.counts), pmfid.Drive(GAIN, lag="estimate")
    monkeypatch.setattr(term_fits, "MOST_LATE", 1)
    with pytest.raises(pmfid.NotIdentifiableError, match="settles nowhere"):
        bench.further(lag.terms.trials[0], {"lag": model.lag})


@pytest.mark.long
def test_a_dead_time_and_a_lag_are_found_together() -> None:
    found = searched(made(samples=2400, dead_time=3e-3, lag=5e-3))
    assert set(found.added) == {"dead_time", "lag"}
    for name, true in (("dead_time", 3e-3), ("lag", 5e-3)):
        value, bar = size_of(found, name)
        assert abs(value - true) < max(3 * bar, 1e-3 * true)


# --- kept terms -------------------------------------------------------------------------------------------------------


def test_a_load_is_no_directional_friction(loaded: TermSearch) -> None:
    """A load and directional friction explain every count. Directional friction, which was once named, has one
    parameter more.
    """
    assert loaded.added == {"offset": True}
    assert "ambiguous_term" not in loaded.status
    assert size_of(loaded, "offset")[0] == pytest.approx(0.01, rel=0.01)


@pytest.mark.long
def test_a_term_that_predicts_worse_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """A term was once kept although its predictions were worse, by up to 1.5 times the error that chance gives."""
    record = made(samples=1800, asymmetry=0.15)
    own, model = Bench.elsewhere, pmfid.Drive(GAIN)

    def elsewhere(bench: Bench, trial: Trial) -> float:
        return own(bench, trial) if trial.model == model else 1.05 * own(bench, first)

    bench = Bench(METHOD, record.u, record.counts)
    first = bench.first(model)
    assert search(bench, model, scan=False).added
    monkeypatch.setattr(Bench, "elsewhere", elsewhere)
    found = search(bench, model, scan=False)
    assert found.added == {}
    assert any(step.verdict == rules.WORSE and is_worse(step.error, step.without) for step in found.steps[0])


def test_a_term_that_turns_out_to_predict_worse_goes_again(monkeypatch: pytest.MonkeyPatch) -> None:
    record = made(samples=1800, asymmetry=0.15)
    monkeypatch.setattr(rules, "is_worse", lambda error, before: False)
    bench = Bench(METHOD, record.u, record.counts)
    kept = search(bench, pmfid.Drive(GAIN), scan=False)
    (step,) = kept.without
    assert step.kept
    assert step.gain > step.needed
    calls = iter([False])  # the term does not worsen the prediction at its trial, but later
    monkeypatch.setattr(rules, "is_worse", lambda error, before: next(calls, True))
    found = search(bench, pmfid.Drive(GAIN), scan=False)
    assert found.added == {}
    assert found.steps[1][0].verdict == rules.DROPPED


@pytest.mark.long
def test_two_terms_are_tried_at_once_where_no_single_one_suffices(monkeypatch: pytest.MonkeyPatch) -> None:
    record = made("stop-and-go", samples=2400, asymmetry=0.15, stiffness=0.01)
    own = rules.find_objection

    def against(step: Any, found: Any) -> str:
        return "refused" if len(set(step.candidate.change) - {"offset"}) == 1 else own(step, found)

    monkeypatch.setattr(rules, "find_objection", against)
    found = search(Bench(METHOD, record.u, record.counts), pmfid.Drive(GAIN), scan=False)
    assert set(found.added) == {"friction", "spring"}
    assert {step.candidate.key for step in found.without} == {"friction", "spring"}


def test_a_term_that_was_as_good_is_compared_again_in_the_end(lag: TermSearch, lagging: Made) -> None:
    """While Stribeck friction was missing, a lag and a dead time explained equally much, and this was once the
    verdict.
    """
    bench = Bench(lag.chosen.trial.method, lagging.u, lagging.counts)
    under_way = rules._Search(bench, (), False, list(lag.terms.trials), list(lag.terms.errors), lambda part: None)
    kept = lag.terms.steps[0][0]
    other = dataclasses.replace(
        kept, candidate=dataclasses.replace(kept.candidate, change={"dead_time": "estimate"}), verdict=rules.EITHER
    )
    found = dataclasses.replace(lag.terms, steps=((kept, other),))
    assert found.either == ((kept, other),)
    assert under_way._resolve_alternatives(found).either == ()


def test_a_pitch_whose_quick_fit_goes_astray_is_fitted_as_others_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """While Stribeck friction was missing, no pitch was continued from, and cogging was once not found."""
    record = made(samples=1800, cogging=0.012, cogging_pitch=1.3, cogging_phase=1.0)
    monkeypatch.setattr(Bench, "pitches", lambda bench, trial: [])
    monkeypatch.setattr(Bench, "scan_pitches", lambda bench, trial: [1.3])
    found = search(Bench(METHOD, record.u, record.counts), pmfid.Drive(GAIN))
    assert found.added == {"cogging": pytest.approx(1.3, rel=0.01)}


def test_a_load_takes_the_place_of_directional_friction_that_explains_no_more(loaded: TermSearch) -> None:
    """While a lag was missing, directional friction explained more than a load, and once stayed after the lag came."""
    trial = loaded.chosen.trial
    u, counts = trial.difference.u, np.round((trial.difference.y) / STEP).astype(np.int64)
    bench = Bench(trial.method, u, counts)
    both = bench.further(trial, rules.DIRECTIONAL)
    under_way = rules._Search(
        bench, (), False, [loaded.terms.trials[0], both], [*loaded.terms.errors[:1], math.inf], lambda part: None
    )
    assert [step.candidate.key for step in under_way._drop_superfluous()] == ["offset"]
    assert under_way.trials[-1].model == pmfid.Drive(GAIN, offset=True)


def test_each_term_is_left_out_by_itself() -> None:
    first, last = pmfid.Drive(1.0, offset=True), pmfid.Drive(1.0, friction="directional", stribeck="estimate")
    assert removable(first, last) == [dict(rules.DIRECTIONAL), {"stribeck": "estimate"}]
    assert removable(pmfid.Drive(1.0), pmfid.Drive(1.0, offset=True, lag="estimate")) == [
        {"offset": True},
        {"lag": "estimate"},
    ]


@pytest.mark.parametrize("part", [201, 205, 300])
def test_without_a_cutoff_the_filters_leave_parts_to_predict(part: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The slow filters that the record prefers were once refused with the advice to set faster ones."""
    data = record_of({"u": np.zeros(6 * part), "y": np.zeros(6 * part)}, SLOW)
    monkeypatch.setattr(Drives, "prepare_axis", lambda drives, data, axis: FIXED)
    cutoff = session._fast_enough(data, SLOW).estimator.pole
    assert shortest_part(like(IntervalML, METHOD, cutoff=cutoff)) == part
    assert session._fast_enough(data, FIXED) == FIXED


# --- output ----------------------------------------------------------------------------------------------------------


def test_each_term_has_a_value_a_bar_and_both_errors(loaded: TermSearch) -> None:
    header, rows = term_rows(loaded)
    assert header[:3] == ["set", "value", "verdict"]
    kept = [row for row, one in zip(rows, loaded.weighed, strict=True) if one.kept]
    assert [row[0] for row in kept] == ["offset = true"]
    assert kept[0][1].startswith("offset 0.01")
    assert " ± " in kept[0][1]
    held_out, without = map(float, kept[0][3].split(" / "))
    assert held_out < without
    refused = [row[0] for row, one in zip(rows, loaded.weighed, strict=True) if not one.kept]
    assert 'friction = "directional",\noffset = false' in refused
    assert loaded.chosen.error == pytest.approx(loaded.weighed[0].with_it)
    written = json.loads(json.dumps(loaded.to_json(), allow_nan=False))["terms"]
    assert [one["set"] for one in written if one["kept"]] == ["offset = true"]


def test_no_advice_on_the_model_stands_next_to_its_lines(monkeypatch: pytest.MonkeyPatch, lagging: Made) -> None:
    advice = (Finding("unmodelled", "set quadratic = true"), Finding("dead_time", "set lag = 0"))
    monkeypatch.setattr(said, "judge", lambda *arguments: advice)
    monkeypatch.setattr(said, "matter_of", lambda *arguments: Matter("mass", 0.1, True))
    found = searched(lagging)
    assert not any("set " in note for note in found.notes)
    assert "unmodelled" in found.status


def test_a_search_says_how_far_it_is() -> None:
    record, reported = made(samples=1800, asymmetry=0.15), list[float]()
    search(Bench(METHOD, record.u, record.counts), pmfid.Drive(GAIN), scan=False, done=reported.append)
    assert reported == sorted(reported)
    assert reported[-1] == 1.0
    assert len(reported) >= 3


# --- the machines of the study ----------------------------------------------------------------------------------------


@pytest.mark.long
def test_machines_of_the_study_have_their_terms_alone() -> None:
    assert [len(one) for one in truths()].count(2) == 24
    assert set().union(*truths()) == set(TERMS)
    plain = Machine(machine_of(0, 0)[0].drive)
    for number in range(len(truths())):
        bench, machine, record, motion = machine_of(number, 0)
        assert kind_of(number) in KINDS
        assert record.u.size == record.counts.size == bench.samples, motion
        fields = {field.name for field in dataclasses.fields(Machine)} - {"drive"}
        own = {name for name in fields if getattr(machine, name) != getattr(plain, name)}
        assert bool(own or machine.drive.offset) == bool(truths()[number])
        assert math.isfinite(float(np.sum(record.u)))
