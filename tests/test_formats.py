"""Files of machines, robots and laboratories: the same record in all formats, and the features of each format."""

from __future__ import annotations

import json
import struct
import sys
from pathlib import Path

import h5py
import mcap.writer
import numpy as np
import polars as pl
import pytest
import scipy.io

from pmfid.config.axis import Axis
from pmfid.errors import UsageError
from pmfid.io.reading import READERS, read_table
from pmfid.io.tables import column, whole_name
from pmfid.records.record import Record, read_record
from tests.formats import WRITERS, wpilog_record, write_matlab_7_3
from tests.refusals import refused

DT, N = 0.004, 200
rng = np.random.default_rng(11)
RUN = {"t": np.arange(N) * DT, "u": np.round(rng.normal(size=N), 3), "y": np.cumsum(rng.integers(-2, 3, N)) * 0.25}


def read(path: Path, **record: object) -> Record:
    sections = {
        "record": {"input": "u", "output": "y", "time": "t"} | record,
        "encoder": {"resolution": 0.25},
        "model": {"input_gain": 2.0},
    }
    return read_record(path, Axis.model_validate(sections))


def same(record: Record) -> None:
    np.testing.assert_allclose(record.u, RUN["u"])
    np.testing.assert_array_equal(record.counts, np.rint(RUN["y"] / 0.25))
    assert record.dt == pytest.approx(DT, rel=1e-6)


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize("ending", ["", ".txt", ".bin"])
def test_the_content_tells_the_format_where_the_name_does_not(tmp_path: Path, suffix: str, ending: str) -> None:
    WRITERS[suffix](tmp_path / f"run{suffix}", RUN)
    path = (tmp_path / f"run{suffix}").rename(tmp_path / f"run{ending or suffix}")
    if (ending == ".bin" and suffix == ".csv") or (ending and suffix in (".npz", ".xlsx")):  # both are ZIP
        refused((r"'\.bin' is not known|the file is compressed", lambda: read(path)))
        return
    same(read(path))


def test_matlab_7_3_and_structures_by_path(tmp_path: Path) -> None:
    write_matlab_7_3(tmp_path / "new.mat", RUN)
    same(read(tmp_path / "new.mat"))
    scipy.io.savemat(tmp_path / "old.mat", {"run": {"axis": {"u": RUN["u"], "y": RUN["y"]}, "t": RUN["t"]}})
    same(read(tmp_path / "old.mat", input="run.axis.u", output="run.axis.y", time="run.t"))
    with h5py.File(tmp_path / "groups.h5", "w") as file:
        for name, values in RUN.items():
            file[f"run/axis/{name}"] = values
        file["run/title"] = "no number"
        file["away"] = h5py.ExternalLink("/etc/hostname", "/")
    same(read(tmp_path / "groups.h5", input="run.axis.u", output="run.axis.y", time="run.axis.t"))
    assert list(read_table(tmp_path / "groups.h5")) == ["run.axis.t", "run.axis.u", "run.axis.y"]


def test_objects_are_never_unpickled(tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", u=np.array([{}, 1], dtype=object))
    refused(("an array of objects cannot be read: save arrays", lambda: read_table(tmp_path / "run.npz")))


def test_lists_of_a_robot_data_set_are_columns(tmp_path: Path) -> None:
    """A data set of LeRobot is a folder with one file of data, with lists of states and actions."""
    folder = tmp_path / "lerobot"
    (folder / "data/chunk-000").mkdir(parents=True)
    (folder / "meta").mkdir()
    pl.DataFrame({"index": [0]}).write_parquet(folder / "meta/episodes.parquet")
    path = folder / "data/chunk-000/file-000.parquet"
    state, action = (np.column_stack([np.zeros(N), RUN[name]]) for name in "yu")
    data = {"observation.state": state.tolist(), "action": action.tolist(), "timestamp": RUN["t"]}
    pl.DataFrame(data).write_parquet(path)
    same(read(folder, input="action.1", output="observation.state.1", time="timestamp"))
    pl.DataFrame(data).write_parquet(folder / "data/chunk-000/file-001.parquet")
    absent = {"input": "action.2", "output": "observation.state.1", "time": "timestamp"}
    refused(
        (r"'action\.2': there is no such column", lambda: read(path, **absent)),
        (r"contains data/chunk-000/file-000\.parquet, .*; give the path of a file", lambda: read(folder)),
    )


def test_messages_have_paths_and_stamps(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with path.open("wb") as stream:
        writer = mcap.writer.Writer(stream, compression=mcap.writer.CompressionType.LZ4)
        writer.start()
        schema = writer.register_schema("State", "jsonschema", b"{}")
        channel = writer.register_channel("/joint", "json", schema)
        for k in range(N):
            stamp = {"sec": 1_772_582_400 + k // 250, "nsec": k % 250 * 4_000_000}
            message = {"stamp": stamp, "position": [0.0, RUN["y"][k]], "effort": [RUN["u"][k]], "name": "axis"}
            late = int(1e6 * (k % 3))  # the recorder's clock differs from the joint's clock
            writer.add_message(channel, int(k * DT * 1e9) + late, json.dumps(message).encode(), 0)
        writer.finish()
    same(read(path, input="/joint.effort.0", output="/joint.position.1", time="/joint.stamp"))
    assert whole_name(read_table(path), "effort.0") == "/joint.effort.0"


def entry(number: int, name: str) -> bytes:
    start = b"".join(struct.pack("<I", len(text)) + text.encode() for text in (name, "double", ""))
    return wpilog_record(0, 0, b"\x00" + struct.pack("<I", number) + start)


def test_signals_with_clocks_of_their_own_stand_side_by_side(tmp_path: Path) -> None:
    """An input that is logged at its changes holds its value; an input of the same cycle is used directly."""
    log = b"WPILOG\x00\x01" + struct.pack("<I", 0) + entry(1, "drive/u") + entry(2, "drive/y") + entry(3, "late")
    held, last = np.repeat(RUN["u"][::5], 5), None
    for k in range(N):
        stamp = 1000 + round(1e6 * RUN["t"][k])
        if held[k] != last:
            last = held[k]
            log += wpilog_record(1, stamp - 100, struct.pack("<d", last))
        log += wpilog_record(2, stamp, struct.pack("<d", RUN["y"][k]))
        log += wpilog_record(3, stamp + 900, struct.pack("<d", RUN["u"][k]))
    (tmp_path / "run.wpilog").write_bytes(log)
    record = read(tmp_path / "run.wpilog", input="drive/u", output="drive/y", time="time")
    np.testing.assert_array_equal(record.u, held)
    note = "drive/u has its own time stamps: at each stamp of the output, the last value of drive/u counts"
    assert record.notes == (note,)
    record = read(tmp_path / "run.wpilog", input="late", output="drive/y", time="time")
    same(record)
    assert record.notes == ()


EXTRAS = {".xlsx": "excel", ".h5": "hdf5", ".mcap": "mcap", ".db3": "ros", ".mf4": "mdf4", ".tdms": "tdms"}
LIBRARIES = {
    "excel": "fastexcel",
    "hdf5": "h5py",
    "mcap": "mcap.",
    "ros": "rosbags.",
    "mdf4": "asammdf.",
    "tdms": "nptdms",
}


@pytest.mark.parametrize("suffix", EXTRAS)
def test_a_library_that_is_not_there_is_named_with_what_installs_it(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    WRITERS[suffix](tmp_path / f"run{suffix}", RUN)
    begins = LIBRARIES[EXTRAS[suffix]]
    for module in [name for name in sys.modules if name == begins or (begins[-1] == "." and name.startswith(begins))]:
        monkeypatch.setitem(sys.modules, module, None)
    remedy = rf"not installed: pip install 'pmfid\[{EXTRAS[suffix]}\]'"
    refused((remedy, lambda: read_table(tmp_path / f"run{suffix}")))


@pytest.mark.parametrize("suffix", [suffix for suffix in READERS if suffix != ".csv"])
def test_damage_is_reported_or_harmless(tmp_path: Path, suffix: str) -> None:
    """A few bytes change at a time: the result is a sentence or a table."""
    path = tmp_path / f"run{suffix}"
    WRITERS[suffix](path, RUN)
    data, draw = path.read_bytes(), np.random.default_rng(5)
    refused = 0
    for _ in range(25):
        spot = int(draw.integers(min(len(data), 400)))
        path.write_bytes(data[:spot] + draw.bytes(4) + data[spot + 4 :])
        try:
            table = read_table(path)
            for name in list(table)[:5]:
                column(table, "input", name)
        except UsageError as error:
            refused += bool(str(error))
    assert refused > 0
