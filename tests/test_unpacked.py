"""The memory of a file: refused before it is allocated, or at most a few times the size of its columns."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import mcap.writer
import numpy as np
import polars as pl
import pytest
import scipy.io

from pmfid.io import SUFFIXES
from tests.conftest import long_unless
from tests.formats import WRITERS

#: Rows of the columns below, and the largest ratio of a reader's memory to their bytes.
ROWS, MOST = 1_000_000, 10
#: Eight-byte numbers that slightly exceed the limit for the unpacked size of a small file.
ZEROS = 34_000_000
READ = """
import resource, sys
from pathlib import Path
from pmfid.errors import UsageError
from pmfid.io.parquet import column_sizes
from pmfid.io.reading import read_table
from pmfid.io.safety import readable
from pmfid.io.tables import column
import polars, scipy.io
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    table = read_table(Path(sys.argv[1]))
    for name in sys.argv[2:]:
        column(table, name, name)
except UsageError as error:
    print(error, file=sys.stderr)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def taken(path: Path, *names: str) -> tuple[int, str]:
    """Return the peak memory for reading these columns [byte], and the refusal."""
    run = subprocess.run([sys.executable, "-c", READ, str(path), *names], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return 1024 * int(run.stdout), run.stderr


#: Formats that are held as a whole.
WHOLE = (".csv", ".npz", ".arrow", ".h5", ".mf4", ".tdms")
#: Formats that are written one cell or message at a time: their files are larger than their columns.
BY_ROWS = (".xlsx", ".wpilog", ".mcap", ".db3")


@pytest.mark.parametrize(
    "suffix", long_unless((".csv", ".h5").__contains__, [one for one in SUFFIXES if one not in BY_ROWS])
)
def test_a_column_takes_a_few_times_its_size(tmp_path: Path, suffix: str) -> None:
    path, u = tmp_path / f"run{suffix}", np.arange(ROWS) % 7 / 8
    spare = {} if suffix in WHOLE else {f"spare{k}": u for k in range(5)}
    WRITERS[suffix](path, {"u": u, "y": u, **spare})
    size, refusal = taken(path, "u", "y")
    assert refusal == ""
    read = path.stat().st_size if suffix in WHOLE else 0
    assert size < MOST * 2 * 8 * ROWS + 2 * read


def packed_arrow(path: Path) -> None:
    pl.DataFrame({"u": pl.repeat(0, ZEROS, eager=True)}).write_ipc(path, compression="zstd")


def packed_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("u", shape=ZEROS, dtype="f8", chunks=(1_000_000,), compression="gzip")


def packed_mcap(path: Path) -> None:
    with path.open("wb") as stream:
        writer = mcap.writer.Writer(stream, chunk_size=300_000_000, compression=mcap.writer.CompressionType.ZSTD)
        writer.start()
        channel = writer.register_channel("/run", "json", writer.register_schema("Row", "jsonschema", b"{}"))
        writer.add_message(channel, 0, b" " * 8 * ZEROS, 0)
        writer.finish()


def packed_archive(path: Path, name: str, data: bytes) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr(name, data)


#: Name of the file -> function that writes it, and the beginning of its refusal.
BOMBS: dict[str, tuple[Callable[[Path], object], str]] = {
    "zeros.mat": (lambda path: scipy.io.savemat(path, {"u": np.zeros(ZEROS)}, do_compression=True), "a variable"),
    "rows.parquet": (lambda path: pl.DataFrame({"u": pl.repeat(0, ZEROS, eager=True)}).write_parquet(path), "a column"),
    "list.parquet": (
        lambda path: pl.DataFrame({"u": [pl.repeat(0, ZEROS, eager=True)]}).write_parquet(path),
        "column 'u'",
    ),
    "zeros.npz": (lambda path: packed_archive(path, "u.npy", bytes(8 * ZEROS)), "what is packed"),
    "cells.xlsx": (
        lambda path: packed_archive(path, "xl/worksheets/sheet1.xml", b"<c/><c/>" * ZEROS),
        "what is packed",
    ),
    "rows.arrow": (packed_arrow, "a column"),
    "unwritten.h5": (packed_hdf5, "the data"),
    "message.mcap": (packed_mcap, "the messages"),
}
#: One bomb of each library that unpacks; `make test-long` has the others.
OFTEN = ("zeros.npz", "rows.arrow", "unwritten.h5", "message.mcap")
#: Formats without compression, or with text only.
PLAIN = (".csv", ".wpilog", ".db3", ".tdms", ".mf4")


def test_every_format_is_tried_here() -> None:
    """Every compressed format has a bomb."""
    assert set(WRITERS) == set(SUFFIXES)
    assert {Path(name).suffix for name in BOMBS} == set(SUFFIXES) - set(PLAIN)


@pytest.mark.parametrize("name", long_unless(lambda name: name in OFTEN, BOMBS))
def test_a_bomb_is_refused_before_it_goes_off(tmp_path: Path, name: str) -> None:
    write, what = BOMBS[name]
    write(tmp_path / name)
    assert (tmp_path / name).stat().st_size < 3e6
    size, refusal = taken(tmp_path / name, "u")
    assert refusal.startswith(f"{what} needs ")
    assert "MB or more when a file of" in refusal
    assert size < 350e6
