"""Off-line methods name and leave out samples that no motion explains, also when they simulate the whole record."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

import pmfid
from pmfid._stage import find_outliers
from pmfid.cli.main import main
from pmfid.records.outliers import repair_record
from pmfid.records.record import Record
from pmfid.simulation import CART as CART_AXIS
from pmfid.simulation import CART_DT, quantize, resolution_of, simulate_drive
from studies.glitches import KINDS, wrong_sizes
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


@pytest.mark.parametrize("method", long_unless(("auto", "rls").__contains__, ["auto", "iv", "rls"]))
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


@pytest.mark.parametrize("method", ["auto", "iv"])
def test_an_input_lost_where_it_switches_is_reported_in_the_status(method: str) -> None:
    """The lost input is unknown. For one sample, the replacement is wrong by half the switch."""
    record = recorded(AXIS, "prbs", 1024)
    u = record.u.copy()
    u[800] = -1e7
    found = identified(CartRecord(u, record.counts, record.resolution), method)
    assert "invalid_input" in found.status
    np.testing.assert_allclose(found.theta, identified(record, method).theta, rtol=0.03)


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


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("largest", [100, 10**6])
def test_one_count_of_a_hundred_is_wrong_and_the_mass_stays(kind: str, largest: int) -> None:
    """A limit from the changes of the whole record once grew with the wrong counts, up to a mass of three times the
    true one.
    """
    record, axis, rng = recorded("gantry", "prbs", 1024), AXES["gantry"], np.random.default_rng(3)
    counts = record.counts[:2000].copy()
    places = np.sort(rng.choice(2000, 20, replace=False))
    if kind == "clustered":
        places = np.unique([place + rng.choice(20, 5, replace=False) for place in places[:4] % 1900])
    counts[places] += wrong_sizes(kind, largest, places.size, rng)
    estimator = pmfid.RLS(
        pmfid.Drive(1.0), pmfid.Encoder(record.resolution, guard=False), axis.dt, 0.5 / axis.dt, forgetting=0.995
    )
    found = repair_record(logged(counts, record.u[:2000])).record.counts
    masses = [estimator.start().run(record.u[:2000], one).theta[600:, 0] for one in (record.counts[:2000], found)]
    assert np.max(np.abs(masses[1] - masses[0])) < 0.05 * axis.drive.mass


def test_wrong_counts_are_named_alone() -> None:
    record = recorded("cart", "stop-and-go", 4096)
    counts = record.counts.copy()
    places = np.arange(40, 2990, 59)
    counts[places] += np.resize([30, -300, 10**5, -(10**8)], places.size)
    found, wrong, moved = find_outliers(counts, np.arange(3000), 1.0)
    assert np.flatnonzero(wrong).tolist() == places.tolist()
    assert not moved.any()
    assert np.abs(found - record.counts).max() <= np.abs(np.diff(record.counts, 2)).max()


def test_one_shift_of_the_zero_among_wrong_counts_is_found_from_both_sides() -> None:
    record = recorded("cart", "prbs", 4096)
    counts = record.counts + 777 * (np.arange(3000) >= 1500)
    counts[[1497, 1503]] += (10**5, -400)
    _, wrong, moved = find_outliers(counts, np.arange(3000), 1.0)
    assert np.flatnonzero(wrong).tolist() == [1497, 1500, 1503]
    assert moved[1500] == pytest.approx(777, abs=int(np.abs(np.diff(record.counts, 2)).max()))


def test_the_highest_speed_is_a_hard_limit() -> None:
    """Of thirty wrong readings in a row, no two agree, and no other rule than the limit finds them."""
    record, rng = recorded("gantry", "stop-and-go", 4096), np.random.default_rng(0)
    top = 1.2 * record.resolution * np.abs(np.diff(record.counts)).max() / 0.01
    counts = record.counts.copy()
    counts[1200:1230] += rng.integers(-(10**6), 10**6, 30)
    known = repair_record(logged(counts, record.u, record.resolution), top)
    assert np.abs(known.record.counts - record.counts).max() <= 1
    assert "rows 1201, 1202, 1203, 1204 and 26 more" in known.sentence
    assert "max_speed" in known.findings[0].remedy
    assert repair_record(logged(record.counts, record.u, record.resolution), top).sentence == ""


def noisy() -> Record:
    """Return an analogue position, with noise of many counts."""
    rng = np.random.default_rng(0)
    counts = np.round(5e5 * np.sin(np.arange(20_000) / 300) + 1000 * rng.normal(size=20_000)).astype(np.int64)
    return logged(counts, np.ones(20_000))


def square(hold: int) -> Record:
    u = 3.0 * np.where(np.arange(1500) // hold % 2, -1.0, 1.0)
    return logged(quantize(simulate_drive(CART_AXIS, u, CART_DT).x, resolution_of(1024)), u)


def collision() -> Record:
    velocity = np.r_[np.full(300, 200.0), 80.0, np.full(300, -150.0), np.zeros(200)]
    return logged(np.floor(np.cumsum(velocity)).astype(np.int64), np.ones(801))


def wrapping() -> Record:
    counts = np.round(3e5 * np.sin(np.arange(3000) / 100)).astype(np.int64)
    return logged((counts + 30_000) % 2**16, np.ones(3000))


def lacking(length: int) -> Record:
    """Return a record whose values in its gaps lie on a line, and the motion does not."""
    counts, there = np.rint(300 * np.sin(0.09 * np.arange(2000))), np.ones(2000, bool)
    there[np.arange(40, 1900, 97)[:, None] + np.arange(length)] = False
    filled = np.rint(np.interp(np.arange(2000), np.flatnonzero(there), counts[there])).astype(np.int64)
    return Record(np.sin(0.09 * np.arange(2000)), filled, 0.01, 1.0, (), "log", there=there)


QUIET = [noisy, collision, wrapping, *(lambda n=n: square(n) for n in (2, 3, 5, 20, 200))]
QUIET += [lambda n=n: lacking(n) for n in (4, 16, 28)]


@pytest.mark.parametrize("make", QUIET)
def test_what_a_motion_explains_is_no_wrong_count(make: Callable[[], Record]) -> None:
    assert repair_record(make()).findings == ()


def test_short_steps_of_an_uneven_clock_are_no_jumps() -> None:
    """Within a short step, one count looks like a high speed."""
    rng = np.random.default_rng(4)
    times = np.cumsum(rng.choice([0.05, 1.0, 1.6], 2000))
    counts = np.floor(300 * np.sin(times / 60)).astype(np.int64)
    assert not find_outliers(counts, times, 1.0)[1].any()
    counts[700] += 60
    assert np.flatnonzero(find_outliers(counts, times, 1.0)[1]).tolist() == [700]


def test_a_pulse_that_the_axis_answers_is_an_input() -> None:
    """Without the response of the axis, one of few pulses would be a spike."""
    u, velocity = np.full(2000, 1e-3), np.zeros(2000)
    u[[500, 1200]] = 5.0, -5.0
    for k in range(1, 2000):
        velocity[k] = 0.97 * velocity[k - 1] + 8.0 * u[k - 1]
    counts = np.floor(np.cumsum(velocity)).astype(np.int64)
    assert repair_record(logged(counts, u)).sentence == ""
    u[900] = 4.0
    assert repair_record(logged(counts, u)).status == ("invalid_input",)


def test_the_remedy_of_the_command_works(tmp_path: Path) -> None:
    """A wrong row is reported; with `guard = false`, as the message offers, the row is kept and the record refused."""
    axis = AXES[AXIS]
    record = recorded(AXIS, "stop-and-go", 1024)
    counts = record.counts.copy()
    counts[2000] += 10**5
    pl.DataFrame({"u": record.u, "counts": counts}).write_csv(tmp_path / "log.csv")
    toml = (
        f'[record]\ninput = "u"\noutput = "counts"\noutput_kind = "counts"\ndt = {axis.dt}\n'
        f"[encoder]\nresolution = {record.resolution!r}\n[model]\ninput_gain = 0.4\n[estimator]\ncutoff = 50.0\n"
    )
    results = {}
    for name, text in (("guarded", toml), ("open", toml.replace("[model]", "guard = false\n[model]"))):
        (tmp_path / f"{name}.toml").write_text(text)
        arguments = ["identify", str(tmp_path / "log.csv"), "--config", str(tmp_path / f"{name}.toml"), "--json"]
        results[name] = CliRunner().invoke(main, arguments)
    assert results["guarded"].exit_code == 0, results["guarded"].output
    printed = json.loads(results["guarded"].stdout)
    assert "count_jump" in printed["status"]
    assert "row 2001" in printed["notes"][0]
    assert results["open"].exit_code in (0, 3)
    assert "the counts jump by 100000 at row 200" in results["open"].output


def test_a_shift_of_the_zero_moves_the_values_in_gaps() -> None:
    counts = np.rint(300 * np.sin(0.05 * np.arange(2000))).astype(np.int64)
    there = np.ones(2000, bool)
    there[[300, 1500]] = False
    shifted = counts + np.where(np.arange(2000) >= 900, 5000, 0)
    record = Record(np.sin(0.05 * np.arange(2000)), shifted, 0.01, 1.0, (), "log", there=there)
    repaired = repair_record(record)
    assert repaired.status == ("count_jump",)
    assert np.max(np.abs(repaired.record.counts - counts)) <= 3


def test_the_counts_after_a_shift_of_the_zero_count() -> None:
    """After each shift, the motion has a start of its own, and the rest of the record is used."""
    record = recorded(AXIS, "prbs", 1024)
    counts = record.counts.copy()
    for row in (300, 900, 1500, 2400):
        counts[row:] += 700
    model, encoder, dt = pmfid.Drive(0.4), pmfid.Encoder(record.resolution), AXES[AXIS].dt
    shifted, clean = (
        pmfid.identify(record.u, values, model=model, encoder=encoder, dt=dt) for values in (counts, record.counts)
    )
    assert shifted.status == ("count_jump",)
    assert np.all(np.abs(shifted.theta - clean.theta) <= 2 * shifted.theta_std)
    assert np.all(shifted.theta_std < 6 * clean.theta_std)


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
