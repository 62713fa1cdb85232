"""Records: one test for each rule of a file, and the content of a good file."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import scipy.io

from pmfid.config.axis import Axis
from pmfid.errors import UsageError
from pmfid.io import SUFFIXES
from pmfid.records.record import Record, read_record
from tests.formats import LIBRARIES, WRITERS

DT = 0.01
SECTIONS: dict[str, dict[str, object]] = {
    "record": {"input": "u", "output": "y", "time": "t"},
    "encoder": {"resolution": 1e-3},
    "model": {"input_gain": 2.0},
    "estimator": {"cutoff": 50.0},
}


def make_axis(**changes: object) -> Axis:
    """Return the axis of SECTIONS with changes such as record_time=None, encoder_bits=8."""
    raw: dict[str, dict[str, object]] = {name: dict(values) for name, values in SECTIONS.items()}
    for dotted, value in changes.items():
        section, _, key = dotted.partition("_")
        raw[section][key] = value
    return Axis.model_validate(raw)


COUNTS: dict[str, object] = {"record_output": "counts", "record_output_kind": "counts"}


def columns(n: int = 20) -> dict[str, Any]:
    k = np.arange(n)
    counts = np.rint(30 * np.sin(0.3 * k)).astype(np.int64)
    return {"t": k * DT, "u": np.cos(0.3 * k), "y": counts * 1e-3, "counts": counts}


def need_library(suffix: str) -> None:
    """Skip a format whose extra is not installed."""
    if suffix in LIBRARIES:
        pytest.importorskip(LIBRARIES[suffix])


def write(path: Path, data: dict[str, Any]) -> Path:
    need_library(path.suffix)
    WRITERS[path.suffix](path, data)
    return path


def csv(folder: Path, **replaced: Any) -> Path:
    return write(folder / "run.csv", columns() | replaced)


def message(path: Path, axis: Axis | None = None) -> str:
    """Return the text of the one error; it starts with the path and is a single line."""
    with pytest.raises(UsageError) as caught:
        read_record(path, axis or make_axis())
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ")


def edited(values: np.ndarray, row: int, value: float) -> np.ndarray:
    """Return a copy of values as float with one entry replaced; rows count from 1, as in the messages."""
    copy = values.astype(np.float64)
    copy[row - 1] = value
    return copy


T, COUNTED = DT * np.arange(20), np.rint(30 * np.sin(0.3 * np.arange(20))).astype(np.int64)
VOLTS = [f"{value:.3f}" if row != 4 else "1,5 V" for row, value in enumerate(T)]
SCALED: dict[str, object] = {"record_input_scale": "gain"}
#: Suffix, columns, keys of the axis, and text of the one line that refuses the record.
REFUSED: list[tuple[str, dict[str, Any], dict[str, object], str]] = [
    (
        ".csv",
        {"counts": edited(COUNTED, 7, 3.5)},
        COUNTS,
        'got 3.5 in row 7; set output_kind = "position"',
    ),
    (".csv", {"counts": edited(COUNTED, 3, 1e16)}, COUNTS, "below 2**53, got 1e+16 in row 3"),
    (".csv", {}, {"encoder_resolution": 1e-300}, "more than 2**53 counts"),
    (".parquet", {"a\nb": T}, {"record_output": "x"}, "available are t, u, y, counts, a b"),
    (".csv", {"u": VOLTS}, {}, "input column 'u' is not numeric: '1,5 V' in row 5"),
    (".parquet", {"u": VOLTS}, {}, "input column 'u' is not numeric: '1,5 V' in row 5"),
    (".parquet", {"t": pl.Series(range(20)).cast(pl.Date)}, {}, "time column 't' is not numeric but Date"),
    (".csv", {"t": edited(T, 7, 0.03)}, {}, "time does not increase strictly: row 7 (0.03) follows 0.05;"),
    (".csv", {"t": edited(T, 9, 0.082)}, {}, "time steps differ by up to 20.0% of the median 0.01 s"),
    (".csv", {}, {"record_dt": 0.0102}, "[record] dt = 0.0102 s, but the time column 't' steps by 0.01;"),
    (".mat", {"y": np.zeros((20, 3))}, {}, "output = 'y': there is no such column; available are t, u, y_1, y_2, y_3"),
    (".mat", {"y": "volts"}, {}, "output column 'y' is not a real numeric array"),
    (".mat", {"y": np.array([{}], object)}, {}, "output column 'y' is not a real numeric array"),
    (".mat", {"y": np.ones(20) * 1j}, {}, "output column 'y' is not a real numeric array"),
    (".mat", {"u": np.ones(19)}, {}, "the columns differ in length: {'u': 19, 'y': 20, 't': 20}"),
    (".mat", {"gain": np.array([1.0, 2.0])}, SCALED, "input_scale = 'gain' is not a finite scalar"),
    (".mat", {"gain": 0.0}, SCALED, "input_scale = 'gain' is not a finite scalar"),
    (".mat", {"gain": np.nan}, SCALED, "input_scale = 'gain' is not a finite scalar"),
    (".mat", {"gain": np.zeros((0, 0))}, SCALED, "input_scale = 'gain' is not a finite scalar"),
    (".mat", {"gian": 2.0}, SCALED, "did you mean 'gian'?"),
    (".csv", {}, {"record_input_scale": "y"}, "input_scale = 'y' is a column, not a scalar variable; give a number"),
]


@pytest.mark.parametrize(("suffix", "replaced", "changes", "text"), REFUSED)
def test_records_are_refused_in_one_line(
    tmp_path: Path, suffix: str, replaced: dict[str, Any], changes: dict[str, object], text: str
) -> None:
    assert text in message(write(tmp_path / f"run{suffix}", columns() | replaced), make_axis(**changes))


def test_what_is_no_file_of_a_known_type(tmp_path: Path) -> None:
    other = csv(tmp_path).rename(tmp_path / "run.pdf")
    assert message(other) == f"file type '.pdf' is not known; use one of {', '.join(SUFFIXES)}"
    assert "cannot read the record: No such file or directory" in message(tmp_path / "absent.csv")
    (tmp_path / "folder.csv").mkdir()
    assert "must contain one log, but this one contains none" in message(tmp_path / "folder.csv")


#: Columns and keys of the axis, and what a note says of the record.
NOTED: list[tuple[dict[str, Any], dict[str, object], str]] = [
    ({"counts": np.arange(20) * 6 % 16}, COUNTS | {"encoder_bits": 4}, "largest step is 38% of the counter's range"),
    (
        {"counts": np.arange(2**32 - 10, 2**32 + 10) % 2**32},
        COUNTS | {"encoder_bits": 32},
        "wrapped 1 time (undone)",
    ),
    ({}, {"encoder_bits": 8}, "bits is ignored, because the output is a position"),
    ({"t": edited(T, 9, 0.0805)}, {}, "time steps vary by up to 5.0% of their median"),
    ({"t": edited(T, 7, 0.05)}, {}, "after another row: left out"),
]


@pytest.mark.parametrize(("replaced", "changes", "note"), NOTED)
def test_what_is_odd_is_noted(tmp_path: Path, replaced: dict[str, Any], changes: dict[str, object], note: str) -> None:
    assert note in "; ".join(read_record(csv(tmp_path, **replaced), make_axis(**changes)).notes)


#: Columns and keys of the axis with which the record is that of `columns`.
SAME: list[tuple[dict[str, Any], dict[str, object]]] = [
    ({}, COUNTS),
    ({"counts": edited(COUNTED, 7, COUNTED[6] + 1e-7)}, COUNTS),
    ({"remark": ["?"] * 20}, {}),
    ({"u": -0.4 * np.cos(0.3 * np.arange(20))}, {"record_input_scale": -2.5}),
    ({}, {"record_dt": 0.010099}),
    ({name: np.repeat(values, 1 + np.arange(20) % 2) for name, values in columns().items()}, {}),
]


@pytest.mark.parametrize(("replaced", "changes"), SAME)
def test_the_same_record_in_other_words(tmp_path: Path, replaced: dict[str, Any], changes: dict[str, object]) -> None:
    record = read_record(csv(tmp_path, **replaced), make_axis(**changes))
    np.testing.assert_allclose(record.u, columns()["u"], rtol=1e-12)
    np.testing.assert_array_equal(record.counts, COUNTED)
    assert record.dt == pytest.approx(DT, rel=1e-12)


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".CSV"])
def test_good_files_of_every_kind_give_the_same_record(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    write(tmp_path / f"run{suffix.lower()}", columns()).rename(path)
    record = read_record(path, make_axis())
    assert isinstance(record, Record)
    assert record.u.dtype == np.float64
    assert record.counts.dtype == np.int64
    np.testing.assert_array_equal(record.u, columns()["u"])
    np.testing.assert_array_equal(record.counts, columns()["counts"])
    assert record.dt == pytest.approx(DT, rel=1e-12)
    assert (record.resolution, record.notes, record.name) == (1e-3, (), path.name)


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5, 0.999])
def test_counts_that_the_log_rounds_keep_their_steps(tmp_path: Path, phase: float) -> None:
    """Counts in degrees with four decimals once gained and lost a count at every second value."""
    counts = np.arange(-700, 700)
    y = np.round((counts + phase) * 360 / 4096, 4)
    path = write(tmp_path / "run.parquet", {"t": np.arange(1400) * DT, "u": y, "y": y})
    assert set(np.diff(read_record(path, make_axis(encoder_resolution=360 / 4096)).counts)) == {1}


@pytest.mark.parametrize("signed", [False, True])
def test_wrapped_counter_is_unwrapped(tmp_path: Path, signed: bool) -> None:
    true = np.concatenate((np.arange(0, 300, 5), np.arange(300, -300, -5)))
    raw = (true + 128) % 256 - 128 if signed else true % 256
    n = len(true)
    path = write(tmp_path / "run.csv", {"t": np.arange(n) * DT, "u": np.ones(n), "counts": raw})
    record = read_record(path, make_axis(**COUNTS, encoder_bits=8))
    np.testing.assert_array_equal(record.counts, true)
    wraps = np.count_nonzero(np.abs(np.diff(raw)) > 128)
    assert wraps > 1
    assert record.notes == (f"counter wrapped {wraps} times (undone)",)


def at(path: Path, offset: int, value: int) -> None:
    """Overwrite one 32-bit word of a file."""
    data = bytearray(path.read_bytes())
    data[offset : offset + 4] = struct.pack("<I", value)
    path.write_bytes(data)


# Offsets into an uncompressed file whose first variable is the matrix `t`, in the layout of scipy.io.savemat.
MAT_WORDS = {
    "type of the variable": (128, 9, "element of type 9 in place of a variable"),
    "size of the variable": (132, 2**31, "an element is longer than the file"),
    "size of the flags": (140, 4, "a variable without its class"),
    "type of the dimensions": (152, 9, "a variable with a wrong dimension or name"),
    "size of the dimensions": (156, 4, "a variable with a wrong dimension or name"),
    "type of the name": (168, 9 + (1 << 16), "a variable with a wrong dimension or name"),
    "type of the values": (176, 200, "element of unknown type 200"),
    "reserved type of the values": (176, 8, "element of unknown type 8"),
    "matrix for values": (176, 14, "a variable in place of values"),
    "size of the values": (180, 2**32 - 1, "an element is longer than the file"),
    "complex without a second part": (144, 0x806, "a variable without its dimensions, name or values"),
    "sparse without indices": (144, 5, "a variable without its dimensions, name or values"),
}


@pytest.mark.parametrize(("offset", "value", "text"), MAT_WORDS.values(), ids=list(MAT_WORDS))
@pytest.mark.parametrize("compressed", [False, True])
def test_corrupt_matlab_file_never_reaches_the_reader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, offset: int, value: int, text: str, compressed: bool
) -> None:
    # SciPy's reader would end the whole process on several of these files, so that no test could fail
    monkeypatch.setattr(scipy.io, "loadmat", lambda _: pytest.fail("the reader was called"))
    path = write(tmp_path / "run.mat", {"t": columns()["t"]})
    assert path.read_bytes()[168:172] == struct.pack("<HH", 1, 1), "the layout that the offsets stand for"
    at(path, offset, value)
    if compressed:
        data = path.read_bytes()
        body = zlib.compress(data[128:])
        path.write_bytes(data[:128] + struct.pack("<II", 15, len(body)) + body)
    assert f"not a readable .mat file, truncated or corrupt ({text}); export it again" in message(path)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(("key", "column"), [("input", "u"), ("output", "y"), ("time", "t")])
@pytest.mark.parametrize("value", [np.nan, -np.inf])
def test_values_that_are_not_finite_are_missing_samples(
    tmp_path: Path, suffix: str, key: str, column: str, value: float
) -> None:
    bad = edited(edited(columns()[column], 12, value), 5, value)
    record = read_record(write(tmp_path / f"run{suffix}", columns() | {column: bad}), make_axis())
    assert record.there is not None, key
    assert np.flatnonzero(~record.there).tolist() == [4, 11]
    assert record.u.size == 20
    assert record.notes[-1].startswith("2 of 20 samples are missing (10.0%), in 2 gaps")
