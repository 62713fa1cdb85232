"""The time column: its unit by name, by key and by size, and refusals of doubtful units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pmfid.config.axis import Axis, load_axis
from pmfid.config.record import RecordConfig
from pmfid.errors import UsageError
from pmfid.pipeline.identify import identify
from pmfid.records.clock import PlacedRows, named_unit, place_rows
from pmfid.records.record import read_experiment, read_record, record_of
from pmfid.stream.lines import LineParser
from pmfid.types import Floats
from tests.conftest import cart_run
from tests.refusals import refused

pytestmark = pytest.mark.usefixtures("without_judgement")


def axis_of(folder: Path, name: str, extra: str = "", cutoff: float = 20.0) -> Axis:
    path = folder / "axis.toml"
    path.write_text(
        f'[record]\ninput = "u"\noutput = "counts"\noutput_kind = "counts"\ntime = "{name}"\n{extra}\n'
        f"[encoder]\nresolution = 22.75e-6\n[model]\ninput_gain = 2.0\n[estimator]\nmethod = 'iv'\ncutoff = {cutoff}\n"
    )
    return load_axis(path)


def logged(folder: Path, name: str, step: float) -> Path:
    """Write the log of the cart at 100 Hz with time stamps `step` apart."""
    run = cart_run(1, samples=1000)
    time = np.arange(run.u.size) * step
    whole = time.astype(np.int64) if float(step).is_integer() else time
    pl.DataFrame({name: whole, "u": run.u, "counts": run.counts}).write_csv(folder / "run.csv")
    return folder / "run.csv"


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("t_ms", "ms"),
        ("Time [ms]", "ms"),
        ("time/us", "us"),
        ("Zeit (µs)", "us"),
        ("stamp.ns", "ns"),
        ("millis", "ms"),
        ("t_s", "s"),
        ("time [s]", "s"),
        ("t", None),
        ("items", None),
        ("axis", None),
        ("status", None),
        ("", None),
    ],
)
def test_the_unit_in_a_name(name: str, unit: str | None) -> None:
    assert named_unit(name) == unit


@pytest.mark.parametrize(("name", "step"), [("t_ms", 10), ("Time [us]", 10_000), ("stamp_ns", 10_000_000)])
def test_a_named_unit_is_converted_with_a_note(tmp_path: Path, name: str, step: float) -> None:
    record = read_record(logged(tmp_path, name, step), axis_of(tmp_path, name))
    assert record.dt == pytest.approx(0.01, rel=1e-12)
    assert any(repr(name) in note and "0.01 s" in note for note in record.notes)


@pytest.mark.parametrize(
    ("unit", "step", "cutoff"),
    [("ms", 10, 50.0), ("ms", 10, 0.02), ("us", 10_000, 2.0), ("ns", 10_000_000, 0.02), ("ns", 10_000_000, 50.0)],
)
def test_time_that_is_not_in_s_is_refused_and_the_remedy_followed_literally_helps(
    tmp_path: Path, unit: str, step: int, cutoff: float
) -> None:
    """The remedy was once a lower cutoff, which hid a factor of a million in the mass."""
    path = logged(tmp_path, "t", step)
    with pytest.raises(UsageError, match=rf'time_unit = .*"{unit}" \(0\.01 s\)') as caught:
        read_record(path, axis_of(tmp_path, "t", cutoff=cutoff))
    assert "cutoff" not in str(caught.value)
    axis = axis_of(tmp_path, "t", f'time_unit = "{unit}"')
    assert identify(read_record(path, axis), axis).theta[0] == pytest.approx(1.07, rel=0.02)


def test_a_pipe_has_the_unit_of_the_record(tmp_path: Path) -> None:
    parse = LineParser(b"t_ms,u,counts", axis_of(tmp_path, "t_ms"))
    assert [line.time for line in map(parse, (b"0,1.0,5", b"10,1.0,6")) if line] == pytest.approx([0.0, 0.01])


def test_a_transfer_function_wants_the_unit_said(tmp_path: Path) -> None:
    """A process may have any speed, so that the name of a column alone decides nothing."""
    text = (
        '[record]\ninput = "u"\noutput = "counts"\ntime = "t_ms"\n{}[model]\nkind = "transfer_function"\nn = 1\nm = 0\n'
        "[estimator]\ncutoff = 1.0\n"
    )
    path, record = tmp_path / "axis.toml", logged(tmp_path, "t_ms", 250)
    path.write_text(text.format(""))
    refused((r'give \[record\] time_unit = "ms", or "s"', lambda: read_experiment(record, load_axis(path))))
    path.write_text(text.format('time_unit = "ms"\n'))
    assert read_experiment(record, load_axis(path)).period == pytest.approx(0.25)


@pytest.mark.parametrize("period", [0.00111, 0.0108, 0.01095])
def test_rounded_stamps_of_an_even_clock_stay_even(period: float) -> None:
    """The stamps are in whole milliseconds, or in steps of 10 ms. The period is no multiple of these units."""
    k = np.arange(3000)
    unit = 0.001 if period < 0.002 else 0.01
    found = place(np.rint(period * k / unit) * unit, np.cumsum(np.sin(0.01 * k)))
    assert found.dt == pytest.approx(period, rel=1e-4)
    np.testing.assert_array_equal(found.places, k)


def place(time: Floats, output: Floats) -> PlacedRows:
    config = axis_config()
    every = np.ones(time.size, bool)
    return place_rows(time, every, ~every, config, output)


def axis_config() -> RecordConfig:
    record = {"input": "u", "output": "y", "time": "t", "time_unit": "s"}
    return Axis.model_validate({"record": record, "encoder": {"resolution": 1e-3}, "model": {"input_gain": 1.0}}).record


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [1e308, -1.7e308, 3.4e38 * 1e80, np.inf])
@pytest.mark.parametrize("column", ["t", "u", "y"])
@pytest.mark.parametrize("kind", ["position", "velocity"])
def test_numbers_that_no_sensor_gives_are_missing(column: str, value: float, kind: str) -> None:
    """Differences of such numbers once overflowed with a warning of NumPy."""
    k = np.arange(400)
    table = {"t": 0.01 * (k + (k > 200)), "u": np.sign(np.sin(k / 9)), "y": np.round(np.sin(k / 30), 3)}
    table[column] = table[column].copy()
    table[column][[50, 51, 300]] = value
    axis = Axis.model_validate(
        {
            "record": {"input": "u", "output": "y", "time": "t", "time_unit": "s", "output_kind": kind},
            "encoder": {"resolution": 1e-3},
            "model": {"input_gain": 1.0},
        }
    )
    record = record_of(table, axis)
    assert record.there is not None
    assert np.flatnonzero(~record.there).tolist() == [50, 51, 201, 301]
