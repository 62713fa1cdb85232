"""Faults that the checks once missed, and clean logs in which they once found a fault."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pmfid
from pmfid.findings import codes
from pmfid.pipeline.checks import check_record
from pmfid.pipeline.identify import check
from pmfid.records.outliers import repair_record
from pmfid.simulation import CART, CART_DT, quantize, simulate_drive
from studies.check_logs import ALL, Logged, clean, faulty, limited
from tests.conftest import long_unless


def found_in(log: Logged) -> tuple[str, ...]:
    return codes(check_record(log.record(), log.configuration))


@pytest.mark.parametrize("seed", long_unless((3006).__eq__, [3006, 3019]))
def test_a_velocity_is_read_as_it_stands(seed: int) -> None:
    # At 3006 the axis rests between moves, so that the mend of positions removes its steps; at 3019 the input has two
    # levels.
    assert found_in(faulty("velocity as position", seed)) == ("velocity",)


# --- stops ------------------------------------------------------------------------------------------------------------


def test_a_counter_that_catches_up_was_stuck() -> None:
    # The axis itself stops nearly as suddenly as the counter, but it never starts as suddenly.
    assert found_in(faulty("stuck counter", 1008)) == ("stuck",)


# --- short records ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lost", [1, 3])
def test_a_record_of_a_few_samples_in_a_row_is_refused(lost: int) -> None:
    """The start of the fit once failed with a traceback."""
    u, counts = np.array([9.0, -9, 9, -9, -9, 9, 9, -9, 9, 9, -9, 9]), np.arange(12) ** 2
    u[lost::4] = np.nan
    u[0] = 9.0
    with pytest.raises(pmfid.PmfidError):
        pmfid.identify(u, counts, model=pmfid.Drive(1.0), encoder=pmfid.Encoder(1e-3), dt=0.01)


def test_a_short_record_whose_input_explains_it_is_not() -> None:
    log = clean(5023)
    record = log.record()
    short = replace(record, u=record.u[:120], counts=record.counts[:120])
    assert "rate_low" not in codes(check_record(short, log.configuration))


# --- limits of the input ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("log", [faulty("saturated input", 3027), limited(3041)])
def test_an_input_at_a_limit_is_a_note_because_the_fit_judges_it(log: Logged) -> None:
    found = check_record(log.record(), log.configuration)
    assert [(one.code, one.severity) for one in found] == [("saturated", "note")]


def test_the_fit_finds_a_log_that_cuts_off_the_input() -> None:
    given = 3 * np.sin(0.05 * np.arange(1000)) + 2 * np.sin(0.13 * np.arange(1000))
    counts = quantize(simulate_drive(CART, given, CART_DT).x, 2e-4)
    settings = {"model": pmfid.Drive(CART.input_gain), "encoder": pmfid.Encoder(2e-4), "dt": CART_DT}
    cut = pmfid.identify(np.clip(given, -3.5, 3.5), counts, **settings)  # type: ignore[call-overload]
    assert "unmodelled" in cut.status
    assert pmfid.identify(given, counts, **settings).status == ()  # type: ignore[call-overload]


# --- clean logs -------------------------------------------------------------------------------------------------------


def test_a_sign_is_not_distinguished_from_what_explains_nothing() -> None:
    assert "reversed" not in found_in(clean(5020))


def test_a_motion_that_starts_with_all_its_force_has_no_wrong_first_row() -> None:
    record = clean(1037).record()
    assert repair_record(record).findings == ()
    assert repair_record(replace(record, counts=record.counts[::-1].copy())).findings == ()
    wrong = replace(record, counts=np.r_[500, record.counts[1:]])
    assert [one.code for one in repair_record(wrong).findings] == ["count_jump"]


def test_a_large_load_is_named() -> None:
    log = clean(3, {"slide": ALL["slide"]})
    heavier = {**log.columns, "u": log.columns["u"] + 3 * float(np.std(log.columns["u"]))}
    assert codes(check_record(log.record(), log.configuration)) == ()
    doubts = check(replace(log, columns=heavier).record(), log.configuration)
    assert "set offset = true" in {one.remedy for one in doubts if one.code == "unmodelled"}


def test_a_load_hides_no_other_doubt() -> None:
    """The gain differs by the sign of the input, in addition to the load."""
    u = np.repeat(np.random.default_rng(0).choice([-3.0, 0.0, 3.6, 5.0], 140), 15)
    motion = simulate_drive(CART, np.where(u > 0, 1.2, 0.8) * u - 1.4, CART_DT)
    encoder, model = pmfid.Encoder(2e-3), pmfid.Drive(CART.input_gain)
    result = pmfid.identify(u, quantize(motion.x, 2e-3), model=model, encoder=encoder, dt=CART_DT)
    assert "unmodelled" in result.status
