"""Records of a drive with gaps: missing samples, parts that are left out, several records in one estimate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pmfid import Drive, Encoder, identify
from pmfid.config.axis import Axis
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.iv import RIV
from pmfid.estimators.recursive import RLS
from pmfid.pipeline.identify import identify as identify_record
from pmfid.pipeline.identify import kind_of
from pmfid.records.clock import PlacedRows, place_rows
from pmfid.records.joining import unbroken
from pmfid.records.record import Record, record_of
from pmfid.simulation import DriveParameters, multisine, prbs, quantize, simulate_drive
from pmfid.status import Status
from pmfid.types import Counts, Flags, Floats
from tests.conftest import long_unless
from tests.refusals import refused

DT, STEP, CUTOFF = 0.004, 2e-5, 20.0
STAGE = DriveParameters(6.3, 9.0, 2.6, 3.34)
TRUTH = np.array([STAGE.mass, STAGE.viscous_friction, STAGE.coulomb_friction])
SETTINGS = {"model": Drive(STAGE.input_gain), "dt": DT, "encoder": Encoder(STEP), "cutoff": CUTOFF}


def run(samples: int = 5000, seed: int = 0) -> tuple[Floats, Counts]:
    rng = np.random.default_rng(seed)
    u = prbs(samples, clock=25, amplitude=4.0, rng=rng)
    return u, quantize(simulate_drive(STAGE, u, DT).x, STEP, STEP * rng.random())


def kept(samples: int, part: float, burst: int = 1) -> Flags:
    rng, there = np.random.default_rng(1), np.ones(samples, bool)
    for first in rng.integers(50, samples - 100, round(part * samples / burst)):
        there[first : first + burst] = False
    return there


def lacking(there: Flags, u: Floats, counts: Counts) -> tuple[Floats, Floats]:
    return np.where(there, u, np.nan), np.where(there, counts, np.nan)


def write(path: Path, there: Flags, stamps: Floats, **columns: np.ndarray) -> Path:
    names = ["t", *columns]
    rows = np.column_stack([stamps, *columns.values()])[there]
    path.write_text(",".join(names) + "\n" + "\n".join(",".join(f"{x:.9g}" for x in row) for row in rows) + "\n")
    return path


def axis(method: str = "iv", **record: object) -> Axis:
    return Axis.model_validate(
        {
            "record": {"input": "u", "output": "n", "output_kind": "counts", "time": "t"} | record,
            "encoder": {"resolution": STEP},
            "model": {"kind": "drive", "input_gain": STAGE.input_gain},
            "estimator": {"method": method, "cutoff": CUTOFF},
        }
    )


def test_missing_lines_and_empty_cells_are_the_same_and_scattered_stamps_are_resampled(tmp_path: Path) -> None:
    u, counts = run(2000)
    t, there, whole = np.arange(2000) * DT, kept(2000, 0.1), np.ones(2000, bool)
    gone = write(tmp_path / "gone.csv", there, t, u=u, n=counts)
    empty = write(tmp_path / "empty.csv", whole, t, u=np.where(there, u, np.nan), n=counts)
    scattered = np.cumsum(np.random.default_rng(4).uniform(0.3, 2.5, 2000)) * DT
    paths = (gone, empty, write(tmp_path / "scattered.csv", whole, scattered, u=u, n=counts))
    first, second, third = (kind_of(axis()).read([path], axis()) for path in paths)
    np.testing.assert_array_equal(first.there, there)
    for name in ("u", "counts", "there"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert third.jitter > 0.3


@pytest.mark.parametrize("method", ["ls", "bcls", "iv", "rls", "riv"])
@pytest.mark.parametrize(("part", "burst"), [(0.003, 1), (0.1, 50)])
def test_methods_with_filters_restart_after_each_gap(method: str, part: float, burst: int) -> None:
    u, counts = run()
    found = identify(*lacking(kept(u.size, part, burst), u, counts), method=method, **SETTINGS)
    assert np.all(np.abs(found.theta - TRUTH) < np.maximum(4 * found.theta_std, 0.03 * TRUTH))
    assert not {"invalid_input", "count_jump"} & set(found.status)
    assert any("restart after each of" in note for note in found.notes)
    assert any("samples are missing" in note for note in found.notes)


@pytest.mark.parametrize("method", ["bcls", "iv", "riv"])
def test_gaps_that_leave_nothing_are_refused_and_the_fit_goes_through(method: str) -> None:
    """The samples were once filled, with an error that a repeated removal of samples estimated."""
    u, counts = run(3000)
    lost = lacking(kept(u.size, 0.2), u, counts)
    refused(('method = "auto"', lambda: identify(*lost, method=method, **SETTINGS)), kind=NotIdentifiableError)
    found = identify(*lost, method="auto", **SETTINGS)
    assert np.all(np.abs(found.theta - TRUTH) < 4 * found.theta_std)


@pytest.mark.parametrize(
    "method",
    long_unless(
        lambda method: method in ("bcls", "fit", "riv"),
        ["ls", "bcls", "fit", "auto", "rls", "bcrls", "riv"],
    ),
)
def test_every_method_takes_long_gaps(method: str) -> None:
    u, counts = run(3000)
    found = identify(*lacking(kept(u.size, 0.03, 50), u, counts), method=method, **SETTINGS)
    np.testing.assert_allclose(found.theta, TRUTH, rtol=0.03)
    assert not {"unmodelled", "invalid_input", "count_jump"} & set(found.status)


def test_three_records_are_one_estimate() -> None:
    runs = [run(2000, seed) for seed in range(3)]
    found = identify(runs, method="auto", **SETTINGS)
    singles = [identify(*one, method="auto", **SETTINGS).theta_std for one in runs]
    assert np.all(np.abs(found.theta - TRUTH) < 4 * found.theta_std)
    assert np.all(found.theta_std < np.max(singles, axis=0))  # the shift between two records once cost the last record
    assert found.status == ()


def test_several_records_where_the_place_matters_are_refused() -> None:
    runs = [run(100, seed) for seed in range(2)]
    spring = {**SETTINGS, "model": Drive(STAGE.input_gain, spring=True)}
    refused(("several records with unknown start positions", lambda: identify(runs, **spring)))


# --- on-line ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_gap_leaves_what_was_gathered(precision: str) -> None:
    u, counts = run(4000)
    riv = RIV(**SETTINGS, precision=precision)
    before = riv.run(u[:3000], counts[:3000])
    riv.gap(int(counts[3400]))
    after = riv.run(u[3400:], counts[3400:])
    assert np.max(np.abs(after.theta / before.theta[-1] - 1)) < 0.02
    assert not np.any(after.has_status(Status.FALLBACK | Status.STARTING))


def test_a_gap_is_forgotten_by_the_filters() -> None:
    """Least squares treats the samples after a gap as a second record and adds the sums of both."""
    u, counts = run(3000)
    rls = RLS(**SETTINGS)
    rls.run(u[:1500], counts[:1500])
    rls.gap(10**9)
    rls.run(u[1500:], counts[1500:] - counts[1500] + 10**9)
    np.testing.assert_allclose(rls.estimate.theta, TRUTH, rtol=0.01)


# --- rows and places --------------------------------------------------------------------------------------------------


def test_parts_and_masked_rows_are_left_out(tmp_path: Path) -> None:
    u, counts = run(2000)
    t, bad = np.arange(2000) * DT, np.zeros(2000)
    bad[100:110] = 1
    path = write(tmp_path / "run.csv", np.ones(2000, bool), t, u=u, n=counts, bad=bad)
    record = kind_of(axis()).read([path], axis(mask="bad", exclude=((2.0, 2.02),)))
    lost = np.flatnonzero(~record.there)
    assert lost.tolist() == [*range(100, 110), *range(500, 506)]
    assert any("mask 'bad'" in note for note in record.notes)


def test_a_row_that_repeats_is_left_out(tmp_path: Path) -> None:
    u, counts = run(1000)
    again = np.sort(np.r_[np.arange(1000), 17, 500])
    path = write(tmp_path / "run.csv", np.ones(1002, bool), again * DT, u=u[again], n=counts[again])
    record = kind_of(axis()).read([path], axis())
    np.testing.assert_array_equal(record.counts, counts)
    assert record.there is None
    assert "2 rows repeat the row before with its time and are left out" in record.notes


def test_a_pause_need_not_be_whole() -> None:
    time = np.r_[np.arange(50), 50 + 130.4 + np.arange(50)] * DT
    config = axis().record
    found = place_rows(time, np.ones(100, bool), np.zeros(100, bool), config, np.zeros(100))
    assert found.dt == pytest.approx(DT, rel=1e-9)
    assert np.diff(found.places)[49] == 131


def test_several_files_of_one_axis(tmp_path: Path) -> None:
    paths = []
    for seed in range(2):
        u, counts = run(2500, seed)
        t = np.arange(2500) * DT
        paths.append(write(tmp_path / f"{seed}.csv", np.ones(2500, bool), t, u=u, n=counts + 1000 * seed))
    data = kind_of(axis()).read(paths, axis())
    result = identify_record(data, axis())
    np.testing.assert_allclose(result.theta, TRUTH, rtol=0.01)
    assert data.name == "0.csv, 1.csv"


def test_what_looks_at_one_motion_takes_the_part_without_gaps_that_moves_most_and_says_so() -> None:
    u, counts = np.ones(200), np.minimum(np.arange(200), 95)  # at rest in the longest part
    whole = Record(u, counts, 0.01, 1.0, (), "run")
    assert unbroken(whole) is whole
    u[[20, 21, 90]] = np.nan
    part = unbroken(replace(whole, u=u))
    assert part.counts.tolist() == list(range(22, 90))
    assert part.notes == ("this method uses only the part without gaps that moves most: 68 of 200 samples",)


def test_a_row_right_after_another_costs_no_record() -> None:
    """A real record with 6.7 ms between its rows was once refused because of two rows 0.1 ms apart at the start."""
    time = np.r_[0.0, 1e-4 + DT * np.arange(300)]
    config = Axis.model_validate(
        {
            "record": {"input": "u", "output": "y", "time": "t", "time_unit": "s"},
            "encoder": {"resolution": STEP},
            "model": {"input_gain": 1.0},
        }
    ).record
    rows = place_rows(time, np.ones(301, bool), np.zeros(301, bool), config, np.zeros(301))
    assert rows.dt == pytest.approx(DT, rel=1e-3)
    assert rows.rows.size == 300
    assert "1 row comes less than 0.3 of a period after another row: left out" in rows.notes


def test_an_input_without_a_count_is_an_input() -> None:
    u, counts = run(3000)
    there = kept(3000, 0.05, burst=15)
    record = record_of({"u": u, "n": np.where(there, counts, np.nan)}, axis(time=None, dt=DT))
    assert np.array_equal(record.u, u)
    result = identify(u, np.where(there, counts, np.nan), model=Drive(STAGE.input_gain), dt=DT, encoder=Encoder(STEP))
    assert result.status == ()
    assert np.abs(result.theta[:3] / TRUTH - 1) == pytest.approx(0.0, abs=2e-4)


def test_a_row_that_was_left_out_gives_no_input() -> None:
    rows = PlacedRows(np.array([0, 1, 4, 6, 8]), np.array([0, 1, 4, 9, 11]), DT, ())
    u = np.array([0.0, 1.0, 2.0, np.nan, 4.0, 5.0, 6.0, 7.0, 8.0])
    lost = np.nan  # rows 5 to 6 skip lines, so the place of row 5 is unknown
    assert rows.place_inputs(u) == pytest.approx(
        np.array([0.0, 1.0, 2.0, lost, 4.0, lost, lost, lost, lost, 6.0, 7.0, 8.0]), nan_ok=True
    )


@pytest.mark.parametrize("kind", ["prbs", "multisine"])
def test_an_input_that_is_lost_is_unknown_to_the_fit(kind: str) -> None:
    """An interpolated input is wrong by half a step where the input switches, and moves the axis by many counts."""
    errors = []
    for seed in range(4):
        rng, dt, step = np.random.default_rng(seed), 0.01, 1e-3
        frequencies = np.array([0.3, 0.7, 1.7, 3.1])
        u = (
            prbs(1000, clock=10, amplitude=4.0, rng=rng)
            if kind == "prbs"
            else multisine(1000, dt, frequencies, 4.0, rng)
        )
        counts = quantize(simulate_drive(DriveParameters(1.07, 12.8, 0.8, 2.0), u, dt).x, step)
        u[rng.integers(1, 999, 10)] = np.nan
        result = identify(u, counts, model=Drive(2.0), dt=dt, encoder=Encoder(step))
        assert result.status == ()
        errors.append((result.theta - [1.07, 12.8, 0.8]) / result.theta_std)
    assert np.sqrt(np.mean(np.square(errors))) < 1.7


def test_a_note_says_that_an_input_without_counts_is_known() -> None:
    """The motion of the fit does not restart, however long the counts are missing."""
    u, counts = run()
    seen = np.where(kept(u.size, 0.1, burst=60), counts.astype(np.float64), np.nan)
    result = identify(u, seen, model=SETTINGS["model"], dt=DT, encoder=SETTINGS["encoder"])
    assert result.free_run().largest < 3 * STEP
    (note,) = [note for note in result.notes if "samples are missing" in note]
    assert note.endswith("the input in each is known")
    np.testing.assert_allclose(result.theta, TRUTH, rtol=1e-3)
