"""Logs as drives and spreadsheets write them: all hold the same record."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pytest

from pmfid.config.axis import load_axis
from pmfid.errors import UsageError
from pmfid.records.record import Record, read_record

DT, N = 0.004, 300
TOML = """\
[record]
input = "u"
output = "y"
time = "t"
{more}
[encoder]
resolution = 0.25
[model]
input_gain = 2.0
"""
rng = np.random.default_rng(3)
U = np.round(rng.normal(size=N), 3)
Y = np.cumsum(np.round(rng.normal(size=N))) * 0.25


def read(folder: Path, data: bytes | str, name: str = "run.csv", more: str = "") -> Record:
    (folder / "axis.toml").write_text(TOML.format(more=more))
    (folder / name).write_bytes(data if isinstance(data, bytes) else data.encode())
    return read_record(folder / name, load_axis(folder / "axis.toml"))


def same(record: Record) -> None:
    np.testing.assert_allclose(record.u, U)
    np.testing.assert_array_equal(record.counts, np.rint(Y / 0.25))
    assert record.dt == pytest.approx(DT, rel=1e-6)


def text(separator: str = ",", decimal: str = ".", header: str | None = None, time: list[str] | None = None) -> str:
    stamps = time or [f"{k * DT:.6g}" for k in range(N)]
    rows = [[stamps[k], f"{U[k]:.6g}", f"{Y[k]:.6g}"] for k in range(N)]
    if decimal == ",":
        rows = [[field.replace(".", ",") if field[2:3] != ":" else field for field in row] for row in rows]
    head = separator.join(("t", "u", "y")) if header is None else header
    return "\n".join([head, *(separator.join(row) for row in rows)]).lstrip("\n") + "\n"


PREAMBLE = "Scope export\nVersion;4.2\nSamples;300\n\n"
LAYOUTS: dict[str, bytes | str] = {
    "commas": text(),
    "german": text(";", ","),
    "semicolons and points": text(";"),
    "tabs": text("\t"),
    "tabs and decimal commas": text("\t", ","),
    "bars": text("|"),
    "spaces": text(" "),
    "aligned": text().replace(",", "    ").replace("\n", "\n   "),
    "comma and space": text(", "),
    "carriage returns": text().replace("\n", "\r\n"),
    "old line ends": text().replace("\n", "\r"),
    "byte order mark": b"\xef\xbb\xbf" + text(";", ",").encode(),
    "utf-16": text(";", ",").encode("utf-16"),
    "utf-16 without mark": text("\t").encode("utf-16-le"),
    "latin-1": ("# Temperatur in °C\n" + text(";", ",")).encode("cp1252"),
    "preamble": PREAMBLE + text(";", ","),
    "header in a comment": "# saved by the drive\n# t,u,y\n" + text(header=""),
    "matlab's comments": "% t u y\n" + text(" ", header=""),
    "row of units": text(";", ",", header="t;u;y\n[s];[V];[m]"),
    "bare units": text(header="t,u,y\ns,A,rad"),
    "quoted": "\n".join(",".join(f'"{field}"' for field in line.split(",")) for line in text().splitlines()),
    "quoted decimal commas": "\n".join(
        ",".join(f'"{field.replace(".", ",")}"' for field in line.split(",")) for line in text().splitlines()
    ),
    "an index without a name": "\n".join(f"{k - 1 if k else ''},{line}" for k, line in enumerate(text().splitlines())),
    "trailing separator": text().replace("\n", ",\n"),
    "comments between": text().replace("\n", "\n# beat\n", 40),
    "blank lines at the end": text() + "\n\n",
    "units in the header": text(header="t [s],u [V],y [m]"),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_holds_the_same_record(tmp_path: Path, layout: str) -> None:
    same(read(tmp_path, LAYOUTS[layout]))


@pytest.mark.parametrize(
    ("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)], ids=["milliseconds", "microseconds", "nanoseconds"]
)
def test_the_unit_of_time_is_read_in_the_row_of_units(tmp_path: Path, unit: str, factor: float) -> None:
    stamps = [f"{k * DT * factor:.9g}" for k in range(N)]
    same(read(tmp_path, text(header=f"t,u,y\n[{unit}],[V],[m]", time=stamps)))


def clocks() -> dict[str, list[str]]:
    start = datetime.datetime(2026, 3, 4, 23, 59, 57)
    moments = [start + datetime.timedelta(microseconds=4000 * k) for k in range(N)]
    day = [datetime.datetime(2026, 3, 4, 9, 0, 0) + datetime.timedelta(microseconds=4000 * k) for k in range(N)]
    return {
        "iso": [f"{moment.isoformat(timespec='microseconds')}Z" for moment in moments],
        "zone": [f"{moment.isoformat(timespec='milliseconds')}+01:00" for moment in moments],
        "blank": [moment.isoformat(" ", "milliseconds") for moment in moments],
        "day first": [f"{moment:%d.%m.%Y %H:%M:%S.%f}" for moment in moments],
        "month first": [f"{moment:%m/%d/%Y %I:%M:%S.%f %p}" for moment in moments],
        "day first with slashes": [f"{moment.day + 26}/{moment:%m/%Y %H:%M:%S.%f}" for moment in moments],
        "time of day": [f"{moment:%H:%M:%S.%f}" for moment in day],
        "past midnight": [f"{moment:%H:%M:%S.%f}" for moment in moments],
        "epoch in s": [f"{start.timestamp() + 0.004 * k:.4f}" for k in range(N)],
        "epoch in ms": [f"{1000 * int(start.timestamp()) + 4 * k}" for k in range(N)],
        "epoch in us": [f"{10**6 * int(start.timestamp()) + 4000 * k}" for k in range(N)],
    }


@pytest.mark.parametrize("clock", clocks())
def test_clocks(tmp_path: Path, clock: str) -> None:
    same(read(tmp_path, text(time=clocks()[clock])))


@pytest.mark.parametrize("scatter", [0.15, 0.5])
def test_stamps_that_scatter_around_an_even_grid(tmp_path: Path, scatter: float) -> None:
    """The stamps of a cyclic task scatter by 2 ms in 4 ms."""
    late = np.random.default_rng(5).uniform(-scatter, scatter, N) * DT
    stamps = [f"{k * DT + late[k]:.6f}" for k in range(N)]
    record = read(tmp_path, text(time=stamps))
    np.testing.assert_allclose(record.u, U)
    assert record.dt == pytest.approx(DT, rel=2e-3)
    assert any("around an even grid" in note for note in record.notes)


@pytest.mark.parametrize("scatter", [0.0, 0.2, 0.35])
def test_a_missing_sample_is_no_scatter(tmp_path: Path, scatter: float) -> None:
    late = np.random.default_rng(7).uniform(-scatter, scatter, N)
    where = np.arange(N) + (np.arange(N) >= N // 2)
    stamps = [f"{(k + x) * DT:.7f}" for k, x in zip(where, late, strict=True)]
    record = read(tmp_path, text(time=stamps))
    if scatter > 0.25:  # with more scatter, missing samples cannot be distinguished from late ones
        assert record.u.size == N
        return
    assert record.u.size == N + 1
    assert any("missing" in note for note in record.notes)


#: Content and keys of a log, and what the refusal says.
REFUSED = {
    # in a file with decimal commas, 1.234,5 is more than a thousand; without its comma it would be about one
    "thousands": (
        text(";", ",").replace("\n0,008;", "\n1.234,5;"),
        "",
        "(with a point for thousands)' in row 3",
    ),
    "a unit for dates": (text(time=clocks()["iso"]), 'time_unit = "ms"', "drop time_unit"),
    "dates in words": (
        text(";", time=[f"4 March 2026 12:00:{k * DT:06.3f}" for k in range(N)]),
        "",
        "2026-03-04 12:00:00.25",
    ),
    "a line of sums": (text() + "Total,1,2\n", "", "remove lines that are not data"),
    "another separator": (text(";", ","), 'separator = "|"', "no "),
    "no header": (text(header=""), "", "available are column_1, column_2, column_3"),
}


@pytest.mark.parametrize(("content", "more", "said"), REFUSED.values(), ids=REFUSED)
def test_what_may_mean_something_else_is_refused(tmp_path: Path, content: str, more: str, said: str) -> None:
    with pytest.raises(UsageError) as caught:
        read(tmp_path, content, more=more)
    assert said in str(caught.value)
