"""Memory that a file takes: refused before it is taken, else a few times what its columns are."""

from __future__ import annotations

import bz2
import gzip
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import scipy.io

from pmfid.session.formats import SUFFIXES

#: Rows of the columns below, and how many times their bytes a reader may take.
ROWS, MOST = 1_000_000, 10
READ = """
import resource, sys
from pathlib import Path
from pmfid.errors import UsageError
from pmfid.session.formats.reading import read_table
from pmfid.session.tables import column
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
    """Bytes at most while these columns are read, and the refusal."""
    run = subprocess.run([sys.executable, "-c", READ, str(path), *names], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return 1024 * int(run.stdout), run.stderr


def mat(path: Path, u: np.ndarray) -> None:
    scipy.io.savemat(path, {"u": u, "y": u, "spare": u}, do_compression=True)


def parquet(path: Path, u: np.ndarray) -> None:
    pl.DataFrame({"u": u, "y": u, **{f"spare{k}": u for k in range(5)}}).write_parquet(path)


def csv(path: Path, u: np.ndarray) -> None:
    pl.DataFrame({"u": u, "y": u, **{f"spare{k}": u for k in range(5)}}).write_csv(path)


WRITERS: list[Callable[[Path, np.ndarray], None]] = [mat, parquet, csv]


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_a_column_takes_a_few_times_its_size(tmp_path: Path, write: Callable[[Path, np.ndarray], None]) -> None:
    path = tmp_path / f"run.{write.__name__}"
    write(path, np.arange(ROWS) % 7 / 8)
    size, refusal = taken(path, "u", "y")
    assert refusal == ""
    read = path.stat().st_size if write is csv else 0
    assert size < MOST * 2 * 8 * ROWS + 2 * read


BOMBS: dict[str, Callable[[Path], object]] = {
    "zeros.mat": lambda path: scipy.io.savemat(path, {"u": np.zeros(34_000_000)}, do_compression=True),
    "rows.parquet": lambda path: pl.DataFrame({"u": pl.repeat(0, 34_000_000, eager=True)}).write_parquet(path),
}


def test_every_format_is_tried_here() -> None:
    """What is packed inside has a bomb."""
    assert {f".{write.__name__}" for write in WRITERS} == set(SUFFIXES)
    assert {Path(name).suffix for name in BOMBS} == set(SUFFIXES) - {".csv"}


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_refused_before_it_goes_off(tmp_path: Path, name: str) -> None:
    BOMBS[name](tmp_path / name)
    size, refusal = taken(tmp_path / name, "u")
    assert "decimate or cut the record" in refusal
    assert size < 350e6


def test_a_packed_csv_is_read_and_no_bomb_of_it(tmp_path: Path) -> None:
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress(b"u,y\n") + gzip.compress(b"0.5,3\n" * 1000))
    assert taken(tmp_path / "run.csv.gz", "u")[1] == ""
    (tmp_path / "bomb.csv.gz").write_bytes(gzip.compress(b"u,y\n") + 1000 * gzip.compress(b"0,0\n" * 100_000))
    size, refusal = taken(tmp_path / "bomb.csv.gz", "u")
    assert "decimate or cut the record" in refusal
    assert size < 600e6
    (tmp_path / "cut.csv.gz").write_bytes(gzip.compress(b"u,y\n" + b"0.5,3\n" * 1000)[:-9])
    assert "truncated or corrupt" in taken(tmp_path / "cut.csv.gz", "u")[1]


@pytest.mark.parametrize("pack", [zlib.compress, bz2.compress], ids=["zlib", "bz2"])
def test_a_packed_file_is_no_csv(tmp_path: Path, pack: Callable[[bytes], bytes]) -> None:
    (tmp_path / "run.csv").write_bytes(pack(b"u,y\n") + 100 * pack(b"0,0\n" * 100_000))
    size, refusal = taken(tmp_path / "run.csv", "u")
    assert "a packed file; unpack it first" in refusal
    assert size < 50e6
