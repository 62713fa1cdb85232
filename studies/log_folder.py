"""Logs of a rotary and a linear axis with known truth, as drives, robots, laboratories and spreadsheets write them."""

from __future__ import annotations

import datetime
import gzip
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import scipy.io
import zstandard

from studies.log_bench import (
    BENCHES,
    DEG,
    Bench,
    Columns,
    Keys,
    Log,
    Writer,
    as_file,
    as_text,
    columns,
    renamed,
    replaced,
)
from tests.formats import WRITERS, write_hdf5, write_matlab_7_3

START = datetime.datetime(2026, 3, 4, 23, 59, 58)


def moments(form: Callable[[datetime.datetime], str]) -> Callable[[Bench], object]:
    return lambda bench: [form(START + datetime.timedelta(seconds=float(t))) for t in bench.t]


def formats() -> Iterator[Log]:
    """Yield every format, of the rotary axis with its angle in rad."""
    for suffix in WRITERS:
        yield Log(f"format {suffix}", "rotary", as_file(suffix))
    yield Log("format .csv.gz", "rotary", as_text(edit=lambda whole: gzip.compress(whole.encode()), name="run.csv.gz"))
    packed = as_text(edit=lambda whole: zstandard.compress(whole.encode()), name="run.csv.zst")
    yield Log("format .csv.zst", "rotary", packed)

    def new_matlab(folder: Path, bench: Bench) -> Path:
        write_matlab_7_3(folder / "run.mat", columns(bench))
        return folder / "run.mat"

    def structure(folder: Path, bench: Bench) -> Path:
        scipy.io.savemat(folder / "run.mat", {"run": {"axis": columns(bench)}})
        return folder / "run.mat"

    def groups(folder: Path, bench: Bench) -> Path:
        write_hdf5(folder / "run.hdf5", {f"run/{name}": values for name, values in columns(bench).items()})
        return folder / "run.hdf5"

    deep = {"record": {"input": "run.axis.u", "output": "run.axis.y", "time": "run.axis.t"}}
    yield Log("MATLAB v7.3", "rotary", new_matlab)
    yield Log("MATLAB structure", "rotary", structure, deep)
    yield Log("HDF5 groups", "rotary", groups)


def other_names() -> Iterator[Log]:
    """Yield formats that only the content shows."""

    def called(suffix: str, name: str) -> Writer:
        return lambda folder, bench: as_file(suffix)(folder, bench).rename(folder / name)

    yield Log("MDF4 called .dat", "rotary", called(".mf4", "run.dat"))
    yield Log("Parquet called .bin", "rotary", called(".parquet", "run.bin"))


def layouts() -> Iterator[Log]:
    """Yield layouts of text of the linear axis."""
    german: dict[str, str] = {"separator": ";", "decimal": ","}
    units = {"header": "t;u;y\n[s];[V];[m]"} | german
    yield Log("semicolons, decimal commas", "linear", as_text(layout=german))
    yield Log("tabs, decimal commas", "linear", as_text(layout={"separator": "\t", "decimal": ","}))
    yield Log("bars", "linear", as_text(layout={"separator": "|"}))
    yield Log("spaces", "linear", as_text(layout={"separator": " "}))
    yield Log("preamble", "linear", as_text(edit=lambda whole: "Scope\nVersion;4.2\n\n" + whole, layout=german))
    yield Log("row of units", "linear", as_text(layout=units))
    yield Log("header in a comment", "linear", as_text(layout={"header": "# saved by drive\n# t,u,y"}))
    yield Log("UTF-16", "linear", as_text(edit=lambda whole: whole.encode("utf-16"), layout=german))
    yield Log("byte order mark", "linear", as_text(edit=lambda whole: b"\xef\xbb\xbf" + whole.encode(), layout=german))
    numbered = {"record": {"time": "column_1", "input": "column_2", "output": "column_3"}}
    yield Log("no header", "linear", as_text(layout={"header": ""}), numbered)


def times() -> Iterator[Log]:
    """Yield all forms of the time column."""
    for unit, factor in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        yield Log(
            f"time called t_{unit}",
            "linear",
            as_text(renamed(t=(f"t_{unit}", factor))),
            {"record": {"time": f"t_{unit}"}},
        )
        yield Log(f"time in {unit}, unsaid", "linear", as_text(renamed(t=("t", factor))), units=(unit,))
    yield Log(
        "time as ISO 8601", "linear", as_text(replaced(t=moments(lambda now: now.isoformat(timespec="milliseconds"))))
    )
    zone = moments(lambda now: now.isoformat(timespec="milliseconds") + "+01:00")
    yield Log("time with a zone", "linear", as_text(replaced(t=zone)))
    yield Log("time of day, past midnight", "linear", as_text(replaced(t=moments(lambda now: f"{now:%H:%M:%S.%f}"))))
    epoch = START.replace(tzinfo=datetime.UTC).timestamp()
    yield Log("epoch in s", "linear", as_text(replaced(t=lambda bench: [f"{epoch + t:.4f}" for t in bench.t])))
    whole = replaced(t=lambda bench: [str(round(1e9 * epoch) + round(1e9 * t)) for t in bench.t])
    yield Log("epoch in ns", "linear", as_text(whole))
    number = replaced(t=lambda bench: np.arange(bench.u.size))
    yield Log("number of the sample", "linear", as_text(number), units=("dt",))
    yield Log("number of the sample, dt given", "linear", as_text(number), {"record": {"dt": 4e-3}})
    yield Log("no time, dt given", "linear", as_text(), {"record": {"time": None, "dt": 4e-3}})

    def late(bench: Bench) -> np.ndarray:
        return np.asarray(bench.t + np.random.default_rng(3).uniform(-0.5, 0.5, bench.t.size) * bench.dt)

    yield Log("stamps late and early by 2 ms", "linear", as_text(replaced(t=late)))


def units() -> Iterator[Log]:
    """Yield columns and numbers of data sheets in units other than SI."""
    step, per_volt = BENCHES["linear"].step, BENCHES["linear"].truth.input_gain
    keys: Keys
    turn = BENCHES["rotary"].step / DEG

    def named(name: str) -> dict[str, object]:
        return {"output": name}

    for name, unit, factor in (("pos_mm", "mm", 1e-3), ("y [um]", "um", 1e-6), ("y [cm]", "cm", 1e-2)):
        keys = {"record": named(name), "encoder": {"resolution": step / factor}}
        yield Log(f"{unit}, resolution too", "linear", as_text(renamed(y=(name, factor))), keys, (unit,))
    yield Log(
        "mm, resolution in m", "linear", as_text(renamed(y=("pos_mm", 1e-3))), {"record": named("pos_mm")}, ("m",)
    )
    keys = {"record": {"output_unit": "mm"}, "encoder": {"resolution": f"{step / 1e-3:.9g} mm"}}
    yield Log("mm by key", "linear", as_text(renamed(y=("y", 1e-3))), keys)
    for name, unit, factor in (("phi (deg)", "deg", DEG), ("phi [rev]", "rev", 2 * math.pi)):
        keys = {"record": named(name), "encoder": {"resolution": 0.1 * DEG / factor}}
        yield Log(f"{unit}, resolution too", "rotary", as_text(renamed(y=(name, factor))), keys, (unit,))
    keys = {"record": {"input": "Current [mA]"}}
    yield Log("input in mA, gain per A", "rotary", as_text(renamed(u=("Current [mA]", 1e-3))), keys, ("A",))
    keys = {"record": {"input": "Current [mA]"}, "model": {"input_gain": 0.35e-3}}
    yield Log("input in mA, gain per mA", "rotary", as_text(renamed(u=("Current [mA]", 1e-3))), keys, ("mA",))
    keys = {"record": {"input": "M [mNm]"}, "model": {"input_gain": "1 N m/(N m)"}}
    yield Log("torque in mN m", "rotary", as_text(renamed(u=("M [mNm]", 1e-3 / 0.35))), keys)
    keys = {"record": {"input": "Torque [%]"}, "model": {"input_gain": "0.42 N m"}}
    yield Log("torque in % of 0.42 N m", "rotary", as_text(renamed(u=("Torque [%]", 0.01 * 0.42 / 0.35))), keys)
    keys = {"record": {"input": "F_kN"}, "model": {"input_gain": "1 N/N"}}
    yield Log("force in kN", "linear", as_text(renamed(u=("F_kN", 1e3 / per_volt))), keys)
    keys = {"record": {"output_kind": "counts"}, "encoder": {"resolution": f"{turn:.9g} deg"}}
    yield Log("counts, resolution in deg", "rotary", as_text(replaced(y=lambda bench: bench.counts)), keys)


def motions() -> Iterator[Log]:
    """Yield outputs that are no plain position."""
    counts = {"record": {"output_kind": "counts"}}

    def wrapped(span: int) -> Writer:
        return as_text(replaced(y=lambda bench: bench.counts % span))

    yield Log("counter of 12 bits", "rotary", wrapped(4096), {**counts, "encoder": {"bits": 12}})
    yield Log("counter of 12 bits, unsaid", "rotary", wrapped(4096), counts)
    yield Log("3600 counts in a turn", "rotary", wrapped(3600), {**counts, "encoder": {"range": "360 deg"}})
    yield Log("3600 counts in a turn, unsaid", "rotary", wrapped(3600), counts)
    angle = as_text(renamed_wrapped("phi [deg]", DEG, 360.0))
    keys = {"record": {"output": "phi [deg]"}, "encoder": {"resolution": "0.1 deg", "range": "360 deg"}}
    yield Log("angle of 0 to 360 deg", "rotary", angle, keys)
    keys = {"record": {"output": "phi [deg]"}, "encoder": {"resolution": "0.1 deg"}}
    yield Log("angle of 0 to 360 deg, unsaid", "rotary", angle, keys)
    turns = as_text(replaced(y=lambda bench: np.mod(bench.y + math.pi, 2 * math.pi) - math.pi))
    yield Log("angle of -pi to pi", "rotary", turns, {"encoder": {"range": "1 rev"}})

    def rate(bench: Bench) -> np.ndarray:
        return np.asarray(np.diff(bench.y, prepend=bench.y[:1]) / bench.dt)

    moving = {"record": {"output_kind": "velocity"}}
    yield Log("velocity, of counts", "linear", as_text(replaced(y=rate)), moving)
    rpm = as_text(lambda bench: {"t": bench.t, "u": bench.u, "n_rpm": rate(bench) * 30 / math.pi})
    keys = {"record": {"output": "n_rpm", "output_kind": "velocity"}, "encoder": {"resolution": "0.1 deg"}}
    yield Log("velocity in rpm", "rotary", rpm, keys)
    yield Log(
        "velocity in rpm, unsaid", "rotary", rpm, {"record": {"output": "n_rpm"}, "encoder": {"resolution": "0.1 deg"}}
    )
    yield Log("velocity, given as a position", "linear", as_text(replaced(y=rate)))
    yield Log("counts, given as a position", "linear", as_text(replaced(y=lambda bench: bench.counts)))


def renamed_wrapped(name: str, factor: float, span: float) -> Callable[[Bench], Columns]:
    def change(bench: Bench) -> Columns:
        return {"t": bench.t, "u": bench.u, name: np.mod(np.round(bench.y / factor, 6), span)}

    return change


def defects() -> Iterator[Log]:
    """Yield faults of logging."""

    def lines(edit: Callable[[list[str]], list[str]]) -> Writer:
        return as_text(edit=lambda whole: "\n".join(edit(whole.splitlines())) + "\n")

    def kept(part: Callable[[int], bool]) -> Callable[[list[str]], list[str]]:
        return lambda rows: [row for k, row in enumerate(rows) if not k or part(k)]

    chance = np.random.default_rng(17).random(5000)
    yield Log("comments between the lines", "linear", lines(lambda rows: [*rows[:900], "# beat", *rows[900:]]))
    yield Log("a sum at the end", "linear", lines(lambda rows: [*rows, "Total,1,2"]), mend=_drop_last)
    yield Log("blank lines at the end", "linear", lines(lambda rows: [*rows, "", ""]))
    yield Log("an empty cell", "linear", lines(_without_a_cell), mend=_interpolate)
    yield Log("a line twice", "linear", lines(lambda rows: [*rows[:900], rows[899], *rows[900:]]), mend=_drop_repeated)
    yield Log("a line missing", "linear", lines(kept(lambda k: k != 900)), mend=_cut_at_gap)
    yield Log("1 % of the lines missing", "linear", lines(kept(lambda k: bool(chance[k] > 0.01))))
    yield Log("50 lines missing", "linear", lines(kept(lambda k: not 900 <= k < 950)), mend=_cut_at_gap)
    yield Log("encoder the wrong way round", "linear", as_text(replaced(y=lambda bench: -bench.y)))
    yield Log("columns exchanged", "linear", as_text(), {"record": {"input": "y", "output": "u"}})


def _rows(path: Path) -> list[str]:
    return path.read_text().splitlines()


def _drop_last(path: Path) -> None:
    path.write_text("\n".join(_rows(path)[:-1]) + "\n")


def _drop_repeated(path: Path) -> None:
    path.write_text("\n".join(dict.fromkeys(_rows(path))) + "\n")


def _without_a_cell(rows: list[str]) -> list[str]:
    t, _, y = rows[900].split(",")
    return [*rows[:900], f"{t},,{y}", *rows[901:]]


def _interpolate(path: Path) -> None:
    rows = [row.split(",") for row in _rows(path)]
    for k, row in enumerate(rows):
        if "" in row:
            row[1] = rows[k - 1][1]
    path.write_text("\n".join(",".join(row) for row in rows) + "\n")


def _cut_at_gap(path: Path) -> None:
    """Keep the longer part of a log that is cut at its gap."""
    rows = _rows(path)
    stamps = np.array([float(row.split(",")[0]) for row in rows[1:]])
    steps = np.diff(stamps)
    first = int(np.argmax(steps > 1.5 * np.median(steps))) + 2
    path.write_text("\n".join([rows[0], *rows[first:]]) + "\n")


def twos() -> Iterator[Log]:
    """Yield combinations of two or three variants."""
    german: dict[str, str] = {"separator": ";", "decimal": ","}
    ms, mm = ("t_ms", 1e-3), ("pos_mm", 1e-3)
    keys: Keys = {"record": {"time": "t_ms", "output": "pos_mm"}, "encoder": {"resolution": 0.01}}
    yield Log("semicolons, ms and mm", "linear", as_text(renamed(t=ms, y=mm), layout=german), keys, ("mm",))
    yield Log("Parquet, ms and mm", "linear", as_file(".parquet", renamed(t=ms, y=mm)), keys, ("mm",))
    yield Log("Excel, ms and mm", "linear", as_file(".xlsx", renamed(t=ms, y=mm)), keys, ("mm",))
    turned: Keys = {
        "record": {"input": "i_mA", "output": "phi_deg"},
        "encoder": {"resolution": "0.1 deg"},
        "model": {"input_gain": "0.35 N m/A"},
    }
    both = renamed(u=("i_mA", 1e-3), y=("phi_deg", DEG))
    for suffix in (".mat", ".mcap", ".h5", ".wpilog"):
        yield Log(f"{suffix}, mA and deg", "rotary", as_file(suffix, both), turned)

    def wrapped(bench: Bench) -> Columns:
        return both(bench) | {"phi_deg": np.mod(np.round(bench.y / DEG, 6), 360.0)}

    turning = turned | {"encoder": {"resolution": "0.1 deg", "range": "1 rev"}}
    yield Log("TDMS, mA, deg and wrap", "rotary", as_file(".tdms", wrapped), turning)
    clock = replaced(t=moments(lambda now: f"{now:%H:%M:%S.%f}"), y=lambda bench: bench.counts)
    yield Log("time of day and counts", "rotary", as_text(clock), {"record": {"output_kind": "counts"}})
    packed = as_text(renamed(t=ms, y=mm), edit=lambda whole: gzip.compress(whole.encode("utf-16")), name="a.log.gz")
    yield Log("UTF-16 in gzip, ms and mm", "linear", packed, keys, ("mm",))
    unsaid = replaced(t=lambda bench: np.rint(1e3 * bench.t).astype(int), y=lambda bench: bench.counts)
    yield Log("ms unsaid, counts given as a position", "linear", as_text(unsaid), units=("ms",))
    above = {"header": "Trace\nAxis;X\nt;u;pos_mm\n[s];[V];[mm]"} | german
    keys = {"record": {"output": "pos_mm"}, "encoder": {"resolution": 0.01}}
    yield Log("preamble, row of units, mm", "linear", as_text(renamed(y=mm), layout=above), keys, ("mm",))


def logs() -> list[Log]:
    return [log for part in (formats, other_names, layouts, times, units, motions, defects, twos) for log in part()]


def clean(bench: str) -> Log:
    """Return the log to which the others are compared."""
    return Log("clean", bench, as_file(".csv"))
