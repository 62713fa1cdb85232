"""Write columns as files of every format, in the way of the programs that write these formats."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import polars as pl
import scipy.io

Columns = Mapping[str, Any]
#: Step between the time stamps of a log without a time column [s].
STEP = 0.01
ROW = "logged_msgs/msg/Row"
#: The libraries that read or write the formats of an extra.
LIBRARIES = {
    ".xlsx": "fastexcel",
    ".h5": "h5py",
    ".mcap": "mcap",
    ".db3": "rosbags",
    ".mf4": "asammdf",
    ".tdms": "nptdms",
}


def frame(columns: Columns) -> pl.DataFrame:
    return pl.DataFrame({name: pl.Series(np.asarray(values), strict=False) for name, values in columns.items()})


def _arrays(columns: Columns) -> dict[str, np.ndarray]:
    """Return the numeric columns."""
    arrays = {name: np.asarray(values) for name, values in columns.items()}
    return {name: values for name, values in arrays.items() if values.dtype.kind in "biuf"}


def _stamps(columns: Columns) -> list[int]:
    """Return the time stamps of the rows [ns]: the column t, or equal steps if the column is not usable."""
    n = len(next(iter(columns.values()), ()))
    t = np.asarray(_arrays(columns).get("t", np.arange(n) * STEP), float)
    good = np.isfinite(t).all() and t.size and t.min() >= 0 and t.max() < 1e9
    return [round(float(value) * 1e9) for value in (t if good else np.arange(n) * STEP)]


def write_matlab_7_3(path: Path, columns: Columns) -> None:
    """Write a MATLAB 7.3 file: MATLAB's header, then rows as columns."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in _arrays(columns).items():
            file.create_dataset(name, data=np.atleast_2d(values), compression="gzip" if values.size else None)
    data = bytearray(path.read_bytes())
    data[:128] = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 .".ljust(124) + b"\x00\x02IM"
    path.write_bytes(data)


def write_hdf5(path: Path, columns: Columns) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in _arrays(columns).items():
            file.create_dataset(name, data=values)


SHEET = '<?xml version="1.0"?><worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>'
TYPES = (
    '<?xml version="1.0"?><Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="xml" ContentType="application/xml"/><Override PartName="/xl/workbook.xml" '
    'ContentType="application/vnd.openxmlformats-officedocument.spreadsheetml.sheet.main+xml"/></Types>'
)
OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
LINKS = (
    '<?xml version="1.0"?><Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Id="rId1" Type="{type}" Target="{target}"/></Relationships>'
)
BOOK = (
    '<?xml version="1.0"?><workbook xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main" '
    f'xmlns:r="{OFFICE}">'
    '<sheets><sheet name="run" sheetId="1" r:id="rId1"/></sheets></workbook>'
)


def _cell(value: object) -> str:
    if isinstance(value, bool | np.bool_):
        return f'<c t="b"><v>{int(value)}</v></c>'
    if isinstance(value, int | float | np.number):
        return f"<c><v>{float(value)!r}</v></c>" if np.isfinite(float(value)) else "<c/>"
    text = "".join(mark for mark in str(value) if mark.isprintable())
    return f'<c t="inlineStr"><is><t>{escape(text)}</t></is></c>'


def write_excel(path: Path, columns: Columns) -> None:
    rows = [list(columns), *zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)]
    cells = "".join(f"<row>{''.join(map(_cell, row))}</row>" for row in rows)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as book:
        book.writestr("[Content_Types].xml", TYPES)
        book.writestr("_rels/.rels", LINKS.format(type=f"{OFFICE}/officeDocument", target="xl/workbook.xml"))
        book.writestr("xl/workbook.xml", BOOK)
        book.writestr(
            "xl/_rels/workbook.xml.rels", LINKS.format(type=f"{OFFICE}/worksheet", target="worksheets/sheet1.xml")
        )
        book.writestr("xl/worksheets/sheet1.xml", f"{SHEET}{cells}</sheetData></worksheet>")


def wpilog_record(entry: int, time: int, payload: bytes) -> bytes:
    return bytes([0x7F]) + struct.pack("<IIQ", entry, len(payload), time) + payload


def write_wpilog(path: Path, columns: Columns) -> None:
    arrays, stamps = _arrays(columns), _stamps(columns)
    data = [b"WPILOG\x00\x01", struct.pack("<I", 4), b"test"]
    for k, name in enumerate(arrays, 1):
        texts = (text.encode() for text in (name, "double", ""))
        start = b"".join(struct.pack("<I", len(text)) + text for text in texts)
        data.append(wpilog_record(0, 0, b"\x00" + struct.pack("<I", k) + start))
    for j, stamp in enumerate(stamps):
        for k, values in enumerate(arrays.values(), 1):
            data.append(wpilog_record(k, stamp // 1000, struct.pack("<d", values[j])))
    path.write_bytes(b"".join(data))


def write_mcap(path: Path, columns: Columns) -> None:
    import mcap.writer

    arrays = _arrays(columns)
    with path.open("wb") as stream:
        writer = mcap.writer.Writer(stream)
        writer.start()
        schema = writer.register_schema("Row", "jsonschema", b"{}")
        channel = writer.register_channel("/run", "json", schema)
        for k, stamp in enumerate(_stamps(columns)):
            row = {name: values[k].item() for name, values in arrays.items()}
            writer.add_message(channel, stamp, json.dumps(row).encode(), stamp)
        writer.finish()  # type: ignore[no-untyped-call]


def write_rosbag(path: Path, columns: Columns) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    names = {name: values for name, values in _arrays(columns).items() if name.isidentifier() and name.isascii()}
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("".join(f"float64 {name.lower()}\n" for name in names) or "float64 none", ROW))
    folder = path.with_suffix(".bag")
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        connection = bag.add_connection("/run", ROW, typestore=store)
        for k, stamp in enumerate(_stamps(columns)):
            row = {name.lower(): float(values[k]) for name, values in names.items()} or {"none": 0.0}
            bag.write(connection, stamp, store.serialize_cdr(store.types[ROW](**row), ROW))
    next(folder.glob("*.db3")).rename(path)


def write_mdf(path: Path, columns: Columns) -> None:
    from asammdf import MDF, Signal

    stamps = np.array(_stamps(columns)) * 1e-9
    signals = [Signal(values, stamps, name=name) for name, values in _arrays(columns).items() if values.dtype != bool]
    with MDF(version="4.10") as file:
        file.append(signals)
        file.save(path, overwrite=True)


def write_tdms(path: Path, columns: Columns) -> None:
    import nptdms

    arrays = {name: values for name, values in _arrays(columns).items() if values.dtype != bool}
    stream = io.BytesIO()
    with nptdms.TdmsWriter(stream) as writer:
        writer.write_segment([nptdms.ChannelObject("run", name, values) for name, values in arrays.items()])
    path.write_bytes(stream.getvalue())


#: Suffix -> function that writes such a file.
WRITERS: dict[str, Callable[[Path, Columns], object]] = {
    ".csv": lambda path, columns: frame(columns).write_csv(path),
    ".parquet": lambda path, columns: frame(columns).write_parquet(path),
    ".mat": lambda path, columns: scipy.io.savemat(path, dict(columns)),
    ".npz": lambda path, columns: np.savez(path, **_arrays(columns)),  # type: ignore[arg-type]
    ".xlsx": write_excel,
    ".arrow": lambda path, columns: frame(columns).write_ipc(path),
    ".h5": write_hdf5,
    ".wpilog": write_wpilog,
    ".mcap": write_mcap,
    ".db3": write_rosbag,
    ".mf4": write_mdf,
    ".tdms": write_tdms,
}
