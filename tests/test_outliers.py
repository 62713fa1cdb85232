"""Off-line methods name and leave out samples that no motion explains, also when they simulate the whole record."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest

import pmfid
from pmfid.records.outliers import repair_record
from pmfid.records.record import Record
from studies.machines import AXES, MOTIONS, machine_record
from studies.paper.truth import CartRecord
from studies.record_parts import CART, FORCE, cart_log
from tests.conftest import long_unless

AXIS = "rotary"
#: Kind of fault -> the wrong rows of 3000, counted from 0; a jump changes all rows from there on.
FAULTS = {
    "one": [1700],
    "first": [0],
    "last": [2999],
    "two": [900, 2200],
    "two in a row": [900, 901],
    "jump": list(range(1300, 3000)),
}


@cache
def recorded(axis: str, motion: str, increments: int, wrong: str = "nothing") -> CartRecord:
    return machine_record(AXES[axis], wrong, motion, increments, 8)


def logged(counts: np.ndarray, u: np.ndarray, resolution: float = 1.0) -> Record:
    return Record(u, counts, 0.01, resolution, (), "log")


def identified(record: CartRecord, method: str) -> pmfid.pipeline.result.DriveResult:
    axis = AXES[AXIS]
    encoder = pmfid.Encoder(record.resolution)
    cutoff = 0.25 / axis.dt
    return pmfid.identify(
        record.u, record.counts, model=pmfid.Drive(0.4), dt=axis.dt, cutoff=cutoff, encoder=encoder, method=method
    )


def as_good(found: pmfid.pipeline.result.DriveResult, clean: pmfid.pipeline.result.DriveResult) -> bool:
    """Return whether the estimate is within half an error bar, or within two if auto takes another method."""
    bars = 0.5 if found.estimator.method == clean.estimator.method else 2.0
    return bool(np.all(np.abs(found.theta - clean.theta) <= bars * clean.theta_std + 1e-3 * np.abs(clean.theta)))


@pytest.mark.parametrize("size", [400, -100_000, 10**9])
@pytest.mark.parametrize("fault", FAULTS)
def test_wrong_counts_are_left_out_and_their_rows_named(fault: str, size: int) -> None:
    for motion in MOTIONS:
        for increments in (4096, 100):
            record = recorded(AXIS, motion, increments)
            counts = record.counts.copy()
            counts[FAULTS[fault]] += size
            known = repair_record(logged(counts, record.u))
            assert known.status == ("count_jump",)
            assert re.search(rf"rows? {FAULTS[fault][0] + 1}\b", known.sentence)
            off = known.record.counts - record.counts
            rough = np.abs(np.diff(record.counts, 2)).max()
            assert np.abs(off - off[50]).max() <= 1 + rough


@pytest.mark.parametrize("method", long_unless("rls".__eq__, ["auto", "iv", "rls"]))
def test_no_method_gets_a_wrong_sample(method: str) -> None:
    record = recorded(AXIS, "prbs", 1024)
    clean = identified(record, method)
    counts, u = record.counts.copy(), record.u.copy()
    counts[1700] += 100_000
    u[805] = 1e30
    found = identified(CartRecord(u, counts, record.resolution), method)
    assert {"count_jump", "invalid_input"} <= set(found.status)
    assert any("row 1701" in note for note in found.notes)
    assert any("row 806" in note for note in found.notes)
    assert found.notes.count(found.notes[0]) == 1
    assert as_good(found, clean)


def test_a_counter_that_was_reset_is_put_back() -> None:
    record = recorded(AXIS, "stop-and-go", 1024)
    counts = record.counts + 5_000_000 * (np.arange(record.counts.size) >= 1333)
    found = identified(CartRecord(record.u, counts, record.resolution), "fit")
    assert "count_jump" in found.status
    assert "at row 1334 and stay" in found.notes[0]
    assert as_good(found, identified(record, "fit"))


@pytest.mark.parametrize("axis", AXES)
def test_no_healthy_record_is_touched(axis: str) -> None:
    for wrong in ("nothing", "Stribeck 30 %"):
        for motion in MOTIONS:
            for increments in (4096 * 64, 4096, 256, 16):
                record = recorded(axis, motion, increments, wrong)
                assert repair_record(logged(record.counts, record.u)).sentence == ""


@pytest.mark.skipif(not CART.exists(), reason=f"the measured logs {CART} are absent")
def test_each_measured_log_with_shifts_at_its_reversals_has_a_mass() -> None:
    """The belt stretches at each reversal. Uniform acceleration between the reversals gives 6.6 to 6.8 kg."""
    for path in sorted(CART.glob("*.csv")):
        log = cart_log(path.stem)
        result = pmfid.identify(
            log.u, log.counts, model=pmfid.Drive(FORCE), encoder=pmfid.Encoder(log.resolution), dt=log.dt
        )
        assert "unmodelled" in result.status
        assert 5.0 < result["mass"] < 9.0
