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

from pmfid.config.axis import Axis, load_axis
from pmfid.errors import UsageError
from pmfid.io import SUFFIXES
from pmfid.records.edge_ages import Coarser
from pmfid.records.record import Record, read_record
from pmfid.records.tuning import TUNING
from tests.formats import LIBRARIES, WRITERS

EXAMPLES = Path(__file__).parents[1] / "examples"
EMPS = Path(__file__).parents[2] / "shared/data/emps/DATA_EMPS.mat"
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


def message(path: Path, axis: Axis | None = None, step: float | None = None) -> str:
    """Return the text of the one error; it starts with the path and is a single line."""
    with pytest.raises(UsageError) as caught:
        read_record(path, axis or make_axis(), None if step is None else Coarser(step))
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
ROWS = "".join(f"{k},1,2,3\n" for k in range(20))
#: Content of a CSV file, and text of the one line that refuses it.
NO_TABLES = [
    ("t,u,u,y\n" + ROWS, "input = 'u': two columns have this name"),
    ("this is\nno table\n" * 20, "no lines of numbers in columns"),
    ("t,u,y\n0,1,2\n1,2,3,4\n", "not every line from line 2 on has 3 columns"),
    ("t,u,y\n" + ROWS.replace(",2,3", ","), "output column 'y' is empty"),
]


@pytest.mark.parametrize(("suffix", "replaced", "changes", "text"), REFUSED)
def test_records_are_refused_in_one_line(
    tmp_path: Path, suffix: str, replaced: dict[str, Any], changes: dict[str, object], text: str
) -> None:
    assert text in message(write(tmp_path / f"run{suffix}", columns() | replaced), make_axis(**changes))


@pytest.mark.parametrize(("content", "text"), NO_TABLES)
def test_a_csv_that_is_no_table(tmp_path: Path, content: str, text: str) -> None:
    (tmp_path / "run.csv").write_text(content)
    assert text in message(tmp_path / "run.csv")


@pytest.mark.parametrize("step", [0.0, -1.0, 0.5e-3, np.nan, np.inf])
def test_quantize_must_be_positive_and_not_finer_than_the_resolution(tmp_path: Path, step: float) -> None:
    with pytest.raises(UsageError) as caught:
        read_record(csv(tmp_path), make_axis(), Coarser(step))
    assert "not finer than [encoder] resolution = 0.001" in str(caught.value)


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
]


@pytest.mark.parametrize(("replaced", "changes"), SAME)
def test_the_same_record_in_other_words(tmp_path: Path, replaced: dict[str, Any], changes: dict[str, object]) -> None:
    record = read_record(csv(tmp_path, **replaced), make_axis(**changes), Coarser(1e-3))
    np.testing.assert_allclose(record.u, columns()["u"], rtol=1e-12)
    np.testing.assert_array_equal(record.counts, COUNTED)
    assert record.dt == pytest.approx(DT, rel=1e-12)
    assert record.notes == ("the position is quantised again with a step of 0.001",)


@pytest.mark.parametrize("options", [{"do_compression": True}, {"format": "4"}, {"oned_as": "column"}])
def test_matlab_files_of_other_forms(tmp_path: Path, options: dict[str, Any]) -> None:
    others = {"empty": np.zeros((0, 0)), "text": "volts", "z": np.ones(3) * 1j}
    if "format" not in options:
        others |= {"s": {"a": [1.0], "b": "x"}, "c": np.array([1, "x", np.zeros((0, 0))], object)}
    scipy.io.savemat(tmp_path / "run.mat", columns() | others, **options)
    np.testing.assert_array_equal(read_record(tmp_path / "run.mat", make_axis(**COUNTS)).counts, COUNTED)


def test_matlab_files_that_are_damaged_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "run.mat", columns())
    data = path.read_bytes()
    for size, text in ((0, "available are none"), *((k, "an element without its size") for k in (1, 4, 7))):
        path.write_bytes(data[: 128 + size])
        assert text in message(path)
    path.write_bytes(data + data[128:])
    assert 'Duplicate variable name "t"' in message(path)
    monkeypatch.setattr(scipy.io, "loadmat", lambda _: pytest.fail("the reader was called"))
    inner = write(tmp_path / "inner.mat", {"run": {"t": columns()["t"]}})
    at(inner, inner.read_bytes().index(struct.pack("<II", 9, 160)), 8)
    assert "element of unknown type 8" in message(inner)


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


def test_position_on_the_decimal_lattice_keeps_every_count(tmp_path: Path) -> None:
    counts = np.arange(-2000, 2000)
    y = counts * 0.001
    assert np.any(np.floor(y / 0.001) != counts), "the lattice must show the trouble that the tolerance cures"
    path = write(tmp_path / "run.parquet", {"t": np.arange(4000) * DT, "u": y, "y": y})
    np.testing.assert_array_equal(read_record(path, make_axis()).counts, counts)


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5, 0.999])
def test_counts_that_the_log_rounds_keep_their_steps(tmp_path: Path, phase: float) -> None:
    """Counts in degrees with four decimals once gained and lost a count at every second value."""
    counts = np.arange(-700, 700)
    y = np.round((counts + phase) * 360 / 4096, 4)
    path = write(tmp_path / "run.parquet", {"t": np.arange(1400) * DT, "u": y, "y": y})
    assert set(np.diff(read_record(path, make_axis(encoder_resolution=360 / 4096)).counts)) == {1}


def test_quantize_floors_the_position_to_the_coarser_step(tmp_path: Path) -> None:
    record = read_record(csv(tmp_path), make_axis(), Coarser(4e-3))
    np.testing.assert_array_equal(record.counts, columns()["counts"] // 4)
    assert record.resolution == 4e-3
    assert record.notes == ("the position is quantised again with a step of 0.004",)


def test_quantize_of_counts_goes_through_the_unwrapped_position(tmp_path: Path) -> None:
    path = csv(tmp_path, counts=columns()["counts"] % 64)
    record = read_record(path, make_axis(**COUNTS, encoder_bits=6), Coarser(4e-3))
    np.testing.assert_array_equal(record.counts, columns()["counts"] // 4)
    assert record.resolution == 4e-3


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


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_missing_column_lists_the_available_ones(tmp_path: Path, suffix: str) -> None:
    text = message(write(tmp_path / f"run{suffix}", columns()), make_axis(record_output="count"))
    listed = text.removeprefix("[record] output = 'count': there is no such column; available are ").split("; did you")[
        0
    ]
    assert {name.removeprefix("/run.") for name in listed.split(", ")} - {"time"} == {"t", "u", "y", "counts"}
    assert text.endswith("counts'?")


def test_csv_with_spaces_byte_order_mark_and_carriage_returns(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    rows = "".join(f"{k * DT}, {k % 3}.5, {k}e-3\r\n" for k in range(20))
    path.write_bytes(b"\xef\xbb\xbf" + ("t, u, y\r\n" + rows).encode())
    record = read_record(path, make_axis())
    np.testing.assert_array_equal(record.u, np.arange(20) % 3 + 0.5)
    np.testing.assert_array_equal(record.counts, np.arange(20))


def test_csv_that_starts_with_integers_and_goes_on_with_fractions(tmp_path: Path) -> None:
    u = np.where(np.arange(400) < 300, 1.0, 0.25)
    rows = "".join(f"{k * DT},{value:g},{k}e-3\n" for k, value in enumerate(u))
    path = tmp_path / "run.csv"
    path.write_text("t,u,y\n" + rows)
    np.testing.assert_array_equal(read_record(path, make_axis()).u, u)


@pytest.mark.parametrize(("n", "text"), [(0, "0 samples"), (1, "1 sample,"), (TUNING.min_samples - 1, "9 samples")])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_too_few_samples(tmp_path: Path, n: int, text: str, suffix: str) -> None:
    path = write(tmp_path / f"run{suffix}", columns(n))
    found = message(path)
    if n == 0 and suffix in (".mcap", ".db3"):  # columns come with messages
        assert "there is no such column; available are time" in found
        return
    assert text in found
    assert "at least 10 are needed" in found


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("content", [b"", b" \n"])
def test_empty_file(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"run{suffix}"
    path.write_bytes(content)
    assert "the file is empty" in message(path)


@pytest.mark.parametrize("suffix", [suffix for suffix in SUFFIXES if suffix != ".csv"])
@pytest.mark.parametrize("fraction", [0.01, 0.3, 0.9, 0.999])
def test_truncated_file(tmp_path: Path, suffix: str, fraction: float) -> None:
    path = write(tmp_path / f"run{suffix}", columns(200))
    data = path.read_bytes()
    path.write_bytes(data[: int(fraction * len(data))])
    assert f"not a readable {suffix} file, truncated or corrupt" in message(path)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_content_of_another_type(tmp_path: Path, suffix: str) -> None:
    """Text is no other format; a file with the first bytes of a format is read in that format."""
    need_library(suffix)
    path = tmp_path / f"run{suffix}"
    if suffix == ".csv":
        write(tmp_path / "other.mat", columns(200)).rename(path)
        assert len(read_record(path, make_axis()).u) == 200
    else:
        write(tmp_path / "other.csv", columns(200)).rename(path)
        assert "not a" in message(path)


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


def big_endian(path: Path, data: dict[str, Any], kind: int = 9) -> Path:
    """Write vectors as a big-endian machine does, with values of the type `kind` (9: double)."""

    def element(kind: int, content: bytes) -> bytes:
        return struct.pack(">II", kind, len(content)) + content + b"\0" * (-len(content) % 8)

    def matrix(name: str, values: np.ndarray) -> bytes:
        head = element(6, struct.pack(">II", 6, 0)) + element(5, struct.pack(">ii", len(values), 1))
        return element(14, head + element(1, name.encode()) + element(kind, values.astype(">f8").tobytes()))

    variables = b"".join(matrix(name, values) for name, values in data.items())
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI" + variables)
    return path


def test_matlab_file_of_a_big_endian_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = read_record(big_endian(tmp_path / "run.mat", columns()), make_axis(**COUNTS))
    np.testing.assert_array_equal(record.u, columns()["u"])
    np.testing.assert_array_equal(record.counts, columns()["counts"])
    monkeypatch.setattr(scipy.io, "loadmat", lambda _: pytest.fail("the reader was called"))
    assert "element of unknown type 8" in message(big_endian(tmp_path / "run.mat", columns(), kind=8))


def test_matlab_v73_without_its_contents_is_damaged(tmp_path: Path) -> None:
    need_library(".h5")
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    path = tmp_path / "run.mat"
    for data in (header.ljust(512, b"\0") + b"\x89HDF\r\n\x1a\n", b"\x89HDF\r\n\x1a\n" + b"\0" * 512):
        path.write_bytes(data)
        assert "truncated or corrupt" in message(path)


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


@pytest.mark.parametrize("empty", ["", "NA", "null"])
def test_empty_cells_are_missing_values(tmp_path: Path, empty: str) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,u,y\n" + "".join(f"{k},{empty if k == 3 else 1},2\n" for k in range(20)))
    there = read_record(path, make_axis(record_time_unit="s")).there
    assert there is not None
    assert np.flatnonzero(~there).tolist() == [3]


def test_dt_without_a_time_column(tmp_path: Path) -> None:
    assert read_record(csv(tmp_path), make_axis(record_time=None, record_dt=0.02)).dt == 0.02


def test_input_scale_variable(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mat", columns() | {"gain": 3.5})
    record = read_record(path, make_axis(record_input_scale="gain"))
    np.testing.assert_array_equal(record.u, 3.5 * columns()["u"])
    assert record.notes == ("input scaled by gain = 3.5",)


@pytest.mark.skipif(not EMPS.exists(), reason=f"the EMPS record is not here: {EMPS.name} is not distributed")
def test_emps_record() -> None:
    record = read_record(EMPS, load_axis(EXAMPLES / "emps.toml"))
    raw = scipy.io.loadmat(EMPS)
    assert len(record.u) == len(record.counts) == 24841
    assert record.dt == pytest.approx(1e-3, abs=1e-9)
    np.testing.assert_allclose(record.u, 35.15065188 * raw["vir"].ravel(), rtol=1e-9)
    np.testing.assert_array_equal(record.counts, np.rint(raw["qm"].ravel() / 5e-8))
    assert record.notes == ("input scaled by gtau = 35.1507",)


def test_known_forces_leave_the_input_before_the_estimate(tmp_path: Path) -> None:
    data = columns()
    path = csv(tmp_path, gravity=0.5 + 0 * data["t"], coupling=3 * np.sin(data["t"]))
    axis = make_axis(record_known_force=["gravity", "coupling"], record_input_scale=4.0)
    expected = 4 * data["u"] - (0.5 + 3 * np.sin(data["t"])) / 2
    assert read_record(path, axis).u == pytest.approx(expected, abs=1e-12)
    assert "coupled" in message(path, make_axis(record_known_force=["coupled"]))
    unknown_gain = make_axis(record_known_force=["gravity"], model_input_gain="estimate", estimator_given={"mass": 1.0})
    assert "give [model] input_gain" in message(path, unknown_gain)
